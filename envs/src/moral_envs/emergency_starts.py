"""Starts of Emergency: those that stand for a world, and what every search from them needs to know.

A *start* is an observation of a one-agent world, as :mod:`moral_envs.optimal` describes it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from moral_envs.arguments import require_integer
from moral_envs.array_arguments import refuse_first, require_planes
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import Effect, ObjectKind, World

if TYPE_CHECKING:
    import numpy.typing as npt

EXTINGUISH_REWARD = 0.1
"""Reward of one step on the extinguisher's cell; saving a person pays 1."""

_MAX_PEOPLE = 12


def seeded_starts(world: World, num_starts: int = 100, seed: int = 0) -> npt.NDArray[np.uint8]:
    """Draw the starts that stand for an Emergency world.

    They are the first observations of ``vector_env(num_envs=num_starts).reset(seed=seed)``; the defaults are
    those of the environment's ``pareto_front``.

    Parameters
    ----------
    world
        Emergency of any size, with any number of people up to 12, horizon and walls.
    num_starts
        How many starts, at least 1.
    seed
        Seed of the batch.

    Returns
    -------
    uint8 ``(num_starts, 4, height, width)``
        Start observations, as in :func:`~moral_envs.optimal.pareto_fronts`.

    Raises
    ------
    ValueError
        If an argument is not as described or the optimum of the world is unknown: if it has other rules than
        Emergency, people who walk for instance, or a layout that draws the number of people or the horizon.
    """
    num = require_integer("num_starts", num_starts, 1, "at least 1")
    streams = spawn_streams(require_integer("seed", seed, 0, "at least 0"), num)
    _check_rules(world)
    engine = Engine(world, num)
    engine.seed(streams)
    engine.reset()
    return engine.world_planes()


def require_starts(starts: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Return the starts as uint8 ``(n, 4, height, width)`` if they are states of Emergency, else raise."""
    worlds = require_planes(starts, 4)
    walls, agents, people, extinguishers = np.moveaxis(worlds, 1, 0)
    for name, plane in (("agents", agents), ("extinguishers", extinguishers)):
        refuse_first(plane.sum(axis=(1, 2)) != 1, f"no or several {name}", "exactly one")
    for name, plane in (("agent", agents), ("person", people), ("extinguisher", extinguishers)):
        refuse_first((plane & walls).any(axis=(1, 2)), f"its {name} in a wall", "it on a free cell")
    counts = people.sum(axis=(1, 2))
    refuse_first(counts != counts[0], f"not {counts[0]} people as starts[0] has", "as many")
    if counts[0] > _MAX_PEOPLE:
        raise ValueError(
            f"starts have {counts[0]} people; it must be at most {_MAX_PEOPLE}, for 2**people sets are "
            "visited"
        )
    return worlds


def neighbour_offsets(worlds: npt.NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Distances in the flattened grid to the cells above, below, left and right: the order of the actions."""
    width = worlds.shape[-1]
    return -width, width, -1, 1


def people_in_each_set(worlds: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Size of every set of people, ``(2**p,)``, the set's members being the bits of its index."""
    return np.array([people.bit_count() for people in range(1 << int(worlds[0, 2].sum()))], dtype=np.int64)


def _check_rules(world: World) -> None:
    """Raise a ValueError unless the world follows Emergency's rules, with fixed people and horizon."""
    if not isinstance(world, World):
        raise ValueError(f"world is {world!r}; it must be a World, as emergency_v0.world() returns it")
    kind = world.objects[0] if world.objects else ObjectKind("people", 0, "person", "P")
    fixture = world.fixture
    for argument, value, expected in (
        ("objects", tuple(kind.name for kind in world.objects), ("people",)),
        ("reward_names", world.reward_names, ("extinguish", "save")),
        ("objective_names", world.objective_names, ("goal_time", "people_saved")),
        ("pickup", "interact" if kind.on_enter is None else "enter", "interact"),
        ("walk", kind.walks, 0.0),
        ("on_interact", kind.on_interact, Effect("save", 1.0, "people_saved")),
        ("on_stand", fixture and fixture.on_stand, Effect("extinguish", EXTINGUISH_REWARD, "goal_time")),
        ("terminates", fixture and fixture.terminates, False),
        ("slip", world.slip, 0.0),
        ("on_step", world.on_step, None),
    ):
        if value != expected:
            raise ValueError(
                f"{argument} is {value!r} in {world.name}; it must be {expected!r}, "
                "for the optimum is known only under Emergency's rules"
            )
    if kind.count > _MAX_PEOPLE:
        raise ValueError(
            f"num_people is {kind.count}; it must be at most {_MAX_PEOPLE}, for 2**people sets are visited"
        )
    if world.layout is not None:
        for argument, drawn in (*world.layout.counts, ("max_cycles", world.layout.max_cycles)):
            if isinstance(drawn, tuple) and drawn[0] != drawn[1]:
                raise ValueError(
                    f"layout draws {argument} from {drawn}; it must be one number, for the optimum is known "
                    "only of starts with the same people and horizon"
                )
