"""The speed of moral-envs beside that of its peers, on one core in one run.

    python -m benchmarks.strangers.speed

1,024 environments in one process, as users of each package step them: here ``vector_env``, there
Gymnasium's ``SyncVectorEnv`` or MO-Gymnasium's ``MOSyncVectorEnv`` and, as MOMAland has none, a loop over
environments. One bare environment of each stands beside them. Random actions are drawn beforehand. A step
counts once for every agent that acts in it; a call that only resets an environment counts for none. The
rows take turns in every round, and medians over rounds are reported.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks.strangers.record import provenance, results_file, store
from moral_envs import delivery_v0, emergency_v0

MODULES: dict[str, Any] = {"Emergency": emergency_v0, "Delivery": delivery_v0}
OURS = "moral-envs"
ALONE = "one environment"
ONE_AGENT_BAR = 3e6
MANY_AGENTS_BAR = 0.5
NUM_ACTIONS = 9
WORKAROUNDS = [
    "Minigrid's observation is a dictionary with a text in it, which SyncVectorEnv can only batch as "
    "Python objects: ImgObsWrapper leaves the picture, as most of its users do.",
    "SyncVectorEnv has no room for vector rewards: MO-Gymnasium's worlds run in its own MOSyncVectorEnv.",
    "MOMAland's item_gathering has tuples for observations and nothing that batches it: a loop over "
    "environments.",
]


@dataclass(frozen=True)
class Config:
    """What is measured.

    Parameters
    ----------
    num_envs
        Environments in a batch.
    rounds
        Measurements of every row, of which the median is taken, after one to warm up.
    agents
        Numbers of agents.
    peer_steps
        Steps of every environment of a batch of peers in one measurement.
    single_steps
        Steps of a bare environment in one measurement.
    seed
        Seed of environments and actions.
    """

    num_envs: int = 1024
    rounds: int = 5
    agents: tuple[int, ...] = (1, 2, 4, 8)
    peer_steps: int = 8
    single_steps: int = 2000
    seed: int = 0


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Parameters
    ----------
    package, world, cells
        What is stepped, and its size in cells.
    how
        How it is stepped.
    num_envs, num_agents
        Environments, and agents in each.
    take_steps
        Takes some steps and returns how many, times the number of agents.
    """

    package: str
    world: str
    cells: str
    how: str
    num_envs: int
    num_agents: int
    take_steps: Callable[[], int]


def own_rows(config: Config) -> list[Row]:
    """Rows of moral-envs."""
    rows = []
    for name, module in MODULES.items():
        cells = "{0.height}x{0.width}".format(module.world())
        for agents in config.agents:
            batch = own_batch(module, agents, config)
            rows.append(Row(OURS, name, cells, "vector_env", config.num_envs, agents, batch))
        rows.append(Row(OURS, name, cells, ALONE, 1, 1, single(f"moral/{name}-v0", config)))
        pair = module.parallel_env(num_agents=2)
        taken = parallel_envs([pair], NUM_ACTIONS, config.single_steps, config)
        rows.append(Row(OURS, name, cells, ALONE, 1, 2, taken))
    return rows


def own_batch(module: Any, num_agents: int, config: Config) -> Callable[[], int]:
    """One episode of every environment, and the call that resets them all."""
    several = {} if num_agents == 1 else {"num_agents": num_agents}
    envs = module.vector_env(config.num_envs, **several)
    envs.reset(seed=config.seed)
    horizon: int = module.world().horizon
    size = (horizon + 1, *envs.action_space.shape)
    actions = np.random.default_rng(config.seed).integers(NUM_ACTIONS, size=size)

    def take_steps() -> int:
        for joint in actions:
            envs.step(joint)
        return horizon * config.num_envs * num_agents

    return take_steps


def single(env_id: str, config: Config, *wrappers: Callable[[Any], Any]) -> Callable[[], int]:
    """One environment of ``gymnasium.make`` in a plain loop."""
    env = gymnasium.make(env_id, disable_env_checker=True)
    for wrapper in wrappers:
        env = wrapper(env)
    env.reset(seed=config.seed)
    num_actions = int(env.action_space.n)  # type: ignore[attr-defined]
    actions = np.random.default_rng(config.seed).integers(num_actions, size=config.single_steps).tolist()

    def take_steps() -> int:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return len(actions)

    return take_steps


