"""What commands share whose run goes on where it was interrupted."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence, Sized
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from moral_algorithms import pipeline
from moral_algorithms.cli.arguments import Machine
from moral_algorithms.cli.console import Console
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError


class Resumed(NamedTuple):
    """A run that is to go on, and how it was started to be run."""

    directory: RunDirectory
    """Where it is."""
    machine: Machine
    """What it ran on."""
    tensorboard: bool
    """Whether TensorBoard's event files were written."""


def find_resumed(options: Sequence[str], kind: str) -> Resumed | None:
    """Find the run of a kind that options ask to resume; None where they ask for none."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--out", type=Path, nargs="?")
    early, _ = parser.parse_known_args(list(options))
    if not early.resume or early.out is None:
        return None
    directory = RunDirectory(early.out)
    setting = pipeline.read_setting(directory, kind)
    # An unknown device is the options' to refuse.
    device: Any = setting.device
    return Resumed(directory, Machine(device, setting.threads), setting.tensorboard)


def saved_answers(out: Path, command: str, queries: int, read: Callable[[Path], Sized]) -> str:
    """Say how many of so many answers an interrupted run has saved, and which command goes on with it."""
    directory = RunDirectory(out)
    if not directory.config.exists():
        return "nothing was started"
    if directory.summary.exists():
        return f"the run is finished; the agent is in {out}"
    try:
        answered = len(read(directory.queries))
    except StorageError as error:
        return f"{error}"
    return f"{answered} of {queries} answers are saved; {pipeline.how_to_resume(directory, command)}"


@contextmanager
def going_on(
    console: Console, directory: RunDirectory, kind: str, setting: pipeline.Setting, resume: bool
) -> Iterator[None]:
    """Warn where a run goes on otherwise than it was started; say in the end if it was finished before."""
    finished = resume and directory.summary.exists()
    if resume and not finished:
        for warning in pipeline.changes_since_start(directory, kind, setting):
            console.error(f"moral: warning: {warning}")
    yield
    if finished:
        console.print(f"The run in {directory.path} was finished before.")
