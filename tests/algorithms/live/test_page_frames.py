"""What the server tells of an episode, against the tests' stand-in for it and against the engine."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moral_algorithms.live.frames import describe_episode, describe_world, start
from moral_algorithms.replay import Replay
from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0
from moral_envs.streams import spawn_streams
from moral_envs.world import World
from tests.algorithms.live import stand_in

WORLDS = (
    emergency_v0.world(height=5, width=5, num_people=3, max_cycles=20),
    delivery_v0.world(height=8, width=8, num_deliveries=4, num_people=4, num_pollution=4, num_vases=4),
)


def both(world: World, seed: int, actions: list[int]) -> tuple[stand_in.Json, stand_in.Json]:
    """The episode as the server tells it, and as the stand-in does."""
    game = stand_in.Game(world, seed)
    for action in actions:
        game.act(action)
    replay = Replay(int(spawn_streams(seed, 1)[0]), np.array(actions, dtype=np.uint8)[:, None])
    return describe_episode(world, replay), game.episode()


@given(st.sampled_from(WORLDS), st.integers(0, 10_000))
def test_an_episode_is_told_as_it_happened(world: World, seed: int) -> None:
    actions = np.random.default_rng(seed).integers(world.num_actions, size=world.horizon).tolist()
    found, expected = both(world, seed, actions)
    assert found == expected


def test_saving_a_neighbour_from_the_extinguisher_happens_in_two_cells() -> None:
    world = emergency_v0.world(height=4, width=4, num_people=2, max_cycles=4)
    told = []
    for seed in range(40):
        # Down and right to the extinguisher, then reach up and left from it.
        found, expected = both(world, seed, [1, 3, 5, 7])
        assert found["events"] == expected["events"]
        told += [
            {event["objective"]: event["cell"] for event in found["events"] if event["step"] == step}
            for step in (3, 4)
        ]
    at_once = [cells for cells in told if len(cells) == 2]
    assert at_once
    assert all(cells["goal_time"] == [2, 2] != cells["people_saved"] for cells in at_once)


def test_a_world_is_told_as_it_is() -> None:
    for world in WORLDS:
        assert describe_world(world) == stand_in.describe_world(world)


MORE_WORLDS = {
    "nobody walks": emergency_v0.world(),
    "people walk": emergency_v0.world(walk=0.7),
    "people walk and are picked up": burning_warehouse_v0.world(),
    "vases break": delivery_v0.world(),
}


@pytest.mark.parametrize("world", MORE_WORLDS.values(), ids=MORE_WORLDS.keys())
def test_everything_is_told_where_it_is(world: World) -> None:
    rng = np.random.default_rng(0)
    count = 0
    for stream in range(5):
        actions = rng.integers(world.num_actions, size=(world.horizon, 1)).astype(np.uint8)
        episode = describe_episode(world, Replay(stream, actions))
        engine = start(world, stream)
        for step in range(world.horizon + 1):
            before = engine.world_planes()[0, 2:]
            if step:
                engine.step(actions[step - 1][None])
            planes = engine.world_planes()[0, 2:]
            for kind, plane in zip(world.objects, planes, strict=False):
                told = [thing["cell"] for thing in episode["things"] if is_there(thing, kind.name, step)]
                assert sorted(told) == np.argwhere(plane).tolist()
            for event in episode["events"]:
                if event["step"] == step and event["objective"] != "goal_time":
                    row, column = event["cell"]
                    # Something was there that the agent could reach.
                    assert before[:, row, column].any()
                    assert np.abs(engine.agent_cells[0, 0] - event["cell"]).sum() <= 1
                    count += 1
    assert count > 5


def is_there(thing: dict[str, Any], kind: str, step: int) -> bool:
    return thing["kind"] == kind and thing["from"] <= step and (thing["gone"] is None or step < thing["gone"])
