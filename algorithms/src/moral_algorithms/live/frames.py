"""What a page draws: worlds and episodes as plain values. Their fields are told in docs/live-protocol.md."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from moral_algorithms.replay import Replay
from moral_envs.engine import Engine
from moral_envs.rendering import draw_ansi
from moral_envs.world import ACTION_NAMES, NUM_ACTIONS, NUM_MOVES, World

# Rows and columns from a cell to those that the interactions reach: up, down, left, right.
_NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))


def describe_world(world: World) -> dict[str, Any]:
    """WORLD: what is the same in all episodes of a world."""
    fixture = world.fixture
    return {
        "name": world.name,
        "height": world.height,
        "width": world.width,
        "horizon": world.horizon,
        "actions": list(ACTION_NAMES[: world.num_actions]),
        "kinds": [_looks(kind) for kind in world.objects],
        "fixture": None if fixture is None else _looks(fixture),
        "objectives": list(world.objective_names),
    }


def describe_episode(world: World, replay: Replay, counted: bool = True) -> dict[str, Any]:
    """EPISODE: play an episode of one agent again and tell it step by step.

    Parameters
    ----------
    world
        Where it took place.
    replay
        The episode; it may have ended early.
    counted
        Tell events and counters, too; else they are empty.

    Raises
    ------
    ValueError
        If an action is none of the world's.
    """
    engine = start(world, replay.stream)
    planes = [engine.world_planes()[0]]
    cells = [engine.agent_cells[0, 0].tolist()]
    counters = [engine.objectives[0, 0].tolist()]
    for actions in replay.actions:
        engine.step(actions[None])
        planes.append(engine.world_planes()[0])
        cells.append(engine.agent_cells[0, 0].tolist())
        counters.append(engine.objectives[0, 0].tolist())
    things = _things(world, np.stack(planes))
    gone = [(thing["gone"], thing["cell"]) for thing in things]
    touched = [cells[0]]
    for step, action in enumerate(replay.actions[:, 0].tolist(), start=1):
        reached = _touched(cells[step], action)
        # Who slips moves instead.
        touched.append(reached if (step, reached) in gone else cells[step])
    # The agent may stand on the fixture and act on its neighbour in one step: two events, in two cells.
    standing = None if world.fixture is None else world.fixture.on_stand.objective
    events = [
        {
            "step": step,
            "objective": name,
            "cell": cells[step] if name == standing else touched[step],
        }
        for step in range(1, len(counters))
        for name, before, after in zip(world.objective_names, counters[step - 1], counters[step], strict=True)
        if after > before
    ]
    return {
        "steps": len(replay.actions),
        **_lasting(world, planes[0]),
        "agent": cells,
        "actions": replay.actions[:, 0].tolist(),
        "things": things,
        "events": events if counted else [],
        "counters": counters if counted else [],
    }


def describe_moment(engine: Engine) -> dict[str, Any]:
    """Tell the part of PLAY that is drawn: how a world with one agent stands now."""
    planes = engine.world_planes()[0]
    things = [
        {"kind": kind.name, "cell": cell}
        for kind, plane in zip(engine.world.objects, planes[2:], strict=False)
        for cell in np.argwhere(plane).tolist()
    ]
    return {
        **_lasting(engine.world, planes),
        "agent": engine.agent_cells[0, 0].tolist(),
        "things": things,
    }


def draw_frames(world: World, replay: Replay) -> list[str]:
    """Play an episode of one agent again and draw its start and the state after each step as text."""
    engine = start(world, replay.stream)
    frames = [draw_ansi(world, engine.world_planes()[0], engine.agent_cells[0])]
    for actions in replay.actions:
        engine.step(actions[None])
        frames.append(draw_ansi(world, engine.world_planes()[0], engine.agent_cells[0]))
    return frames


def start(world: World, stream: int) -> Engine:
    """Start the episode of a random stream, with one agent."""
    engine = Engine(world)
    engine.seed(np.array([stream], dtype=np.uint64))
    engine.reset()
    return engine


def _lasting(world: World, planes: NDArray[np.uint8]) -> dict[str, Any]:
    fixture = None if world.fixture is None else np.argwhere(planes[-1])[0].tolist()
    return {"walls": ["".join(map(str, row)) for row in planes[0].tolist()], "fixture": fixture}


def _touched(cell: list[int], action: int) -> list[int]:
    """Find the cell that an agent in a cell has acted on: its neighbour, or after a move its own."""
    if action < NUM_ACTIONS - NUM_MOVES:
        return cell
    row, column = _NEIGHBOURS[action - (NUM_ACTIONS - NUM_MOVES)]
    return [cell[0] + row, cell[1] + column]


def _things(world: World, planes: NDArray[np.uint8]) -> list[dict[str, Any]]:
    """Tell in which of the states (T + 1, C, H, W) objects are in a cell first, and first no more.

    Those that walk are told anew in every cell they come to.
    """
    things = []
    for kind, number in zip(world.objects, range(2, planes.shape[1]), strict=False):
        there = planes[:, number] > 0
        before = np.concatenate([np.zeros_like(there[:1]), there[:-1]])
        for since, row, column in np.argwhere(there & ~before).tolist():
            gone = np.flatnonzero(~there[since:, row, column])
            until = since + int(gone[0]) if gone.size else None
            things.append({"kind": kind.name, "cell": [row, column], "from": since, "gone": until})
    return things


def _looks(thing: Any) -> dict[str, str]:
    return {"name": thing.name, "pattern": thing.pattern, "symbol": thing.symbol}
