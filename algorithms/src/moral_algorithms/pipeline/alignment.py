"""The fourth stage: MORAL, in a run directory from which it can be resumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from moral_algorithms.answers import Answer, read_answers
from moral_algorithms.bridge import LearnedReward, PrimaryReward, RewardComponent
from moral_algorithms.evaluation import play_episodes
from moral_algorithms.learners.expert import ExpertConfig, train_expert
from moral_algorithms.learners.moral import MoralConfig, train_moral
from moral_algorithms.learners.ppo import PPOConfig, sampling_seed
from moral_algorithms.learners.query_queue import People
from moral_algorithms.learners.recorded import RecordedAnswers
from moral_algorithms.networks.files import load_reward, save_policy
from moral_algorithms.pipeline.resuming import read_resumable, resumable
from moral_algorithms.pipeline.stage import Setting, StageClock, name_values, require_normaliser
from moral_algorithms.pipeline.teaching import RECORDED, TeacherConfig
from moral_algorithms.preferences import Teacher
from moral_algorithms.run_directory import RunDirectory, read_lines, write_lines
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, atomic_write, read_json, write_json
from moral_algorithms.worlds import WorldSpec

KIND = "train"
"""Kind of the run, which is also the command that makes it."""

_NORMALISER_EPISODES = 200
_REWARD = "reward.safetensors"
_NORMALISERS = "normalisers.json"
_RECORDED = "recorded.jsonl"


def normaliser_config() -> ExpertConfig:
    """How policies that pursue one primary component alone are trained by default."""
    return ExpertConfig(max_steps=150_000, ppo=PPOConfig(entropy_start=0.01, entropy_end=0.01))


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
    normaliser: ExpertConfig = field(default_factory=normaliser_config)
    """How the policies are trained that pursue one primary component alone; their returns normalise it."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {
            "world": self.world.to_json(),
            "rewards": [str(path) for path in self.rewards],
            "primary": list(self.primary),
            "teacher": {**asdict(self.teacher), "order": list(self.teacher.order)},
            "seed": self.seed,
            "moral": asdict(self.config),
            "normaliser": asdict(self.normaliser),
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
                teacher=TeacherConfig(**{**value["teacher"], "order": tuple(value["teacher"]["order"])}),
                seed=value["seed"],
                config=MoralConfig(**with_ppo(value["moral"])),
                normaliser=ExpertConfig(**with_ppo(value["normaliser"])),
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


def world_of_rewards(rewards: tuple[Path, ...]) -> WorldSpec:
    """Find the world that the first of several rewards was learned in; of none, the default.

    Raises
    ------
    StorageError
        If the reward cannot be read.
    """
    return load_reward(rewards[0] / _REWARD).world if rewards else WorldSpec()


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
        _require_worlds(run)
    with directory.hold():
        if not resume:
            _begin(directory, run, setting, [path / _REWARD for path in run.rewards])
        else:
            directory.require_config({"kind": KIND, **run.to_json()})
            if directory.summary.exists():
                return _read_summary(directory.summary)
            _read_metrics(directory.metrics)
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
    _require_worlds(run)
    with directory.hold():
        _begin(directory, run, setting, [path / _REWARD for path in run.rewards])


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
        If there is no answer, or one is about an episode of another world.
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
        with atomic_write(directory.path / _NORMALISERS) as file:
            file.write((source.path / _NORMALISERS).read_bytes())
        _begin(directory, run, setting, list(_copies(source, before).values()))
    return run


def _begin(directory: RunDirectory, run: MoralRun, setting: Setting, rewards: Sequence[Path]) -> None:
    """Copy the reward networks and write the configuration, last."""
    directory.require_new()
    for path, copy in zip(rewards, _copies(directory, run).values(), strict=True):
        with atomic_write(copy) as file:
            file.write(path.read_bytes())
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
    normalisers = _primary_normalisers(directory, run, primary_seed, setting)
    components = _reward_vector(directory, run, normalisers, setting.device)
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
    metrics = _read_metrics(directory.metrics)
    if not metrics:
        raise StorageError(f"{directory.metrics} is damaged: it holds no rollout")
    last = metrics[-1]
    weights = name_values(tuple(component.name for component in components), agent.weights)
    primary = {
        key: sum(entry[key] for entry in normalisers.values()) for key in ("env_steps", "wall_seconds")
    }
    summary = {
        "queries": last["queries"],
        "weights": weights,
        "objectives": last["objectives"],
        "env_steps": {"primary": primary["env_steps"], "moral": agent.env_steps},
        "wall_seconds": {"primary": primary["wall_seconds"], "moral": clock.seconds},
    }
    write_json(directory.summary, summary)
    return summary


def reward_vector(directory: RunDirectory, device: str = "cpu") -> list[RewardComponent]:
    """Load the reward vector of a run whose normalisers are known.

    Raises
    ------
    StorageError
        If something is missing or damaged.
    """
    run = read_moral_run(directory)
    normalisers = _read_normalisers(directory.path / _NORMALISERS)
    if not set(run.primary) <= normalisers.keys():
        raise StorageError(f"the run in {directory.path} has not got as far as its normalisers")
    return _reward_vector(directory, run, normalisers, device)