def synchronous(
    vector: Callable[[list[Callable[[], Any]]], Any], make: Callable[[], Any], config: Config
) -> Callable[[], int]:
    """Batch in a vector environment that loops over its environments."""
    envs = vector([make] * config.num_envs)
    envs.reset(seed=config.seed)
    size = (config.peer_steps, config.num_envs)
    actions = np.random.default_rng(config.seed).integers(int(envs.single_action_space.n), size=size)
    # An environment that has ended spends the next call on its reset.
    ended = np.zeros(config.num_envs, dtype=np.bool_)

    def take_steps() -> int:
        taken = 0
        for joint in actions:
            taken += int((~ended).sum())
            _, _, terminations, truncations, _ = envs.step(joint)
            np.logical_or(terminations, truncations, out=ended)
        return taken

    return take_steps


def parallel_envs(envs: list[Any], num_actions: int, steps: int, config: Config) -> Callable[[], int]:
    """PettingZoo parallel environments in a plain loop."""
    agents = envs[0].possible_agents
    for index, env in enumerate(envs):
        env.reset(seed=config.seed + index)
    drawn = np.random.default_rng(config.seed).integers(num_actions, size=(steps, len(agents))).tolist()
    joint_actions = [dict(zip(agents, actions, strict=True)) for actions in drawn]

    def take_steps() -> int:
        for actions in joint_actions:
            for env in envs:
                if not env.agents:
                    env.reset()
                env.step(actions)
        return len(joint_actions) * len(envs) * len(agents)

    return take_steps


