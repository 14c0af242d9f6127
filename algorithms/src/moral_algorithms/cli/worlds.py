"""Which world the options of a command are about: it decides about some of their defaults."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from moral_algorithms import pipeline
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError


def find_world(options: Sequence[str]) -> str:
    """Find the name of the world, given or that of the first run that is read, before the options are.

    Where there is none, or it cannot be read, it is emergency.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--world", nargs="?")
    parser.add_argument("--rewards", type=Path, nargs="*", default=[])
    parser.add_argument("--covered", type=Path, nargs="?")
    early, _ = parser.parse_known_args(list(options))
    try:
        if early.covered is not None:
            return pipeline.read_covered(RunDirectory(early.covered)).world.name
        return str(early.world or pipeline.choose_world(None, {}, tuple(early.rewards)).name)
    except (StorageError, ValueError):
        # The command itself says so.
        return "emergency"
