"""What the server tells of an episode, against what the tests' stand-in for it tells step by step."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from moral_algorithms.live.frames import describe_episode, describe_world
from moral_algorithms.replay import Replay
from moral_envs import delivery_v0, emergency_v0
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
