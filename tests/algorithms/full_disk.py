"""A disk that fills up in the middle of a file, and a look at what is left in a folder."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """Let every write beyond the first ``limit`` bytes of a file fail, by the system's limit on file sizes.

    As on a full disk, what fits is written before the error comes.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def files_in(folder: Path) -> list[str]:
    """Names of everything in a folder, hidden files included, sorted."""
    return sorted(path.name for path in folder.iterdir())
