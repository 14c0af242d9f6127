"""A policy for all weights, and agents that are found with it by a few queries."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from moral_algorithms.learners.alignment import AlignmentConfig, ask_teacher
from moral_algorithms.learners.covering import CoveringConfig, train_covering
from moral_algorithms.learners.expert import ExpertConfig
from moral_algorithms.learners.ppo import PPOConfig
from moral_algorithms.networks.files import load_conditioned_policy, save_conditioned_policy, save_policy
from moral_algorithms.pipeline.alignment import read_aligned_summary, read_metrics
from moral_algorithms.pipeline.resuming import read_resumable, resumable
from moral_algorithms.pipeline.reward_vector import (
    copy_rewards,
    forget_normalisers,
    normaliser_config,
    primary_normalisers,
    require_reward_vector,
    require_worlds,
    reward_components,
    total,
)
from moral_algorithms.pipeline.stage import Setting, StageClock, name_values, new_run, require_kind
from moral_algorithms.pipeline.teaching import TeacherConfig
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, write_json
from moral_algorithms.worlds import WorldSpec

COVER, ALIGN = "cover", "align"
"""Kinds of runs, which are also the commands that make them."""

_PRESET = "fast"


@dataclass(frozen=True)
class CoverRun:
    """What the training of a policy for all weights consists of: all that its result depends on."""

    rewards: tuple[Path, ...]
    """Run directories of AIRL, one per expert; the components are learned_1, learned_2 and so on."""
    world: WorldSpec = field(default_factory=WorldSpec)
    """Where the agent acts."""
    primary: tuple[str, ...] = ()
    """Components of the world's reward vector that the agent is given."""
    seed: int = 0
    """Entropy of all of it."""
    config: CoveringConfig = field(default_factory=CoveringConfig)
    """How it is trained."""
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
            "seed": self.seed,
            "cover": asdict(self.config),
            "normaliser": asdict(self.normaliser),
            "returns": dict(self.returns),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> CoverRun:
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
                seed=value["seed"],
                config=CoveringConfig(**with_ppo(value["cover"])),
                normaliser=ExpertConfig(**with_ppo(value["normaliser"])),
                returns=dict(value["returns"]),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"the run's configuration is damaged: {error}") from error


