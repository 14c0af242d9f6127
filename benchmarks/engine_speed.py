"""How fast the environments step, on one core.

    python -m benchmarks.engine_speed

Steps include observations, rewards, objective counters and automatic resets. No batch of fresh observations
can take less time than copying as many bytes with NumPy, which is measured in turn with the steps in the same
run: the ratio of the two is comparable between machines.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import provenance
from moral_algorithms.storage import write_json
from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.world import NUM_ACTIONS

RESULTS = Path(__file__).parent / "results" / "engine_speed.json"
MODULES: dict[str, Any] = {"Emergency": emergency_v0, "Delivery": delivery_v0}


@dataclass(frozen=True)
class Config:
    """What is measured.

    Parameters
    ----------
    num_envs
        Environments in a batch.
    episodes
        Episodes per measurement.
    repeats
        Measurements, of which the median is taken.
    agents
        Numbers of agents for the engine.
    seed
        Seed of the environments and of the actions.
    """

    num_envs: int = 1024
    episodes: int = 2
    repeats: int = 15
    agents: tuple[int, ...] = (1, 2, 4, 8)
    seed: int = 0


def seconds(run: Callable[[], object]) -> float:
    """Seconds that one call takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def medians(runs: list[Callable[[], object]], repeats: int) -> list[float]:
    """Median seconds of each run; in turn, so that a busy machine slows all alike, after a warm-up round."""
    rounds = [[seconds(run) for run in runs] for _ in range(repeats + 1)]
    return [statistics.median(times) for times in zip(*rounds[1:], strict=True)]


def measure_vector(name: str, config: Config) -> dict[str, float]:
    """Vector face: environment steps per second, beside copying as many bytes as it returns observations."""
    envs = MODULES[name].vector_env(config.num_envs)
    observations, _ = envs.reset(seed=config.seed)
    # The automatic reset takes a call of its own, which is no step of an environment.
    environment_steps = config.episodes * envs.engine.world.horizon
    steps = environment_steps + config.episodes
    rng = np.random.default_rng(config.seed)
    actions = rng.integers(NUM_ACTIONS, size=(steps, config.num_envs))

    def step() -> None:
        for joint in actions:
            envs.step(joint)

    def copy() -> None:
        for _ in range(steps):
            observations.copy()

    step_seconds, copy_seconds = medians([step, copy], config.repeats)
    return {
        "steps_per_second": config.num_envs * environment_steps / step_seconds,
        "step_microseconds": step_seconds / steps * 1e6,
        "copy_microseconds": copy_seconds / steps * 1e6,
        "ratio_to_copy": step_seconds / copy_seconds,
    }


def measure_parallel(name: str, config: Config) -> dict[str, float]:
    """Parallel face with one agent: steps per second."""
    env = MODULES[name].parallel_env()
    rng = np.random.default_rng(config.seed)
    actions = rng.integers(NUM_ACTIONS, size=10 * env.engine.world.horizon).tolist()

    def run() -> None:
        for action in actions:
            if not env.agents:
                env.reset()
            env.step({"agent_0": action})

    env.reset(seed=config.seed)
    (run_seconds,) = medians([run], config.repeats)
    return {"steps_per_second": len(actions) / run_seconds}


def measure_engine(name: str, config: Config) -> dict[str, float]:
    """Engine with several agents, observations included: agent steps per second, by number of agents."""
    found = {}
    for num_agents in config.agents:
        engine = Engine(MODULES[name].world(), config.num_envs, num_agents)
        rng = np.random.default_rng(config.seed)
        actions = rng.integers(NUM_ACTIONS, size=(engine.world.horizon, config.num_envs, num_agents))

        def run(engine: Engine = engine, actions: Any = actions) -> None:
            for joint in actions:
                step = engine.step(joint)
                engine.observe()
                if step.any_end:
                    engine.reset(step.truncations)

        (run_seconds,) = medians([run], max(3, config.repeats // 3))
        found[str(num_agents)] = actions.size / run_seconds
    return found


def measure(config: Config) -> dict[str, Any]:
    """Take all measurements."""
    return {
        name: {
            "vector": measure_vector(name, config),
            "parallel": measure_parallel(name, config),
            "engine_agent_steps_per_second": measure_engine(name, config),
        }
        for name in MODULES
    }


def column(result: dict[str, Any]) -> dict[str, str]:
    """Format the measurements of one world."""
    vector, engine = result["vector"], result["engine_agent_steps_per_second"]
    return {
        "vector face, million steps/s": f"{vector['steps_per_second'] / 1e6:.1f}",
        "  one step, us": f"{vector['step_microseconds']:.1f}",
        "  copying its observations, us": f"{vector['copy_microseconds']:.1f}",
        "  ratio": f"{vector['ratio_to_copy']:.2f}",
        "parallel face, 1 agent, steps/s": f"{result['parallel']['steps_per_second']:,.0f}",
        **{f"engine, {n} agent(s), million agent steps/s": f"{engine[n] / 1e6:.1f}" for n in engine},
    }


def table(results: dict[str, Any], config: Config) -> str:
    """Format the measurements for reading."""
    lines = [f"One core, {config.num_envs} environments, medians of {config.repeats} measurements", ""]
    columns = [column(result) for result in results.values()]
    lines.append(f"{'':44}" + "".join(f"{name:>12}" for name in results))
    lines += [f"{label:44}" + "".join(f"{shown[label]:>12}" for shown in columns) for label in columns[0]]
    return "\n".join(lines)


def main(options: Sequence[str] | None = None) -> None:
    """Measure, print a table and store the figures."""
    parser = argparse.ArgumentParser(description="How fast the environments step, on one core.")
    parser.add_argument("--json", type=Path, default=RESULTS, help="file for the results")
    parser.add_argument("--num-envs", type=int, default=Config.num_envs, help="environments in a batch")
    parser.add_argument(
        "--repeats", type=int, default=Config.repeats, help="measurements to take the median of"
    )
    arguments = parser.parse_args(options)
    config = Config(num_envs=arguments.num_envs, repeats=arguments.repeats)
    started = time.perf_counter()
    results = measure(config)
    print(table(results, config))
    record = {"command": "python -m benchmarks.engine_speed", "config": asdict(config), **provenance(started)}
    write_json(arguments.json, {**record, "results": results})


if __name__ == "__main__":
    main()
