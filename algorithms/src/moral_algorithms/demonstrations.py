"""Demonstrations: whole episodes of an expert, in a plain file.

What a demonstration file holds, version 1
------------------------------------------
A NumPy ``.npz`` archive without pickled objects, with these arrays:

==================  ======  ======================  =====================================================
name                dtype   shape                   content
==================  ======  ======================  =====================================================
``header``          uint8   (bytes,)                UTF-8 JSON: ``format``, ``version``, ``world``
``states``          uint8   (n, T + 1, C, H, W)     0/1 planes, the start and the state after each step
``actions``         uint8   (n, T)                  action taken in each state but the last
``objectives``      int64   (n, m)                  ground-truth counters at the end, for reference only
==================  ======  ======================  =====================================================
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.storage import StorageError, StrPath, atomic_write, first_line
from moral_algorithms.worlds import WorldSpec
from moral_envs.engine import Engine
from moral_envs.world import NUM_ACTIONS

FORMAT = "moral-demonstrations"
VERSION = 1
_ARRAYS = ("header", "states", "actions", "objectives")

# What NumPy, zipfile and zlib raise, depending on which byte of an archive is wrong.
_DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    AttributeError,
    KeyError,
    EOFError,
    MemoryError,
    OverflowError,
    RuntimeError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True)
class Demonstrations:
    """Episodes of one expert in one world.

    Parameters
    ----------
    world
        Where they were played.
    states
        uint8 0/1 planes of shape (n, T + 1, C, H, W).
    actions
        uint8 of shape (n, T).
    objectives
        int64 of shape (n, m): counters at the end of each episode. No learner looks at them.

    Raises
    ------
    ValueError
        If a shape or dtype does not fit the world, there is no episode, a value is out of range, or a state
        does not have exactly one agent.
    """

    world: WorldSpec
    states: NDArray[np.uint8]
    actions: NDArray[np.uint8]
    objectives: NDArray[np.int64]

    def __post_init__(self) -> None:
        world = self.world.build()
        if self.actions.ndim != 2 or len(self.actions) == 0:
            raise ValueError(
                f"actions have shape {self.actions.shape}; they must be (episodes, steps), at least one"
            )
        episodes = len(self.actions)
        wanted: dict[str, tuple[tuple[int, ...], type]] = {
            "states": ((episodes, world.horizon + 1, *Engine(world).observation_shape), np.uint8),
            "actions": ((episodes, world.horizon), np.uint8),
            "objectives": ((episodes, len(world.objective_names)), np.int64),
        }
        for name, (shape, dtype) in wanted.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype:
                raise ValueError(
                    f"{name} are {array.dtype} {array.shape}; in {self.world.name} they must be "
                    f"{np.dtype(dtype)} {shape}"
                )
        if self.states.max() > 1:
            raise ValueError(f"states contain {self.states.max()}; planes hold 0 and 1")
        agents = self.states[:, :, world.plane_names.index("agent")].sum(axis=(2, 3))
        if (agents != 1).any():
            raise ValueError(f"states contain one with {agents[agents != 1][0]} agents; each must have one")
        if self.actions.max() >= NUM_ACTIONS:
            raise ValueError(f"actions contain {self.actions.max()}; an action is 0 to {NUM_ACTIONS - 1}")

    @property
    def num_episodes(self) -> int:
        """Number of episodes n."""
        return len(self.actions)

    def save(self, path: StrPath) -> None:
        """Write the file; see the module's documentation for its format.

        Raises
        ------
        StorageError
            If it cannot be written; what stood at ``path`` is untouched then.
        """
        header = {"format": FORMAT, "version": VERSION, "world": self.world.to_json()}
        with atomic_write(path) as file:
            np.savez_compressed(
                file,
                header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
                states=self.states,
                actions=self.actions,
                objectives=self.objectives,
            )

    @classmethod
    def load(cls, path: StrPath, world: WorldSpec | None = None) -> Demonstrations:
        """Read and check a file.

        Parameters
        ----------
        path
            The file.
        world
            The world that it must be of; None takes any.

        Raises
        ------
        StorageError
            If it is missing, truncated, of another format, version or world, or holds Python objects.
        """
        with _damage_reported(path):
            found, arrays = _read(path, _ARRAYS)
            demonstrations = cls(found, arrays["states"], arrays["actions"], arrays["objectives"])
        if world is not None and found.build() != world.build():
            raise StorageError(f"{path} was demonstrated in {found.to_json()}; it must be {world.to_json()}")
        return demonstrations

    @staticmethod
    def world_of(path: StrPath) -> WorldSpec:
        """Read nothing but the world that a file's demonstrations are of.

        Raises
        ------
        StorageError
            If the file is missing, damaged or no demonstration file.
        """
        with _damage_reported(path):
            world, _ = _read(path, ("header",))
        return world


def _read(path: StrPath, names: Sequence[str]) -> tuple[WorldSpec, dict[str, NDArray[Any]]]:
    """Read the world and some arrays of a file; a StorageError if it is of another format or version."""
    # Of other files NumPy says that they hold pickled data.
    if Path(path).is_file() and not zipfile.is_zipfile(path):
        raise StorageError(f"{path} is damaged or no demonstration file: it is no archive of arrays")
    # NumPy does not close a file that it opened and found damaged.
    with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
        missing = [name for name in names if name not in archive]
        if missing:
            raise StorageError(f"{path} has no array {missing[0]!r}; it is no demonstration file")
        arrays = {name: archive[name] for name in names}
    header = json.loads(arrays["header"].tobytes())
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise StorageError(f"{path} is no demonstration file")
    if header.get("version") != VERSION:
        raise StorageError(f"{path} has version {header.get('version')!r}; this release reads {VERSION}")
    return WorldSpec.from_json(header.get("world")), arrays


@contextmanager
def _damage_reported(path: StrPath) -> Iterator[None]:
    """Turn whatever a damaged file leads to into a StorageError of one line."""
    try:
        yield
    except StorageError:
        raise
    except FileNotFoundError as error:
        raise StorageError(f"there is no demonstration file {path}") from error
    except _DAMAGE as error:
        raise StorageError(f"{path} is damaged or no demonstration file: {first_line(error)}") from error
