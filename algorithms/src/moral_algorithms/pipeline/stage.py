"""What the stages of the pipeline share: how they are run, measured and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.learners.ppo import OnProgress, Progress
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError, has_fields


@contextmanager
def silent(title: str) -> Iterator[OnProgress]:
    """Show nothing of a stage's progress."""
    yield lambda progress: None


@dataclass(frozen=True)
class Setting:
    """How stages are run, whatever they are."""

    device: str = "cpu"
    """Where networks live."""
    threads: int = 1
    """Threads of PyTorch, for the record: they belong to the process, which has them already."""
    tensorboard: bool = False
    """Write TensorBoard's event files into ``tensorboard`` in the run directory."""
    stage: Callable[[str], AbstractContextManager[OnProgress]] = silent
    """Opens a stage by its title; what it returns is called after every rollout."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for a configuration."""
        return {"device": self.device, "threads": self.threads, "tensorboard": self.tensorboard}

    @classmethod
    def from_json(cls, value: Any) -> Setting:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else.
        """
        types = {"device": str, "threads": int, "tensorboard": bool}
        if not has_fields(value, types):
            raise ValueError(f"setting is {value!r}; it must be an object with {', '.join(types)}")
        return cls(**value)

    def event_files(self, directory: RunDirectory) -> Path | None:
        """Where TensorBoard's event files go, if they are wanted."""
        return directory.path / "tensorboard" if self.tensorboard else None


class StageClock:
    """Measures a stage, from its construction on, and remembers the objectives of its last rollout."""

    def __init__(self) -> None:
        self._started = time.perf_counter()
        self._objectives: dict[str, float] = {}

    @property
    def seconds(self) -> float:
        """Wall seconds so far."""
        return round(time.perf_counter() - self._started, 3)

    def watch(self, on_progress: OnProgress) -> OnProgress:
        """Listen to what goes to ``on_progress``."""

        def remember(progress: Progress) -> None:
            self._objectives = progress.objectives
            on_progress(progress)

        return remember

    def summary(self) -> dict[str, Any]:
        """Return what a stage's summary says of time and objectives."""
        return {"wall_seconds": self.seconds, "objectives": self._objectives}


@contextmanager
def new_run(directory: RunDirectory, kind: str, config: dict[str, Any]) -> Iterator[None]:
    """Hold a directory for a run that is done in one go; one that was cut off is replaced."""
    with directory.hold():
        if directory.config.exists():
            require_kind(directory, directory.read_config(), kind)
        if directory.summary.exists():
            raise StorageError(f"{directory.path} holds a finished run; choose another folder")
        directory.write_config({"kind": kind, **config})
        yield


def require_kind(directory: RunDirectory, config: dict[str, Any], kind: str) -> None:
    """Raise a StorageError if the run in a directory is not one of a kind: expert, airl, train or demo."""
    if config.get("kind") != kind:
        raise StorageError(
            f"{directory.path} holds a run of moral {config.get('kind')}, not one of moral {kind}"
        )


def require_normaliser(value: float, who: str, remedy: str) -> None:
    """Raise a ValueError if rewards cannot be divided by a mean return."""
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{who} has a mean return of {value}, by which nothing can be divided; {remedy}")


def require_positive(name: str, value: int) -> None:
    """Raise a ValueError if there must be at least one of something and there is none."""
    if value < 1:
        raise ValueError(f"{name} is {value}; it must be at least 1")


def name_values(names: tuple[str, ...], values: NDArray[np.float64]) -> dict[str, float]:
    """Values of shape (m,) by name."""
    return dict(zip(names, values.tolist(), strict=True))
