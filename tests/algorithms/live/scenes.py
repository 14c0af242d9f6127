"""Sessions in every state that the page knows, for its tests and its pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from moral_envs import delivery_v0, emergency_v0
from moral_envs.world import World
from tests.algorithms.live.stand_in import Game, Json, StandIn, describe_world, wandered

NOTICE = (
    "You will compare short episodes of an agent in a simulated room. Your answers and how long you took are "
    "recorded under a name that is not yours. You can stop at any moment."
)


def session(
    world: World, names: tuple[str, ...], episodes: list[tuple[Json, Json]], **status: Any
) -> StandIn:
    """A session in which each pair of episodes is an open query, 12 of 25 others being answered."""
    rng = np.random.default_rng(0)
    concentration = np.linspace(3, 9, len(names)) * 1.5
    samples = rng.dirichlet(concentration, 200)
    moments = np.arange(1, 65)
    finals = np.array([12.5, 5.6, 4.1, 0.4][: len(world.objective_names)])
    curves = finals * (1 - np.exp(-moments[:, None] / 18)) * rng.uniform(0.93, 1.07, (64, len(finals)))
    state = {
        "version": 1,
        "mode": "answer",
        "run": "runs/study",
        "who": "anonymous",
        "world": describe_world(world),
        "consent": None,
        "trainer": "running",
        "status": {
            "version": 1,
            "phase": "training",
            "progress": 0.41,
            "env_steps": 6400 * 64,
            "components": list(names),
            "weights": samples.mean(axis=0).tolist(),
            "samples": samples.tolist(),
            "answers": 12,
            "objectives": curves[-1].tolist(),
            "advice": {"regret": 0.04, "threshold": 0.005, "enough": False},
            **status,
        },
        "queue": {
            "session": "stand-in",
            "revision": 0,
            "open": [{"query": 17 + i, "expected": 0.04} for i in range(len(episodes))],
            "answered": 12,
            "queries": 25,
            "last": {"query": 16, "preference": "first"},
        },
        "curves": {
            "env_steps": (6400 * moments).tolist(),
            "answers": (moments // 5).tolist(),
            "weights": [samples.mean(axis=0).tolist()] * 64,
            "objectives": curves.tolist(),
        },
        "demonstrations": None,
    }
    stand_in = StandIn(state, {17 + i: list(pair) for i, pair in enumerate(episodes)})
    stand_in.queries[16] = list(episodes[-1])
    stand_in.standing[16] = "first"
    stand_in.latest = episodes[-1][1]
    return stand_in


def emergency(**status: Any) -> StandIn:
    """Some of the people are saved on one side, all on the other."""
    world = emergency_v0.world()
    pairs = [(wandered(world, 2 * i, []), wandered(world, 2 * i + 3, ["people"])) for i in range(3)]
    pairs.append((wandered(world, 21, ["people"]), wandered(world, 22, [])))
    return session(world, ("extinguish", "saving"), pairs, **status)


def delivery(**status: Any) -> StandIn:
    """Two norms and the deliveries: three weights."""
    world = delivery_v0.world()
    pairs = [
        (wandered(world, 1, ["deliveries", "people"]), wandered(world, 2, ["pollution", "people"])),
        (wandered(world, 3, ["people"]), wandered(world, 4, ["deliveries"])),
    ]
    return session(world, ("deliver", "helping", "cleaning"), pairs, **status)


def four_norms() -> StandIn:
    """More weights than a triangle can hold."""
    world = delivery_v0.world()
    pairs = [(wandered(world, 5, ["people"]), wandered(world, 6, ["pollution"]))]
    return session(world, ("deliver", "helping", "cleaning", "sparing"), pairs)


def preparing() -> StandIn:
    """Nothing to ask yet."""
    stand_in = emergency(
        phase="preparing", progress=0.3, samples=[], weights=[0.5, 0.5], objectives=[], answers=0
    )
    stand_in.state["queue"] = {"open": [], "answered": 0, "queries": 25, "last": None}
    stand_in.state["curves"] = {"env_steps": [], "answers": [], "weights": [], "objectives": []}
    stand_in.latest = None
    return stand_in


def waiting() -> StandIn:
    """The queue is empty for the moment."""
    stand_in = emergency()
    stand_in.state["queue"]["open"] = []
    return stand_in


def consent() -> StandIn:
    """A notice that has to be accepted."""
    stand_in = emergency()
    stand_in.state["consent"] = {"text": NOTICE, "given": False}
    return stand_in


def enough() -> StandIn:
    """More answers would change little."""
    stand_in = emergency(advice={"regret": 0.003, "threshold": 0.005, "enough": True})
    for entry in stand_in.state["queue"]["open"]:
        entry["expected"] = 0.003
    return stand_in


def closing() -> StandIn:
    """All answers are in."""
    stand_in = emergency(phase="closing", progress=0.83)
    stand_in.state["queue"] |= {"open": [], "answered": 25}
    return stand_in


def finished() -> StandIn:
    """The policy is on the disk."""
    stand_in = emergency(phase="finished", progress=1.0, objectives=[55.2, 5.98])
    stand_in.state["queue"] |= {"open": [], "answered": 25}
    return stand_in


def halted() -> StandIn:
    """The training process has died."""
    stand_in = emergency()
    stand_in.state["trainer"] = "failed"
    return stand_in


def demonstrating(world: World, wanted: int = 3) -> StandIn:
    """A person is to show the norm of saving people."""
    keys = {
        "ArrowUp": 0,
        "ArrowDown": 1,
        "ArrowLeft": 2,
        "ArrowRight": 3,
        " ": 4,
        "w": 5,
        "s": 6,
        "a": 7,
        "d": 8,
    }
    state = {
        "version": 1,
        "mode": "demonstrate",
        "run": "demonstrations.npz",
        "who": "anonymous",
        "world": describe_world(world),
        "consent": None,
        "trainer": None,
        "status": None,
        "queue": None,
        "curves": None,
        "demonstrations": {
            "kept": 0,
            "wanted": wanted,
            "instruction": "Save as many people as you can: go to each and reach out to them.",
            "out": "demonstrations.npz",
            "keys": keys,
        },
    }
    stand_in = StandIn(state, {})
    stand_in.world = world
    return stand_in


def solve(world: World, seed: int, wanted: list[str]) -> list[int]:
    """Actions of a whole episode of the game that the stand-in begins as number `seed`."""
    game = Game(world, seed)
    game.wander(wanted)
    return game.actions
