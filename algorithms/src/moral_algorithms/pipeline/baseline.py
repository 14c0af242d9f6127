"""The baseline: DRLHP, in a run directory from which it can be resumed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from moral_algorithms.learners.drlhp import (
    PRESETS,
    DRLHPConfig,
    clip_length,
    require_fitting,
    train_drlhp,
)
from moral_algorithms.learners.ppo import PPOConfig
from moral_algorithms.learners.reward_model import RewardModelConfig
from moral_algorithms.networks.files import save_action_reward, save_policy
from moral_algorithms.pipeline.resuming import read_resumable, resumable
from moral_algorithms.pipeline.stage import Setting, StageClock
from moral_algorithms.pipeline.teaching import TeacherConfig
from moral_algorithms.run_directory import RunDirectory, read_lines
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, are_numbers, has_fields, read_json, write_json
from moral_algorithms.worlds import WorldSpec

KIND = "drlhp"


@dataclass(frozen=True)
class DRLHPRun:
    """What one run of DRLHP consists of: all that its result depends on."""

    world: WorldSpec = field(default_factory=WorldSpec)
    """Where the agent acts."""
    teacher: TeacherConfig = field(default_factory=TeacherConfig)
    """Who answers."""
    seed: int = 0
    """Entropy of all of it."""
    config: DRLHPConfig = field(default_factory=DRLHPConfig)
    """How DRLHP trains and asks."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {
            "world": self.world.to_json(),
            "teacher": self.teacher.to_json(),
            "seed": self.seed,
            "drlhp": asdict(self.config),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> DRLHPRun:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is damaged.
        """
        try:
            config = dict(value["drlhp"])
            config["reward"] = RewardModelConfig(**config["reward"])
            config["ppo"] = PPOConfig(**config["ppo"])
            return cls(
                world=WorldSpec.from_json(value["world"]),
                teacher=TeacherConfig.from_json(value["teacher"]),
                seed=value["seed"],
                config=DRLHPConfig(**config),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"the run's configuration is damaged: {error}") from error


def drlhp_preset(name: str, world: WorldSpec) -> DRLHPConfig:
    """Find the configuration of a name for a world.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in PRESETS:
        raise ValueError(f"preset is {name!r}; it must be one of {sorted(PRESETS)}")
    return PRESETS[name](world)


def read_drlhp_run(directory: RunDirectory) -> DRLHPRun:
    """Read what the run of DRLHP in a directory was started with.

    Raises
    ------
    ValueError
        If there is none, or its configuration is damaged.
    """
    return DRLHPRun.from_json(read_resumable(directory, KIND))


def drlhp(directory: RunDirectory, run: DRLHPRun, setting: Setting, resume: bool = False) -> dict[str, Any]:
    """Train an agent from preferences alone, from the start or from where the run in the directory stands.

    Parameters
    ----------
    directory
        Where everything goes.
    run
        What to do; when resumed, the same as when the run was started.
    setting
        How the stage is run.
    resume
        Go on with the run in the directory; a finished one is left as it is.

    Returns
    -------
    dict
        What ``summary.json`` holds: ``queries`` and mean ``objectives`` at the end, ``env_steps`` and
        ``wall_seconds``; the seconds are those since the run was last resumed.

    Raises
    ------
    ValueError
        If the run's parts do not fit together.
    StorageError
        If something cannot be read or written, or the directory holds another run.
    """
    _require_fitting(run)
    if resume:
        read_drlhp_run(directory)
    with directory.hold():
        if not resume:
            directory.require_new()
            directory.write_config({"kind": KIND, **run.to_json(), "setting": setting.to_json()})
        else:
            directory.require_config({"kind": KIND, **run.to_json()})
            if directory.summary.exists():
                return _read_summary(directory)
            _read_metrics(directory)
        with resumable(directory, KIND):
            return _train(directory, run, setting, resume)


def _train(directory: RunDirectory, run: DRLHPRun, setting: Setting, resume: bool) -> dict[str, Any]:
    """Train from where the run in the directory stands to its end."""
    training_seed, teacher_seed = spawn_seeds(run.seed, 2)
    objective_names = run.world.build().objective_names
    teacher = run.teacher.build(objective_names, np.random.default_rng(teacher_seed))
    clock = StageClock()
    with setting.stage("drlhp") as on_progress:
        agent = train_drlhp(
            run.world,
            teacher,
            run.config,
            training_seed,
            directory,
            setting.device,
            setting.event_files(directory),
            on_progress,
            resume=resume,
        )
    save_policy(directory.policy, agent.policy, run.config.ppo.policy, run.world)
    save_action_reward(directory.path / "reward.safetensors", agent.network, run.world)
    metrics = _read_metrics(directory)
    if not metrics:
        raise StorageError(f"{directory.metrics} is damaged: it holds no rollout")
    summary = {
        "queries": agent.queries,
        "objectives": metrics[-1]["objectives"],
        "env_steps": agent.env_steps,
        "wall_seconds": clock.seconds,
    }
    write_json(directory.summary, summary)
    return summary


def _read_metrics(directory: RunDirectory) -> list[dict[str, Any]]:
    """Read the lines of the rollouts, checked."""
    lines = read_lines(directory.metrics)
    types = {"env_steps": int, "queries": int, "losses": dict, "objectives": dict}
    for number, line in enumerate(lines, start=1):
        if not has_fields(line, types):
            raise StorageError(
                f"{directory.metrics} is damaged in line {number}: it is not the line of a rollout"
            )
    return lines


def _read_summary(directory: RunDirectory) -> dict[str, Any]:
    """Read the result of a finished run, checked."""
    summary = read_json(directory.summary)
    types = {"queries": int, "objectives": dict, "env_steps": int, "wall_seconds": float}
    if not (has_fields(summary, types) and are_numbers(summary["objectives"])):
        raise StorageError(f"{directory.summary} is damaged: it is not the summary of a run of moral drlhp")
    return summary


def _require_fitting(run: DRLHPRun) -> None:
    """Raise a ValueError if a run's parts do not fit together."""
    spawn_seeds(run.seed, 1)
    world = run.world.build()
    run.teacher.require_simulated("DRLHP")
    run.teacher.require_fitting(world.objective_names)
    require_fitting(run.config, world)
    if run.teacher.teacher == "target" and clip_length(run.config, world) < world.horizon:
        raise ValueError(
            f"clip_length is {run.config.clip_length}; it must be 0 for a target, which whole episodes have"
        )