def peer_rows(config: Config) -> list[Row]:
    """Rows of Minigrid, MO-Gymnasium and MOMAland."""
    import minigrid  # noqa: F401  # registers its environments
    import mo_gymnasium  # noqa: F401  # registers its environments
    from gymnasium.vector import SyncVectorEnv
    from minigrid.wrappers import ImgObsWrapper
    from mo_gymnasium.wrappers.vector import MOSyncVectorEnv
    from momaland.envs.item_gathering import moitem_gathering_v0
    from momaland.envs.item_gathering.map_utils import DEFAULT_MAP

    def minigrid_world(env_id: str) -> Callable[[], Any]:
        return lambda: ImgObsWrapper(gymnasium.make(env_id, disable_env_checker=True))

    def other_world(env_id: str) -> Callable[[], Any]:
        return lambda: gymnasium.make(env_id, disable_env_checker=True)

    def item_gathering(num_agents: int) -> Any:
        grid = np.where(DEFAULT_MAP == 1, 0, DEFAULT_MAP)
        # The default map has an agent in each of two corners; more stand along its empty first and last rows.
        grid[0, ::-2][: (num_agents + 1) // 2] = 1
        grid[-1, ::2][: num_agents // 2] = 1
        return moitem_gathering_v0.parallel_env(num_timesteps=50, initial_map=grid)

    n = config.num_envs
    rows = []
    for env_id, cells in (("MiniGrid-Empty-8x8-v0", "8x8"), ("MiniGrid-FourRooms-v0", "19x19")):
        batch = synchronous(SyncVectorEnv, minigrid_world(env_id), config)
        rows.append(Row("minigrid", env_id, cells, "SyncVectorEnv", n, 1, batch))
        rows.append(Row("minigrid", env_id, cells, ALONE, 1, 1, single(env_id, config, ImgObsWrapper)))
    for env_id, cells in (("four-room-v0", "13x13"), ("resource-gathering-v0", "5x5")):
        batch = synchronous(MOSyncVectorEnv, other_world(env_id), config)
        rows.append(Row("mo-gymnasium", env_id, cells, "MOSyncVectorEnv", n, 1, batch))
        rows.append(Row("mo-gymnasium", env_id, cells, ALONE, 1, 1, single(env_id, config)))
    for agents in config.agents:
        batch = parallel_envs([item_gathering(agents) for _ in range(n)], 5, config.peer_steps, config)
        rows.append(Row("momaland", "moitem_gathering_v0", "8x8", "loop", n, agents, batch))
    pair = parallel_envs([item_gathering(2)], 5, config.single_steps, config)
    rows.append(Row("momaland", "moitem_gathering_v0", "8x8", ALONE, 1, 2, pair))
    return rows


def rate(row: Row) -> float:
    """Agent steps a second of one measurement."""
    started = time.perf_counter()
    taken = row.take_steps()
    return taken / (time.perf_counter() - started)


def measure(rows: Sequence[Row], rounds: int) -> list[float]:
    """Median agent steps a second of each row."""
    rates = [[rate(row) for row in rows] for _ in range(rounds + 1)]
    return [statistics.median(of_row) for of_row in zip(*rates[1:], strict=True)]


def summarise(rows: Sequence[Row], rates: Sequence[float], most_agents: int) -> dict[str, Any]:
    """Judge the figures that are promised, of the slower of the own worlds."""
    batches = [(row, found) for row, found in zip(rows, rates, strict=True) if row.how != ALONE]
    own = {(row.world, row.num_agents): found for row, found in batches if row.package == OURS}
    one_agent = min(own[world, 1] for world in MODULES)
    kept = {world: own[world, most_agents] / own[world, 1] for world in MODULES}
    peers = [found for row, found in batches if row.package != OURS]
    return {
        "one_agent_steps_per_second": one_agent,
        "one_agent_bar": ONE_AGENT_BAR,
        "share_kept_with_most_agents": kept,
        "share_bar": MANY_AGENTS_BAR,
        "reached": one_agent >= ONE_AGENT_BAR and min(kept.values()) >= MANY_AGENTS_BAR,
        "slower_own_world_to_fastest_peer": one_agent / max(peers) if peers else None,
    }


def table(rows: Sequence[Row], rates: Sequence[float]) -> str:
    """Format the measurements for reading."""
    widths = "{:14}{:24}{:8}{:18}{:>6}{:>8}{:>16}".format
    lines = [widths("package", "world", "cells", "stepped by", "envs", "agents", "agent steps/s")]
    for row, found in zip(rows, rates, strict=True):
        lines.append(widths(*description(row).values(), f"{found:,.0f}"))
    return "\n".join(lines)


def description(row: Row) -> dict[str, Any]:
    """Say what a line of the table says besides its rate."""
    names = ("package", "world", "cells", "how", "num_envs", "num_agents")
    return {name: getattr(row, name) for name in names}


def main(options: Sequence[str] | None = None) -> None:
    """Measure, print the table and store the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--num-envs", type=int, default=Config.num_envs, help="environments in a batch")
    parser.add_argument(
        "--rounds", type=int, default=Config.rounds, help="measurements to take the median of"
    )
    parser.add_argument("--without-peers", action="store_true", help="measure moral-envs alone")
    parser.add_argument("--json", type=Path, default=results_file("speed"), help="file for the results")
    arguments = parser.parse_args(options)
    config = Config(num_envs=arguments.num_envs, rounds=arguments.rounds)
    started = time.perf_counter()
    rows = own_rows(config) + ([] if arguments.without_peers else peer_rows(config))
    rates = measure(rows, config.rounds)
    summary = summarise(rows, rates, max(config.agents))
    print(f"One core, medians of {config.rounds} measurements\n", table(rows, rates), sep="\n")
    kept = ", ".join(f"{name} {share:.2f}" for name, share in summary["share_kept_with_most_agents"].items())
    print(f"\nAgent steps/s with {max(config.agents)} agents, in those with one: {kept}")
    peers = () if arguments.without_peers else ("minigrid", "mo-gymnasium", "momaland")
    if not arguments.without_peers:
        print("Worked around:", *WORKAROUNDS, sep="\n- ")
    record = {
        "command": "python -m benchmarks.strangers.speed",
        "config": asdict(config),
        **provenance(started, peers),
        "workarounds": WORKAROUNDS,
        "summary": summary,
        "rows": [
            {**description(row), "agent_steps_per_second": found}
            for row, found in zip(rows, rates, strict=True)
        ],
    }
    store(arguments.json, record)


if __name__ == "__main__":
    main()
