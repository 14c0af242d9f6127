"""What an episode has brought so far, as tables to show beside the grid."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moral_envs.engine import Engine


class Table(NamedTuple):
    """Numbers by name and agent."""

    title: str
    names: tuple[str, ...]
    cells: list[list[str]]
    """A row per name, a column per agent."""


class Panel:
    """The reward vectors, returns and objective counters of one environment's agents.

    Parameters
    ----------
    engine
        A batch of one environment.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        shape = (self.engine.num_agents, len(self.engine.world.reward_names))
        self.rewards = np.zeros(shape, dtype=np.float64)
        self.returns = np.zeros(shape, dtype=np.float64)

    def add(self, rewards: NDArray[np.float32]) -> None:
        """Take in the reward vectors of a step, shape (n_agents, k)."""
        assert rewards.shape == self.returns.shape
        self.rewards = rewards.astype(np.float64)
        self.returns += self.rewards

    @property
    def steps(self) -> str:
        """How far the episode is."""
        return f"step {self.engine.elapsed[0]} of {self.engine.horizons[0]}"

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """Reward vectors of the last step, returns and objective counters so far."""
        world = self.engine.world
        counters = [[str(count) for count in row] for row in self.engine.objectives[0].T]
        return (
            Table("reward of the last step", world.reward_names, _numbers(self.rewards, "+g")),
            Table("return so far", world.reward_names, _numbers(self.returns, "g")),
            Table("objectives so far", world.objective_names, counters),
        )

    @property
    def totals(self) -> tuple[str, str]:
        """Returns and objective counters of all agents together, as one line each."""
        world = self.engine.world
        # What a team shares, each of its agents has been told in full.
        told = slice(1) if self.engine.team_reward else slice(None)
        returns = [row[0] for row in _numbers(self.returns[told].sum(axis=0, keepdims=True), "g")]
        counters = self.engine.objectives[0, told].sum(axis=0).tolist()
        paid = zip(world.reward_names, returns, strict=True)
        counted = zip(world.objective_names, counters, strict=True)
        return _listed(paid), _listed(counted)

    @property
    def text(self) -> str:
        """The tables in characters of one width, a column per agent."""
        several = self.engine.num_agents > 1
        heads = [f"{number:x}" for number in range(self.engine.num_agents)] if several else ["A"]
        names = [name for table in self.tables for name in table.names]
        width = 2 + max(map(len, names))
        column = 2 + max(len(cell) for table in self.tables for row in table.cells for cell in row)
        lines = [" " * width + "".join(head.rjust(column) for head in heads)]
        for table in self.tables:
            lines.append(table.title)
            for name, row in zip(table.names, table.cells, strict=True):
                lines.append(f"  {name}".ljust(width) + "".join(cell.rjust(column) for cell in row))
        return "\n".join(lines)


def _listed(pairs: Iterable[tuple[str, object]]) -> str:
    return ", ".join(f"{name} {value}" for name, value in pairs)


def _numbers(values: NDArray[np.float64], form: str) -> list[list[str]]:
    """Write numbers by agent and name as rows by name, with no more digits than float32 has."""
    # What is left of amounts that cancel is nothing.
    rounded = values.T.round(6).tolist()
    return [[format(number, form) if number else "0" for number in row] for row in rounded]
