"""The strangers' benchmarks, as far as they need no package beyond the development tools."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from benchmarks.strangers import envelope, momaland_chain, record, speed, training
from benchmarks.strangers.egocentric import AGENT, Egocentric, crop, cropped_space
from benchmarks.strangers.training import Stranger
from moral_envs import delivery_v0

FOLDER = Path(envelope.__file__).parent
STORED = ("envelope", "mo_gymnasium_chain", "momaland_chain", "sb3_linear_reward", "speed")
TINY = speed.Config(num_envs=4, rounds=1, agents=(1, 2), single_steps=80)


def stored(stranger: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(record.results_file(stranger).read_text())
    return loaded


@pytest.mark.parametrize("radius", [1, 5, 9])
def test_the_crop_shows_each_cell_where_it_is_from_the_agent(radius: int) -> None:
    env = gymnasium.make("moral/Delivery-v0")
    planes, _ = env.reset(seed=3)
    row, column = np.argwhere(planes[AGENT])[0]
    shown = crop(planes, radius).reshape(len(planes) - 1, 2 * radius + 1, 2 * radius + 1)
    others = np.delete(planes, AGENT, axis=0)
    for i, j in np.ndindex(shown.shape[1:]):
        at = (row + i - radius, column + j - radius)
        inside = 0 <= at[0] < planes.shape[1] and 0 <= at[1] < planes.shape[2]
        expected = others[:, at[0], at[1]] if inside else [1, 0, 0, 0, 0]
        np.testing.assert_array_equal(shown[:, i, j], expected)


def test_the_egocentric_wrapper_keeps_to_its_space() -> None:
    env = Egocentric(gymnasium.make("moral/Emergency-v0"), radius=2)
    observation, _ = env.reset(seed=0)
    assert env.observation_space == cropped_space(env.unwrapped.observation_space, 2)
    assert env.observation_space.contains(observation)


def test_final_objectives_are_those_of_the_whole_episode() -> None:
    env = gymnasium.make("moral/Emergency-v0")
    waiting = training.final_objectives(env, lambda observation: 4, range(20))
    # Whoever waits saves nobody, and is paid for all 75 steps or for none.
    assert set(waiting[:, 0]) == {0, 75}
    assert not waiting[:, 1].any()


def test_emergency_is_judged_between_random_actions_and_the_optimum() -> None:
    config = LittleSettings(starts=3)
    found = training.emergency_baselines(config)
    assert found["random"]["scalarised_return"] < found["optimum"]["scalarised_return"]
    assert found["optimum"]["people_saved"] == 6.0
    by_hand = training.emergency_utility(np.array([[10, 2], [30, 4]]), config)
    assert by_hand == {"scalarised_return": pytest.approx(2.5), "goal_time": 20.0, "people_saved": 3.0}


def test_delivery_adds_up_what_all_agents_do() -> None:
    config = replace(momaland_chain.Config(), starts=2)
    found = momaland_chain.outcome(training.random_policy(9), config)
    env = delivery_v0.parallel_env(num_agents=2)
    act = training.random_policy(9)
    totals = np.zeros(4)
    for seed in (10_000, 10_001):
        env.reset(seed=seed)
        while env.agents:
            _, rewards, _, _, _ = env.step({agent: act(None) for agent in env.agents})
            totals += np.sum(list(rewards.values()), axis=0)
    assert found["scalarised_return"] == pytest.approx(totals.sum() / 4 / 2)
    assert found["vases_broken"] == -totals[3] / 2


@dataclass(frozen=True)
class LittleSettings:
    steps: int = 7
    weights: tuple[float, float] = (0.5, 0.5)
    starts: int = 1
    first_start: int = 0


def test_a_stranger_reports_every_seed_and_its_workarounds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(seed: int, config: LittleSettings) -> dict[str, Any]:
        return {"scalarised_return": float(seed + config.steps)}

    def baselines(config: LittleSettings) -> dict[str, dict[str, float]]:
        return {"random": {"scalarised_return": 1.0}, "optimum": {"scalarised_return": 21.0}}

    def fail(seed: int, config: LittleSettings) -> dict[str, Any]:
        raise AssertionError(f"seed {seed} is there already")

    path = tmp_path / "results.json"
    stranger = Stranger("nobody", "Nobody.", run, baselines, ["nothing fits"], ["pytest"])
    options = ["--seeds", "0", "2", "4", "--steps", "9", "--json", str(path)]
    training.train_and_report(stranger, LittleSettings(), options)
    found = json.loads(path.read_text())
    assert [one["scalarised_return"] for one in found["runs"]] == [9.0, 11.0, 13.0]
    assert found["summary"] == {
        "mean": 11.0,
        "standard_deviation": 2.0,
        "least": 9.0,
        "random": 1.0,
        "optimum": 21.0,
        "share_of_the_way": 0.5,
    }
    assert found["config"]["steps"] == 9
    assert found["workarounds"] == ["nothing fits"]
    assert {"python", "moral-envs", "pytest"} <= found["versions"].keys()
    assert "- nothing fits" in capsys.readouterr().out
    training.train_and_report(replace(stranger, run=fail), LittleSettings(), [*options, "--resume"])
    assert json.loads(path.read_text()) == found
    assert list(tmp_path.iterdir()) == [path]


def test_the_exact_front_is_that_of_the_held_out_starts() -> None:
    config = replace(envelope.Config(), starts=4)
    front = envelope.exact_front(config)
    assert (np.diff(front[:, 0]) < 0).all()
    assert (np.diff(front[:, 1]) > 0).all()
    assert front[-1, 1] == 6.0
    assert front[0, 0] <= 7.5


def test_kept_runs_are_those_with_the_same_settings(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    config = asdict(envelope.Config())
    assert record.kept_runs(path, (0, 1, 2), config) == []
    runs = [{"seed": 0, "ratio": 0.7}, {"seed": 9, "ratio": 0.5}]
    record.store(path, {"config": config, "runs": runs})
    assert record.kept_runs(path, (0, 1, 2), config) == [runs[0]]
    assert record.kept_runs(path, (9,), {**config, "seeds": (9,)}) == [runs[1]]
    assert record.kept_runs(path, (0, 1, 2), {**config, "steps": 1}) == []


def test_every_seed_has_to_reach_the_bar() -> None:
    assert envelope.summarise([{"ratio": 0.7}, {"ratio": 0.61}])["reached"]
    assert not envelope.summarise([{"ratio": 0.9}, {"ratio": 0.59}])["reached"]


@pytest.mark.parametrize("stranger", STORED)
def test_stored_results_say_what_produced_them_and_what_was_worked_around(stranger: str) -> None:
    found = stored(stranger)
    assert found["command"] == f"python -m benchmarks.strangers.{stranger}"
    assert {"python", "moral-envs", "gymnasium"} <= found["versions"].keys()
    assert len(found["moral_envs_wheel"]) == 64
    assert found["workarounds"]
    assert all(len(text.split()) > 5 for text in found["workarounds"])
    assert found["summary"]


def test_envelope_reached_its_share_of_the_exact_hypervolume() -> None:
    found = stored("envelope")
    assert [one["seed"] for one in found["runs"]] == [0, 1, 2]
    assert found["config"]["starts"] >= 100
    assert all(one["ratio"] == one["hypervolume"] / one["exact_hypervolume"] for one in found["runs"])
    assert found["summary"]["ratio_least"] >= envelope.BAR


@pytest.mark.parametrize("stranger", ["mo_gymnasium_chain", "momaland_chain", "sb3_linear_reward"])
def test_every_seed_learned_well_beyond_random_actions(stranger: str) -> None:
    found = stored(stranger)
    assert len(found["runs"]) == 3
    assert found["summary"]["least"] > 1.25 * found["summary"]["random"] > 0


def test_steps_are_counted_once_for_every_agent_and_resets_never() -> None:
    horizon = 75
    batch = speed.own_batch(speed.MODULES["Emergency"], 2, TINY)
    assert batch() == horizon * TINY.num_envs * 2

    def make() -> ScalarReward:
        return ScalarReward(gymnasium.make("moral/Emergency-v0", max_cycles=3))

    peers = speed.synchronous(SyncVectorEnv, make, replace(TINY, peer_steps=8))
    # Of eight calls the fourth and the eighth only reset.
    assert peers() == 6 * TINY.num_envs
    parallel = speed.parallel_envs([delivery_v0.parallel_env(num_agents=2)], 9, 120, TINY)
    assert parallel() == 240


class ScalarReward(gymnasium.RewardWrapper[Any, Any]):
    def reward(self, reward: Any) -> float:
        return float(reward.sum())


def test_the_table_holds_every_row_and_the_summary_its_bars(tmp_path: Path) -> None:
    path = tmp_path / "speed.json"
    speed.main(["--num-envs", "4", "--rounds", "1", "--without-peers", "--json", str(path)])
    found = json.loads(path.read_text())
    assert len(found["rows"]) == 2 * (4 + 2)
    assert all(row["agent_steps_per_second"] > 0 for row in found["rows"])
    rates = {(row["world"], row["num_agents"]): row["agent_steps_per_second"] for row in found["rows"][:4]}
    share = found["summary"]["share_kept_with_most_agents"]["Emergency"]
    assert share == rates["Emergency", 8] / rates["Emergency", 1]


@pytest.mark.parametrize(
    ("delivery", "share", "reached"), [(3e6, 1.5e6, True), (2.9e6, 2e6, False), (4e6, 1.9e6, False)]
)
def test_the_speed_bars_are_those_of_the_slower_world(delivery: float, share: float, reached: bool) -> None:
    def row(package: str, world: str, how: str, agents: int) -> speed.Row:
        return speed.Row(package, world, "8x8", how, 1024, agents, lambda: 0)

    rows = [row(speed.OURS, world, "vector_env", agents) for world in speed.MODULES for agents in (1, 8)]
    rows += [row(speed.OURS, "Delivery", speed.ALONE, 1), row("peer", "its world", "loop", 1)]
    found = speed.summarise(rows, [9e6, 9e6, delivery, share, 1.0, 1e5], most_agents=8)
    assert found["one_agent_steps_per_second"] == delivery
    assert found["share_kept_with_most_agents"] == {"Emergency": 1.0, "Delivery": share / delivery}
    assert found["slower_own_world_to_fastest_peer"] == delivery / 1e5
    assert found["reached"] is reached


def test_what_is_installed_is_pinned() -> None:
    pins = (FOLDER / "constraints.txt").read_text().lower().replace("_", "-").splitlines()
    pinned = {line.split("==")[0] for line in pins if "==" in line}
    asked = [line for line in (FOLDER / "requirements.txt").read_text().splitlines() if line[0] != "#"]
    assert set(asked) | {"morl-baselines", "mo-gymnasium", "momaland"} <= pinned
