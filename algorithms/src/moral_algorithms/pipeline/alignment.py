"""The fourth stage: MORAL, in a run directory from which it can be resumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from moral_algorithms.answers import Answer, read_answers
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.moral import MoralConfig, require_trainable, train_moral
from moral_algorithms.learners.ppo import PPOConfig
from moral_algorithms.learners.query_queue import People
from moral_algorithms.learners.recorded import RecordedAnswers
from moral_algorithms.networks.files import save_policy
from moral_algorithms.pipeline.resuming import read_resumable, resumable
from moral_algorithms.pipeline.reward_vector import (
    copy_reward_vector,
    copy_rewards,
    normaliser_config,
    primary_normalisers,
    require_reward_vector,
    require_worlds,
    reward_components,
    total,
)
from moral_algorithms.pipeline.stage import Setting, StageClock, name_values
from moral_algorithms.pipeline.teaching import RECORDED, TeacherConfig
from moral_algorithms.preferences import Teacher
from moral_algorithms.run_directory import RunDirectory, read_lines, write_lines
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, are_numbers, has_fields, read_json, write_json
from moral_algorithms.worlds import WorldSpec

KIND = "train"
"""Kind of the run, which is also the command that makes it."""

_RECORDED = "recorded.jsonl"


@dataclass(frozen=True)
class MoralRun:
    """What one run of MORAL consists of: all that its result depends on."""

    rewards: tuple[Path, ...]
    """Run directories of AIRL, one per expert; the components are learned_1, learned_2 and so on."""
    world: WorldSpec = field(default_factory=WorldSpec)
    """Where the agent acts."""
    primary: tuple[str, ...] = ("extinguish",)
    """Components of the world's reward vector that the agent is given."""
    teacher: TeacherConfig = field(default_factory=TeacherConfig)
    """Who answers."""
    seed: int = 0
    """Entropy of all of it."""
    config: MoralConfig = field(default_factory=MoralConfig)
    """How MORAL trains and asks."""
    normaliser: ExpertConfig = None  # type: ignore[assignment]
    """How the policies are trained that pursue one primary component alone; their returns normalise it. By
    default as suits the world."""
    returns: dict[str, float] = field(default_factory=dict)
    """Such returns that are known already, by component; for these no policy is trained."""

    def __post_init__(self) -> None:
        if cast("ExpertConfig | None", self.normaliser) is None:
            object.__setattr__(self, "normaliser", normaliser_config(self.world.name))

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {
            "world": self.world.to_json(),
            "rewards": [str(path) for path in self.rewards],
            "primary": list(self.primary),
            "teacher": self.teacher.to_json(),
            "seed": self.seed,
            "moral": asdict(self.config),
            "normaliser": asdict(self.normaliser),
            "returns": dict(self.returns),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> MoralRun:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is damaged.
        """

        def with_ppo(values: dict[str, Any]) -> dict[str, Any]:
            return {**values, "ppo": PPOConfig(**values["ppo"])}

        try:
            return cls(
                rewards=tuple(Path(path) for path in value["rewards"]),
                world=WorldSpec.from_json(value["world"]),
                primary=tuple(value["primary"]),
                teacher=TeacherConfig.from_json(value["teacher"]),
                seed=value["seed"],
                config=MoralConfig(**with_ppo(value["moral"])),
                normaliser=ExpertConfig(**with_ppo(value["normaliser"])),
                returns=dict(value["returns"]),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"the run's configuration is damaged: {error}") from error


def read_moral_run(directory: RunDirectory) -> MoralRun:
    """Read what the run of MORAL in a directory was started with.

    Raises
    ------
    StorageError
        If there is none.
    """
    return MoralRun.from_json(read_resumable(directory, KIND))


def moral(directory: RunDirectory, run: MoralRun, setting: Setting, resume: bool = False) -> dict[str, Any]:
    """Train an aligned agent, from the start or from where the run in the directory stands.

    The primary components' normalisers and copies of the reward networks are kept in the directory, so that a
    resumed run needs nothing else.

    Parameters
    ----------
    directory
        Where everything goes.
    run
        What to do; when resumed, the same as when the run was started.
    setting
        How the stages are run.
    resume
        Go on with the run in the directory; a finished one is left as it is.

    Returns
    -------
    dict
        What ``summary.json`` holds: ``queries``, ``weights`` and mean ``objectives`` at the end, and
        ``env_steps`` and ``wall_seconds`` of the stages ``primary`` and ``moral``; the seconds of ``moral``
        are those since it was last resumed.

    Raises
    ------
    ValueError
        If the run's parts do not fit together.
    StorageError
        If something cannot be read or written, or the directory holds another run.
    """
    _require_fitting(run)
    if resume:
        read_moral_run(directory)
    else:
        _require_startable(run)
    with directory.hold():
        if not resume:
            _begin(directory, run, setting)
        else:
            directory.require_config({"kind": KIND, **run.to_json()})
            if directory.summary.exists():
                return read_aligned_summary(directory.summary, KIND)
            read_metrics(directory.metrics)
        with resumable(directory, KIND):
            return _train(directory, run, setting, resume)


def begin_moral(directory: RunDirectory, run: MoralRun, setting: Setting) -> None:
    """Prepare a directory for a run, which :func:`moral` then resumes: in another process, for instance.

    Raises
    ------
    ValueError
        If the run's parts do not fit together.
    StorageError
        If something cannot be read or written, or the directory holds a run already.
    """
    _require_fitting(run)
    _require_startable(run)
    with directory.hold():
        _begin(directory, run, setting)


def begin_replay(
    directory: RunDirectory, source: RunDirectory, answers: Sequence[Answer], setting: Setting, seed: int
) -> MoralRun:
    """Prepare a directory for training once more from recorded answers, which :func:`moral` then resumes.

    Parameters
    ----------
    directory
        Where the new run goes.
    source
        The run whose world, rewards and settings it takes.
    answers
        The answers, in the order in which they are used.
    setting
        How it is run.
    seed
        Entropy of all of it.

    Raises
    ------
    ValueError
        If there is no answer.
    StorageError
        If something cannot be read or written, or the directory holds a run already.
    """
    before = read_moral_run(source)
    if not answers:
        raise ValueError("answers are none; there must be at least one to learn from")
    run = replace(
        before,
        teacher=TeacherConfig(teacher=RECORDED),
        seed=seed,
        config=replace(before.config, queries=len(answers)),
    )
    _require_fitting(run)
    numbered = [
        replace(answer, asked=replace(answer.asked, number=number, repeats=None), key=None)
        for number, answer in enumerate(answers)
    ]
    with directory.hold():
        directory.require_new()
        write_lines(directory.path / _RECORDED, (answer.to_json() for answer in numbered))
        copy_reward_vector(directory, source, run)
        _write_config(directory, run, setting)
    return run


def _begin(directory: RunDirectory, run: MoralRun, setting: Setting) -> None:
    """Copy the reward networks and write the configuration, last."""
    directory.require_new()
    copy_rewards(directory, run)
    _write_config(directory, run, setting)


def _write_config(directory: RunDirectory, run: MoralRun, setting: Setting) -> None:
    directory.write_config({"kind": KIND, **run.to_json(), "setting": setting.to_json()})


def _train(directory: RunDirectory, run: MoralRun, setting: Setting, resume: bool) -> dict[str, Any]:
    """Train from where the run in the directory stands to its end."""
    primary_seed, moral_seed, teacher_seed = spawn_seeds(run.seed, 3)
    world = run.world.build()
    teacher: Teacher | People | RecordedAnswers
    if run.teacher.asks_people:
        teacher = run.teacher.people()
    elif run.teacher.teacher == RECORDED:
        teacher = RecordedAnswers(tuple(read_answers(directory.path / _RECORDED).informative))
    else:
        teacher = run.teacher.build(world.objective_names, np.random.default_rng(teacher_seed))
    normalisers = primary_normalisers(directory, run, primary_seed, setting)
    components = reward_components(directory, run, setting.device)
    clock = StageClock()
    with setting.stage("moral") as on_progress:
        agent = train_moral(
            run.world,
            components,
            teacher,
            run.config,
            moral_seed,
            directory,
            setting.device,
            setting.event_files(directory),
            on_progress,
            resume=resume,
        )
    save_policy(directory.policy, agent.policy, run.config.ppo.policy, run.world)
    metrics = read_metrics(directory.metrics)
    if not metrics:
        raise StorageError(f"{directory.metrics} is damaged: it holds no rollout")
    last = metrics[-1]
    weights = name_values(tuple(component.name for component in components), agent.weights)
    summary = {
        "queries": last["queries"],
        "weights": weights,
        "objectives": last["objectives"],
        "env_steps": {"primary": total(normalisers, "env_steps"), "moral": agent.env_steps},
        "wall_seconds": {"primary": total(normalisers, "wall_seconds"), "moral": clock.seconds},
    }
    write_json(directory.summary, summary)
    return summary


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """Read the lines of the rollouts, checked."""
    lines = read_lines(path)
    types = {"env_steps": int, "queries": int, "weights": dict, "objectives": dict}
    for number, line in enumerate(lines, start=1):
        if not has_fields(line, types):
            raise StorageError(f"{path} is damaged in line {number}: it is not the line of a rollout")
    return lines


def read_aligned_summary(path: Path, kind: str) -> dict[str, Any]:
    """Read the result of a finished run of a kind, checked."""
    summary = read_json(path)
    types = {"queries": int, "weights": dict, "objectives": dict, "env_steps": dict, "wall_seconds": dict}
    if not (has_fields(summary, types) and are_numbers(summary["weights"], summary["objectives"])):
        raise StorageError(f"{path} is damaged: it is not the summary of a run of moral {kind}")
    return summary


def _require_fitting(run: MoralRun) -> None:
    """Raise a ValueError if a run's parts do not fit together."""
    spawn_seeds(run.seed, 1)
    run.teacher.require_fitting(run.world.build().objective_names)
    require_reward_vector(run)


def _require_startable(run: MoralRun) -> None:
    """Raise an error if a run cannot be started, or a reward was learned in another world."""
    if run.teacher.teacher == RECORDED:
        raise ValueError("teacher is 'recorded', whose answers moral replay takes from other runs")
    require_worlds(run)
    # Only training asks for it otherwise, after the normalisers.
    require_trainable(run.config, run.world.build())
