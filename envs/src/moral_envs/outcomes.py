"""A world's rules as tables: what follows when an agent's action touches a cell.

The content of the cell that an action touches, together with the action, decides where the agent goes, what
disappears, what is paid and what is counted. The engine looks this up for a whole batch at once.
"""

from __future__ import annotations

import numpy as np

from moral_envs.world import NUM_ACTIONS, NUM_MOVES, Effect, World

WAIT = NUM_MOVES
"""The action after the moves."""

FREE, WALL, FIRST_OBJECT = range(3)
"""Contents of a cell; the kinds of objects follow in the order of ``world.objects``."""


class OutcomeTables:
    """What follows from touching a cell, in rows ``content * NUM_ACTIONS + action``.

    Cells with an agent on them have rows of their own, ``occupied`` further down: there moves are blocked.

    Attributes
    ----------
    occupied : int64 array of shape (2,)
        Distance to the rows of a free cell, which is none, and of an occupied one.
    standing : int
        Distance, in ``rewards`` and ``counts``, to the rows for agents that end the step on the fixture.
    directions : int64 array of shape (NUM_ACTIONS,)
        How far away the cell lies that an action touches.
    shifts : int64 array of shape (rows,)
        By how many cells the agent moves.
    removes : bool array of shape (rows,)
        Whether the touched object disappears.
    planes : int64 array of shape (rows,)
        How far the touched object's plane lies behind the agent plane, in cells.
    rewards, counts : float32 (2 * standing, k) and int64 (2 * standing, m) arrays
        What is paid and counted.
    """

    def __init__(self, world: World) -> None:
        cells = world.height * world.width
        contents = FIRST_OBJECT + len(world.objects)
        self.occupied = np.array([0, contents * NUM_ACTIONS])
        self.standing = 2 * contents * NUM_ACTIONS
        neighbours = [-world.width, world.width, -1, 1]
        self.directions = np.array([*neighbours, 0, *neighbours], dtype=np.int64)
        # The first axis: whether the touched cell is occupied.
        shifts = np.zeros((2, contents, NUM_ACTIONS), dtype=np.int64)
        shifts[0, :, :NUM_MOVES] = neighbours
        shifts[0, WALL] = 0
        removes = np.zeros(shifts.shape, dtype=np.bool_)
        planes = np.zeros(shifts.shape, dtype=np.int64)
        # The first axis: whether the agent ends the step on the fixture.
        rewards = np.zeros((2, *shifts.shape, len(world.reward_names)), dtype=np.float64)
        counts = np.zeros((2, *shifts.shape, len(world.objective_names)), dtype=np.int64)

        def pay(effect: Effect, standing: slice | int, *where: slice | int) -> None:
            rewards[(standing, *where, ..., world.reward_names.index(effect.reward))] += effect.amount
            counts[(standing, *where, ..., world.objective_names.index(effect.objective))] += 1

        for number, kind in enumerate(world.objects):
            content = FIRST_OBJECT + number
            for effect, occupied, actions in (
                (kind.on_enter, 0, slice(0, NUM_MOVES)),
                (kind.on_interact, slice(None), slice(WAIT + 1, NUM_ACTIONS)),
            ):
                if effect is not None:
                    removes[occupied, content, actions] = True
                    planes[occupied, content, actions] = (1 + number) * cells
                    pay(effect, slice(None), occupied, content, actions)
        terminates = world.fixture is not None and world.fixture.terminates
        if world.on_step is not None:
            pay(world.on_step, 0 if terminates else slice(None))
        if world.fixture is not None:
            pay(world.fixture.on_stand, 1)

        self.shifts = shifts.ravel()
        self.removes = removes.ravel()
        self.planes = planes.ravel()
        # Added up exactly, rounded once: so they stay within the bounds that the world states.
        self.rewards = rewards.reshape(2 * self.standing, -1).astype(np.float32)
        self.counts = counts.reshape(2 * self.standing, -1)
