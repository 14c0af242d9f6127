"""MORAL: train under weights that are meanwhile learned from preferences (thesis, algorithm 5).

The reward vector holds primary components, read from the environment, and learned ones, one per expert. PPO
trains under the posterior mean of the weights. The most informative of many random pairs of recent on-policy
episodes are shown to the teacher; each answer updates the posterior, the weights are replaced, and training
goes on. A simulated teacher is asked at even intervals (:mod:`~moral_algorithms.learners.asking`); people
answer in their own time (:mod:`~moral_algorithms.learners.query_queue`).

An answer is on the disk before it counts, and a checkpoint follows it. After a crash training goes on from
the last checkpoint; queries that were answered since are not asked again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy

from moral_algorithms.bridge import EngineVecEnv, RewardComponent, ScalarisedRewards
from moral_algorithms.learners.asking import Asker, Episode, QueryChooser, TeacherAsker
from moral_algorithms.learners.beside_people import PaceSchedule, StatusWriter, learn_at_pace
from moral_algorithms.learners.inference import InferenceConfig, make_posterior
from moral_algorithms.learners.pace import Pace
from moral_algorithms.learners.ppo import (
    BatchedBootstrap,
    EntropySchedule,
    ObjectiveMonitor,
    OnProgress,
    PPOConfig,
    learn,
    least_steps,
    make_ppo,
)
from moral_algorithms.learners.query_queue import People, QueryQueue
from moral_algorithms.learners.recorded import RecordedAnswers, RecordedAsker, vector_returns
from moral_algorithms.learners.resuming import ResumableLearner, require_unstarted
from moral_algorithms.preferences import Posterior, Teacher
from moral_algorithms.replay import Replay
from moral_algorithms.run_directory import RunDirectory, append_line
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import Arrays
from moral_algorithms.worlds import WorldSpec
from moral_envs.world import World


@dataclass(frozen=True)
class MoralConfig(InferenceConfig):
    """How MORAL trains and asks."""

    steps: int = 800_000
    """Environment steps."""
    query_span: float = 0.75
    """Part of the training over which the queries are spread evenly; the rest goes to the final weights."""
    checkpoint_every: int = 20
    """Rollouts between checkpoints; every answer is followed by one too."""
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(
            batch_size=800, epochs=5, gae_lambda=0.9, entropy_start=0.05, entropy_end=0.0
        )
    )
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("steps", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        if not 0 < self.query_span <= 1:
            raise ValueError(f"query_span is {self.query_span}; it must be above 0 and at most 1")


class AlignedAgent(NamedTuple):
    """What MORAL found."""

    policy: ActorCriticPolicy
    """The trained policy."""
    weights: NDArray[np.float64]
    """Posterior mean of the scalarisation weights, shape (d,)."""
    env_steps: int
    """Environment steps it took."""
    queries: int
    """Answers it was given."""


def train_moral(
    world: WorldSpec,
    components: Sequence[RewardComponent],
    teacher: Teacher | People | RecordedAnswers,
    config: MoralConfig,
    seed: int,
    directory: RunDirectory,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
    resume: bool = False,
) -> AlignedAgent:
    """Train an agent, from the start or from where a run in the directory stands.

    Parameters
    ----------
    world
        Where it acts.
    components
        The reward vector, normalised (eq. 5.2): the return of a policy that pursues one component alone is
        about one for a primary component, and about minus one for a learned one.
    teacher
        Answers the queries; if it is people, training goes on for as long as they take. Recorded answers are
        used instead of any question.
    config
        How it trains and asks.
    seed
        Entropy of environments, networks, actions, candidates and posterior samples.
    directory
        Where queries, metrics and checkpoints go; the caller holds it.
    device
        Where networks live.
    tensorboard
        Folder for TensorBoard's event files.
    on_progress
        Called after every rollout.
    resume
        Go on from the last checkpoint and the answered queries in the directory, with the arguments that the
        run was started with; without either, this is a start.

    Raises
    ------
    ValueError
        If there are too few steps or environments for a query, or the world's episodes differ in length.
    StorageError
        If something cannot be written, what is to be continued is damaged, or a run has left a checkpoint or
        queries in the directory and ``resume`` is False.
    """
    if not resume:
        require_unstarted(directory)
    built = world.build()
    require_trainable(config, built)
    last_asked = _last_rollout(config)
    ppo_seed, posterior_seed, candidate_seed = spawn_seeds(seed, 3)
    engine = EngineVecEnv(built, config.ppo.num_envs, seed=ppo_seed)
    posterior = make_posterior(config, len(components), np.random.default_rng(posterior_seed))
    venv = ScalarisedRewards(engine, components, posterior.weights())
    model = make_ppo(config.ppo, venv, ppo_seed, device, tensorboard)
    chooser = QueryChooser(posterior, config.acquisition, config.candidates, candidate_seed)
    monitor = ObjectiveMonitor(built.objective_names, config.steps, on_progress)
    asker: Asker
    if isinstance(teacher, People):
        pace = Pace(config.steps, config.queries, config.query_span)
        asker = queue = QueryQueue(teacher, chooser, posterior, pace, directory)
    elif isinstance(teacher, RecordedAnswers):
        replays = [replay for answer in teacher.answers for replay in answer.asked.episodes]
        returns = vector_returns(built, components, replays).reshape(-1, 2, len(components))
        asker = RecordedAsker(teacher, returns, posterior, min(config.query_span * config.steps, last_asked))
    else:
        # The last query is due before the last rollout at the latest: nobody asks after it.
        span = min(config.query_span * config.steps, last_asked)
        asker = TeacherAsker(teacher, chooser, posterior, span, config.queries, directory.queries)
    learner = PreferenceLearner(venv, posterior, asker, config.checkpoint_every, directory, monitor)
    asker.read()
    learner.restore(model)
    common = [BatchedBootstrap(), monitor, learner]
    if isinstance(teacher, People):
        status = StatusWriter(venv, posterior, queue, monitor, learner.recent, directory)
        learn_at_pace(model, [PaceSchedule(config.ppo, pace), *common, status], queue, status)
    else:
        schedule = EntropySchedule(config.ppo.entropy_start, config.ppo.entropy_end, config.steps)
        learn(model, config.steps, [schedule, *common])
    learner.save(model)
    return AlignedAgent(model.policy, posterior.weights(), model.num_timesteps, posterior.num_queries)


def require_trainable(config: MoralConfig, world: World) -> None:
    """Raise a ValueError if MORAL cannot train so in this world."""
    if world.ends_early:
        raise ValueError(f"world is {world.name}; its episodes must all take the same number of steps")
    if config.queries and config.ppo.num_envs < 2:
        raise ValueError(f"ppo.num_envs is {config.ppo.num_envs}; it must be at least 2, to compare episodes")
    least = least_steps(config.ppo, world)
    if config.queries and config.steps < least:
        raise ValueError(
            f"steps is {config.steps}; it must be at least {least}, for queries compare whole episodes of "
            f"{config.ppo.num_envs} environments, and what is learned from them needs a rollout more"
        )


def _last_rollout(config: MoralConfig) -> int:
    """Count the environment steps before the last rollout."""
    rollout = config.ppo.num_envs * config.ppo.rollout_steps
    return (config.steps - 1) // rollout * rollout


class PreferenceLearner(ResumableLearner):
    """Keeps what queries are chosen from, replaces the weights after answers and saves the training.

    Queries compare two of the last finished episodes, one per environment.

    Parameters
    ----------
    venv
        The environments whose weights it replaces.
    posterior
        What is known of the weights.
    asker
        Chooses queries, puts them to the teacher and adds the answers to the posterior.
    checkpoint_every
        Rollouts between checkpoints.
    directory
        Where it writes.
    monitor
        Told how many queries are answered.
    """

    def __init__(
        self,
        venv: ScalarisedRewards,
        posterior: Posterior,
        asker: Asker,
        checkpoint_every: int,
        directory: RunDirectory,
        monitor: ObjectiveMonitor,
    ) -> None:
        super().__init__("moral-checkpoint", directory, monitor)
        self._venv = venv
        self._posterior = posterior
        self._asker = asker
        self._checkpoint_every = checkpoint_every
        self._rollouts = 0
        self.recent: deque[Episode] = deque(maxlen=venv.num_envs)
        """The last finished episodes."""

    def state_dict(self) -> tuple[Arrays, dict[str, Any]]:
        """Copy the posterior, the asker's state and the last episodes."""
        posterior = self._posterior.state_dict()
        arrays = {f"posterior.{name}": posterior.pop(name) for name in ("returns", "samples")}
        recent = self.recent
        arrays["recent.returns"] = np.array([episode.returns for episode in recent], dtype=np.float32)
        arrays["recent.objectives"] = np.array([episode.objectives for episode in recent], dtype=np.int64)
        arrays["recent.streams"] = np.array([episode.replay.stream for episode in recent], dtype=np.uint64)
        arrays["recent.actions"] = np.array([episode.replay.actions for episode in recent], dtype=np.uint8)
        return arrays, {"posterior": posterior, "asker": self._asker.state_dict()}

    def load_state_dict(self, arrays: Arrays, metadata: dict[str, Any]) -> None:
        """Go on where :meth:`state_dict` was taken, with the answers that the asker has read."""
        returns = {name: arrays[f"posterior.{name}"] for name in ("returns", "samples")}
        self._posterior.load_state_dict({**metadata["posterior"], **returns})
        self._asker.load_state_dict(metadata["asker"])
        self._monitor.queries = self._posterior.num_queries
        names = ("returns", "objectives", "streams", "actions")
        recent = zip(*(arrays[f"recent.{name}"] for name in names), strict=True)
        self.recent.extend(
            Episode(returns, objectives, Replay(int(stream), actions))
            for returns, objectives, stream, actions in recent
        )

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self.recent.extend(
                Episode(info["returns"], info["objectives"], info["replay"])
                for info in self.locals["infos"]
                if "returns" in info
            )
        return True

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        self._rollouts += 1
        acted = self._asker.act(self.num_timesteps, self.recent)
        if acted:
            self._venv.weights = self._posterior.weights()
            self._monitor.queries = self._posterior.num_queries
        if acted or self._rollouts % self._checkpoint_every == 0:
            self.save(self.model)

    def _on_rollout_end(self) -> None:
        weights = dict(zip(self._venv.names, self._venv.weights.tolist(), strict=True))
        for name, weight in weights.items():
            self.logger.record(f"weights/{name}", weight)
        line = {
            "env_steps": self.num_timesteps,
            "queries": self._posterior.num_queries,
            "weights": weights,
            "objectives": self._monitor.means,
        }
        append_line(self._directory.metrics, line)