def _reward_vector(
    directory: RunDirectory, run: MoralRun, normalisers: dict[str, dict[str, Any]], device: str
) -> list[RewardComponent]:
    world = run.world.build()
    components: list[RewardComponent] = [
        PrimaryReward(world.reward_names, name, 1 / normalisers[name]["return"]) for name in run.primary
    ]
    for name, copy in _copies(directory, run).items():
        network, normaliser, _ = load_reward(copy, device)
        components.append(LearnedReward(name, network, 1 / normaliser))
    return components


def _read_metrics(path: Path) -> list[dict[str, Any]]:
    """Read the lines of the rollouts, checked."""
    lines = read_lines(path)
    types = {"env_steps": int, "queries": int, "weights": dict, "objectives": dict}
    for number, line in enumerate(lines, start=1):
        if not isinstance(line, dict) or {name: type(entry) for name, entry in line.items()} != types:
            raise StorageError(f"{path} is damaged in line {number}: it is not the line of a rollout")
    return lines


def _read_summary(path: Path) -> dict[str, Any]:
    """Read the result of a finished run, checked."""
    summary = read_json(path)
    types = {"queries": int, "weights": dict, "objectives": dict, "env_steps": dict, "wall_seconds": dict}
    if not isinstance(summary, dict) or {name: type(entry) for name, entry in summary.items()} != types:
        raise StorageError(f"{path} is damaged: it is not the summary of a run of moral train")
    return summary


def _read_normalisers(path: Path) -> dict[str, dict[str, Any]]:
    """Read the returns of the policies that pursue one primary component alone, checked."""
    found = read_json(path) if path.exists() else {}
    types = {"return": float, "env_steps": int, "wall_seconds": float}
    entries = found.values() if isinstance(found, dict) else [found]
    for entry in entries:
        if not isinstance(entry, dict) or {name: type(value) for name, value in entry.items()} != types:
            raise StorageError(f"{path} is damaged: it holds {entry!r}, which is no normaliser")
        require_normaliser(entry["return"], f"an entry of {path}", "remove the file")
    normalisers: dict[str, dict[str, Any]] = found
    return normalisers


def _primary_normalisers(
    directory: RunDirectory, run: MoralRun, seed: int, setting: Setting
) -> dict[str, dict[str, Any]]:
    """Find what a policy that pursues one primary component alone earns (eq. 5.2), once per run."""
    path = directory.path / _NORMALISERS
    found = _read_normalisers(path)
    world = run.world.build()
    for name, component_seed in zip(run.primary, spawn_seeds(seed, len(run.primary)), strict=True):
        if name in found:
            continue
        training_seed, evaluation_seed = spawn_seeds(component_seed, 2)
        clock = StageClock()
        alone = [float(name == other) for other in world.reward_names]
        with setting.stage("primary") as on_progress:
            trained = train_expert(
                run.world, alone, run.normaliser, training_seed, setting.device, on_progress=on_progress
            )
            with sampling_seed(evaluation_seed):
                played = play_episodes(trained.policy, world, _NORMALISER_EPISODES, evaluation_seed)
        column = world.reward_names.index(name)
        mean = abs(float(played.returns[:, column].mean()))
        require_normaliser(
            mean, f"the policy that pursues {name} alone", "train it longer (--normaliser.max-steps)"
        )
        env_steps = trained.env_steps + played.actions.size
        found[name] = {"return": mean, "env_steps": env_steps, "wall_seconds": clock.seconds}
        write_json(path, found)
    return found


def _copies(directory: RunDirectory, run: MoralRun) -> dict[str, Path]:
    """Where a run keeps its reward networks, by the names of their components."""
    names = [f"learned_{number}" for number in range(1, len(run.rewards) + 1)]
    return {name: directory.path / f"{name}.safetensors" for name in names}


def _require_fitting(run: MoralRun) -> None:
    """Raise a ValueError if a run's parts do not fit together."""
    spawn_seeds(run.seed, 1)
    world = run.world.build()
    run.teacher.require_fitting(world.objective_names)
    most = dict(zip(world.reward_names, world.reward_bounds[1], strict=True))
    for name in run.primary:
        PrimaryReward(world.reward_names, name)
        if most[name] <= 0:
            able = [other for other, amount in most.items() if amount > 0]
            raise ValueError(f"primary is {name!r}, whose reward is never positive; it must be one of {able}")
    if len(set(run.primary)) < len(run.primary):
        raise ValueError(f"primary is {run.primary}; it must name no component twice")
    if not run.rewards:
        raise ValueError("rewards is empty; it must name at least one run directory of moral airl")


def _require_worlds(run: MoralRun) -> None:
    """Raise an error if a run cannot be started, or a reward was learned in another world."""
    if run.teacher.teacher == RECORDED:
        raise ValueError("teacher is 'recorded', whose answers moral replay takes from other runs")
    for path in run.rewards:
        found = load_reward(path / _REWARD).world
        if found.build() != run.world.build():
            raise StorageError(f"{path} was learned in {found.to_json()}; it must be {run.world.to_json()}")