@dataclass(frozen=True)
class AlignRun:
    """What one series of queries about a policy for all weights consists of."""

    covered: Path
    """Run directory of :func:`cover`."""
    teacher: TeacherConfig = field(default_factory=TeacherConfig)
    """Who answers."""
    seed: int = 0
    """Entropy of all of it."""
    config: AlignmentConfig = field(default_factory=AlignmentConfig)
    """How the teacher is asked."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for :meth:`from_json`."""
        return {
            "covered": str(self.covered),
            "teacher": self.teacher.to_json(),
            "seed": self.seed,
            "align": asdict(self.config),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> AlignRun:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If it is damaged.
        """
        try:
            return cls(
                covered=Path(value["covered"]),
                teacher=TeacherConfig.from_json(value["teacher"]),
                seed=value["seed"],
                config=AlignmentConfig(**value["align"]),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"the run's configuration is damaged: {error}") from error


def read_align_run(directory: RunDirectory) -> AlignRun:
    """Read what the run of :func:`align` in a directory was started with.

    Raises
    ------
    ValueError
        If there is none, or its configuration is damaged.
    """
    return AlignRun.from_json(read_resumable(directory, ALIGN))


def cover(directory: RunDirectory, run: CoverRun, setting: Setting) -> dict[str, Any]:
    """Train a policy for all weights of a reward vector and save it.

    The primary components' normalisers and copies of the reward networks are kept beside it, so that
    :func:`align` needs nothing else. A run that was cut off is replaced.

    Parameters
    ----------
    directory
        Where everything goes.
    run
        What to do.
    setting
        How the stages are run.

    Returns
    -------
    dict
        What ``summary.json`` holds: mean ``objectives`` over all weights at the end, and ``env_steps`` and
        ``wall_seconds`` of the stages ``primary`` and ``cover``.

    Raises
    ------
    ValueError
        If the run's parts do not fit together.
    StorageError
        If the directory holds a finished run, or something cannot be read or written.
    """
    primary_seed, cover_seed = spawn_seeds(run.seed, 2)
    require_reward_vector(run)
    require_worlds(run)
    with new_run(directory, COVER, run.to_json()):
        forget_normalisers(directory)
        copy_rewards(directory, run)
        normalisers = primary_normalisers(directory, run, primary_seed, setting)
        components = reward_components(directory, run, setting.device)
        clock = StageClock()
        with setting.stage(COVER) as on_progress:
            found = train_covering(
                run.world,
                components,
                run.config,
                cover_seed,
                setting.device,
                setting.event_files(directory),
                clock.watch(on_progress),
            )
        save_conditioned_policy(_covering(directory), found.policy, run.world)
        took = clock.summary()
        summary = {
            "objectives": took["objectives"],
            "env_steps": {"primary": total(normalisers, "env_steps"), "cover": found.env_steps},
            "wall_seconds": {"primary": total(normalisers, "wall_seconds"), "cover": took["wall_seconds"]},
        }
        write_json(directory.summary, summary)
    return summary


def align(directory: RunDirectory, run: AlignRun, setting: Setting, resume: bool = False) -> dict[str, Any]:
    """Find an agent that a teacher prefers, by queries about a policy for all weights.

    Parameters
    ----------
    directory
        Where the agent goes; queries and metrics are as those of
        :func:`~moral_algorithms.pipeline.alignment.moral`.
    run
        What to do; when resumed, the same as when the run was started.
    setting
        How the stage is run.
    resume
        Go on with the run in the directory; no answered query is asked again, and a finished run is left as
        it is.

    Returns
    -------
    dict
        What ``summary.json`` holds: ``queries``, ``weights`` and mean ``objectives`` under them, and
        ``env_steps`` and ``wall_seconds`` of the stage ``align``.

    Raises
    ------
    ValueError
        If the run's parts do not fit together.
    StorageError
        If something cannot be read or written, or the directory holds another run.
    """
    ask_seed, teacher_seed = spawn_seeds(run.seed, 2)
    run.teacher.require_simulated("moral align")
    if resume:
        read_align_run(directory)
    covered = RunDirectory(run.covered)
    described = read_covered(covered)
    policy = load_conditioned_policy(_covering(covered), setting.device).policy
    components = reward_components(covered, described, setting.device)
    objective_names = described.world.build().objective_names
    teacher = run.teacher.build(objective_names, np.random.default_rng(teacher_seed))
    with directory.hold():
        if not resume:
            directory.require_new()
            directory.write_config({"kind": ALIGN, **run.to_json(), "setting": setting.to_json()})
        else:
            directory.require_config({"kind": ALIGN, **run.to_json()})
            if directory.summary.exists():
                return read_aligned_summary(directory.summary, ALIGN)
        with resumable(directory, ALIGN):
            clock = StageClock()
            with setting.stage(ALIGN) as on_progress:
                agent = ask_teacher(
                    described.world,
                    components,
                    policy,
                    teacher,
                    run.config,
                    ask_seed,
                    directory,
                    on_progress,
                    resume,
                )
            save_policy(directory.policy, agent.policy, _PRESET, described.world)
            names = tuple(component.name for component in components)
            summary = {
                "queries": agent.queries,
                "weights": name_values(names, agent.weights),
                "objectives": read_metrics(directory.metrics)[-1]["objectives"],
                "env_steps": {ALIGN: agent.env_steps},
                "wall_seconds": {ALIGN: clock.seconds},
            }
            write_json(directory.summary, summary)
    return summary


def read_covered(directory: RunDirectory) -> CoverRun:
    """Read what a finished run of :func:`cover` consists of.

    Raises
    ------
    ValueError
        If its configuration is damaged.
    StorageError
        If there is none, or it is not finished.
    """
    if not directory.config.exists():
        raise StorageError(f"{directory.path} is no run directory: it has no {directory.config.name}")
    config = directory.read_config()
    require_kind(directory, config, COVER)
    if not directory.summary.exists():
        raise StorageError(f"the run in {directory.path} is not finished: it has no policy yet")
    return CoverRun.from_json(config)


def _covering(directory: RunDirectory) -> Path:
    return directory.path / "covering.safetensors"
