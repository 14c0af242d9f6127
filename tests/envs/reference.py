"""A slow simulator of one environment, written from the rules: plain Python, one agent at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from moral_envs.engine import Engine
from moral_envs.world import Effect, World

Cell = tuple[int, int]

MOVES = {0: (-1, 0), 1: (1, 0), 2: (0, -1), 3: (0, 1)}
INTERACTIONS = {5: (-1, 0), 6: (1, 0), 7: (0, -1), 8: (0, 1)}


@dataclass
class Reference:
    """One environment, from the start of an episode on."""

    world: World
    agents: list[Cell]
    objects: dict[Cell, int]
    """The kind, as its position in ``world.objects``, of the object on a cell."""
    turn_offset: int
    team_reward: bool = False
    time: int = 0
    objectives: list[list[int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.objectives = [[0] * len(self.world.objective_names) for _ in self.agents]

    @property
    def fixture_cell(self) -> Cell:
        return self.world.height - 2, self.world.width - 2

    @property
    def ended(self) -> bool:
        return self.time >= self.world.horizon

    def is_wall(self, cell: Cell) -> bool:
        row, column = cell
        return row in (0, self.world.height - 1) or column in (0, self.world.width - 1)

    def step(self, actions: list[int]) -> list[list[float]]:
        """Let all agents act, one after the other; returns their reward vectors."""
        rewards = [[0.0] * len(self.world.reward_names) for _ in self.agents]
        for agent in self.order():
            for effect in self.act(agent, actions[agent]):
                paid = range(len(self.agents)) if self.team_reward else [agent]
                for receiver in paid:
                    rewards[receiver][self.world.reward_names.index(effect.reward)] += effect.amount
                    self.objectives[receiver][self.world.objective_names.index(effect.objective)] += 1
        self.time += 1
        return rewards

    def order(self) -> list[int]:
        """The agents in the order in which they act: rounds of n steps, upwards and downwards by turns."""
        num_agents = len(self.agents)
        past_rounds, first = divmod(self.turn_offset + self.time, num_agents)
        upwards = [*range(first, num_agents), *range(first)]
        return upwards if past_rounds % 2 == 0 else [first, *reversed(upwards[1:])]

    def act(self, agent: int, action: int) -> list[Effect]:
        """Let one agent act; returns what has happened."""
        happened = []
        row, column = self.agents[agent]
        if action in MOVES:
            target = row + MOVES[action][0], column + MOVES[action][1]
            if not self.is_wall(target) and target not in self.agents:
                self.agents[agent] = target
                kind = self.objects.get(target)
                if kind is not None and (effect := self.world.objects[kind].on_enter) is not None:
                    del self.objects[target]
                    happened.append(effect)
        elif action in INTERACTIONS:
            target = row + INTERACTIONS[action][0], column + INTERACTIONS[action][1]
            kind = self.objects.get(target)
            if kind is not None and (effect := self.world.objects[kind].on_interact) is not None:
                del self.objects[target]
                happened.append(effect)
        if self.world.fixture is not None and self.agents[agent] == self.fixture_cell:
            happened.append(self.world.fixture.on_stand)
        return happened

    def observe(self, agent: int) -> NDArray[np.uint8]:
        """What one agent sees, uint8 (C, H, W)."""
        shape = self.world.height, self.world.width
        walls, own, others = (np.zeros(shape, dtype=np.uint8) for _ in range(3))
        for cell in np.ndindex(*shape):
            walls[cell] = self.is_wall((cell[0], cell[1]))
        own[self.agents[agent]] = 1
        planes = [walls, own]
        for kind in range(len(self.world.objects)):
            plane = np.zeros(shape, dtype=np.uint8)
            for cell_, found in self.objects.items():
                plane[cell_] = found == kind
            planes.append(plane)
        if self.world.fixture is not None:
            plane = np.zeros(shape, dtype=np.uint8)
            plane[self.fixture_cell] = 1
            planes.append(plane)
        if len(self.agents) > 1:
            for other, cell_ in enumerate(self.agents):
                others[cell_] = other != agent
            planes.append(others)
        return np.stack(planes)


def references(engine: Engine) -> list[Reference]:
    """A slow simulator for each of the engine's environments, from their present placing on."""
    planes, cells = engine.observe()[:, 0], engine.agent_cells
    turn_offsets = engine.state_dict()["turn_offsets"]
    built = []
    for env in range(engine.num_envs):
        objects = {
            (int(row), int(column)): kind
            for kind in range(len(engine.world.objects))
            for row, column in np.argwhere(planes[env, 2 + kind])
        }
        agents = [(int(row), int(column)) for row, column in cells[env]]
        built.append(Reference(engine.world, agents, objects, int(turn_offsets[env]), engine.team_reward))
    return built
