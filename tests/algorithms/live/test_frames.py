"""What a page is told of an episode is what happened in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from moral_algorithms.live.frames import describe_episode, start
from moral_algorithms.replay import Replay
from moral_envs import burning_warehouse_v0, delivery_v0, emergency_v0
from moral_envs.world import World

WORLDS = {
    "nobody walks": emergency_v0.world(),
    "people walk": emergency_v0.world(walk=0.7),
    "people walk and are picked up": burning_warehouse_v0.world(),
    "vases break": delivery_v0.world(),
}


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS.keys())
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
                if event["step"] == step and event["objective"] not in ("goal_time",):
                    row, column = event["cell"]
                    # Something was there that the agent could reach.
                    assert before[:, row, column].any()
                    assert np.abs(engine.agent_cells[0, 0] - event["cell"]).sum() <= 1
                    count += 1
    assert count > 5


def is_there(thing: dict[str, Any], kind: str, step: int) -> bool:
    return thing["kind"] == kind and thing["from"] <= step and (thing["gone"] is None or step < thing["gone"])
