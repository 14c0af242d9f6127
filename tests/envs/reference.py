"""A slow simulator of one environment, written from the rules: plain Python, one agent at a time."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from moral_envs.engine import Engine
from moral_envs.streams import draw_integers
from moral_envs.world import Effect, World

Cell = tuple[int, int]

CHANCES = 2**16
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
    walls: set[Cell]
    fixture_cell: Cell | None
    horizon: int
    stream: NDArray[np.uint64]
    """State of the random stream, shape (1,)."""
    walkers: list[tuple[float, Cell | None]]
    """Chance and cell of every object that walks; None once it is gone."""
    team_reward: bool = False
    agent_rewards: list[list[str]] | None = None
    view_radius: int | None = None
    time: int = 0
    objectives: list[list[int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.objectives = [[0] * len(self.world.objective_names) for _ in self.agents]

    @property
    def terminated(self) -> bool:
        fixture = self.world.fixture
        return fixture is not None and fixture.terminates and self.fixture_cell in self.agents

    @property
    def truncated(self) -> bool:
        return self.time >= self.horizon and not self.terminated

    def step(self, actions: list[int]) -> list[list[float]]:
        """Let all agents act, one after the other, and then what walks; returns the reward vectors."""
        slips = [self.luck() for _ in self.agents] if self.world.slip > 0 else []
        walks = [self.luck() for _ in self.walkers]
        if slips:
            chosen = zip(slips, actions, strict=True)
            actions = [way if luck < self.world.slip else action for (luck, way), action in chosen]
        rewards = [[0.0] * len(self.world.reward_names) for _ in self.agents]
        for agent in self.order():
            for effect in self.act(agent, actions[agent]):
                paid = range(len(self.agents)) if self.team_reward else [agent]
                for receiver in paid:
                    if self.agent_rewards is None or effect.reward in self.agent_rewards[receiver]:
                        rewards[receiver][self.world.reward_names.index(effect.reward)] += effect.amount
                    self.objectives[receiver][self.world.objective_names.index(effect.objective)] += 1
        for number, (luck, way) in enumerate(walks):
            chance, cell = self.walkers[number]
            if cell is not None and luck < chance:
                self.walk(number, cell, way)
        self.time += 1
        return rewards

    def luck(self) -> tuple[float, int]:
        """Draw a number below 1 and a direction."""
        number, way = draw_integers(self.stream, np.array([CHANCES, 4], dtype=np.uint64))[:, 0]
        return number / CHANCES, int(way)

    def walk(self, number: int, cell: Cell, way: int) -> None:
        """Let an object take a step, if nothing is in its way."""
        target = cell[0] + MOVES[way][0], cell[1] + MOVES[way][1]
        if target not in self.walls and target not in self.objects and target not in self.agents:
            self.objects[target] = self.objects.pop(cell)
            self.walkers[number] = self.walkers[number][0], target

    def remove(self, cell: Cell) -> None:
        del self.objects[cell]
        self.walkers = [(chance, None if at == cell else at) for chance, at in self.walkers]

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
            if target not in self.walls and target not in self.agents:
                self.agents[agent] = target
                kind = self.objects.get(target)
                if kind is not None and (effect := self.world.objects[kind].on_enter) is not None:
                    self.remove(target)
                    happened.append(effect)
        elif action in INTERACTIONS:
            target = row + INTERACTIONS[action][0], column + INTERACTIONS[action][1]
            kind = self.objects.get(target)
            if kind is not None and (effect := self.world.objects[kind].on_interact) is not None:
                self.remove(target)
                happened.append(effect)
        fixture = self.world.fixture
        standing = fixture is not None and self.agents[agent] == self.fixture_cell
        if fixture is not None and standing:
            happened.append(fixture.on_stand)
        if self.world.on_step is not None and not (fixture is not None and fixture.terminates and standing):
            happened.append(self.world.on_step)
        return happened

    def observe(self, agent: int) -> NDArray[np.uint8]:
        """What one agent sees, uint8 (C, H, W)."""
        shape = self.world.height, self.world.width
        walls, own, others = (np.zeros(shape, dtype=np.uint8) for _ in range(3))
        for cell in np.ndindex(*shape):
            walls[cell] = cell in self.walls
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
        return np.stack(planes) if self.view_radius is None else self.window(planes, self.agents[agent])

    def window(self, planes: list[NDArray[np.uint8]], centre: Cell) -> NDArray[np.uint8]:
        """The part of the planes around a cell, walls beyond the border."""
        assert self.view_radius is not None
        ways = range(-self.view_radius, self.view_radius + 1)
        seen = np.zeros((len(planes), len(ways), len(ways)), dtype=np.uint8)
        for (i, down), (j, right) in itertools.product(enumerate(ways), enumerate(ways)):
            row, column = centre[0] + down, centre[1] + right
            if 0 <= row < self.world.height and 0 <= column < self.world.width:
                seen[:, i, j] = [plane[row, column] for plane in planes]
            else:
                seen[0, i, j] = 1
        return seen


def references(engine: Engine) -> list[Reference]:
    """A slow simulator for each of the engine's environments, from their present placing on."""
    world, state = engine.world, engine.state_dict()
    planes, agent_cells = engine.world_planes(), engine.agent_cells
    chances = [kind.walks for kind in world.objects for _ in range(kind.count) if kind.walks > 0]
    walker_cells = state.get("walker_cells", np.zeros((0, engine.num_envs), dtype=np.int64))
    walking = state.get("walking", np.zeros((0, engine.num_envs), dtype=np.bool_))
    paid = engine.agent_rewards
    agent_rewards = None
    if paid is not None:
        agent_rewards = [list(itertools.compress(world.reward_names, row)) for row in paid]
    built = []
    for env in range(engine.num_envs):

        def cells(plane: NDArray[np.uint8]) -> list[Cell]:
            return [(int(row), int(column)) for row, column in np.argwhere(plane)]

        objects = {cell: kind for kind in range(len(world.objects)) for cell in cells(planes[env, 2 + kind])}
        walkers = [
            (chance, divmod(int(cell), world.width) if there else None)
            for chance, cell, there in zip(chances, walker_cells[:, env], walking[:, env], strict=True)
        ]
        built.append(
            Reference(
                world,
                [(int(row), int(column)) for row, column in agent_cells[env]],
                objects,
                int(state["turn_offsets"][env]),
                walls=set(cells(planes[env, 0])),
                fixture_cell=None if world.fixture is None else cells(planes[env, -1])[0],
                horizon=int(engine.horizons[env]),
                stream=engine.streams[env : env + 1],
                walkers=walkers,
                team_reward=engine.team_reward,
                agent_rewards=agent_rewards,
                view_radius=engine.view_radius,
            )
        )
    return built
