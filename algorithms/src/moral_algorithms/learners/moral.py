"""MORAL: train under weights that are meanwhile learned from preferences (thesis, algorithms 1 and 5).

The reward vector holds primary components, read from the environment, and learned ones, one per expert. PPO
trains under the posterior mean of the weights. At even intervals the most informative of many random pairs of
recent on-policy episodes is shown to the teacher; the answer updates the posterior, the weights are replaced,
and training goes on.

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
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy

from moral_algorithms.bridge import EngineVecEnv, Replay, RewardComponent, ScalarisedRewards
from moral_algorithms.learners.ppo import (
    ObjectiveMonitor,
    OnProgress,
    PPOConfig,
    learn,
    load_ppo_state,
    make_ppo,
    ppo_state,
    standard_callbacks,
)
from moral_algorithms.preferences import (
    ACQUISITIONS,
    SAMPLERS,
    BallPrior,
    BradleyTerry,
    ExponentialProxy,
    Likelihood,
    Posterior,
    Preference,
    Prior,
    Query,
    RationalityPrior,
    Teacher,
)
from moral_algorithms.run_directory import RunDirectory, append_line, read_lines, repair_lines, write_lines
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError, first_line, read_tensors, write_tensors
from moral_algorithms.worlds import WorldSpec

PRIORS: dict[str, type[RationalityPrior] | type[BallPrior]] = {
    "rationality": RationalityPrior,
    "ball": BallPrior,
}
"""Priors over the weights, by name."""

LIKELIHOODS: dict[str, type[BradleyTerry] | type[ExponentialProxy]] = {
    "bradley_terry": BradleyTerry,
    "exponential": ExponentialProxy,
}
"""Likelihoods of a preference, by name."""


@dataclass(frozen=True)
class MoralConfig:
    """How MORAL trains and asks."""

    steps: int = 800_000
    """Environment steps."""
    queries: int = 25
    """Questions to the teacher."""
    query_span: float = 0.75
    """Part of the training over which the queries are spread evenly; the rest goes to the final weights."""
    candidates: int = 2000
    """Random pairs of recent episodes from which each query is chosen."""
    acquisition: str = "expected_regret"
    """How: expected_regret, mutual_information, volume_removal or random."""
    prior: str = "rationality"
    """Prior over the weights: rationality (infers the teacher's) or ball (thesis eq. 4.4)."""
    likelihood: str = "bradley_terry"
    """Likelihood of an answer: bradley_terry (eq. 4.1) or exponential (eq. 4.12)."""
    rationality: float = 20.0
    """Scale of the likelihood on returns of order one under the ball prior; the other prior infers it."""
    sampler: str = "hit_and_run"
    """Sampler of the posterior: hit_and_run or metropolis (thesis)."""
    samples: int = 1000
    """Samples of the posterior."""
    checkpoint_every: int = 20
    """Rollouts between checkpoints; every answer is followed by one too."""
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(
            batch_size=800, epochs=5, gae_lambda=0.9, entropy_start=0.05, entropy_end=0.0
        )
    )
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        minima = {"steps": 1, "queries": 0, "candidates": 1, "samples": 2, "checkpoint_every": 1}
        for name, minimum in minima.items():
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least {minimum}")
        if not 0 < self.query_span <= 1:
            raise ValueError(f"query_span is {self.query_span}; it must be above 0 and at most 1")
        choices: dict[str, Sequence[str]] = {
            "acquisition": sorted(ACQUISITIONS),
            "prior": sorted(PRIORS),
            "likelihood": sorted(LIKELIHOODS),
            "sampler": sorted(SAMPLERS),
        }
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}; it must be one of {known}")
        if not self.rationality > 0:
            raise ValueError(f"rationality is {self.rationality}; it must be positive")
        if self.likelihood == "exponential" and self.prior != "ball":
            raise ValueError(
                f"prior is {self.prior!r}; it must be 'ball' with the exponential likelihood, which tells "
                "nothing of a teacher's rationality"
            )


class AlignedAgent(NamedTuple):
    """What MORAL found."""

    policy: ActorCriticPolicy
    """The trained policy."""
    weights: NDArray[np.float64]
    """Posterior mean of the scalarisation weights, shape (d,)."""
    env_steps: int
    """Environment steps it took."""


def train_moral(
    world: WorldSpec,
    components: Sequence[RewardComponent],
    teacher: Teacher,
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
        The reward vector, normalised so that the return of a policy that pursues one component alone is about
        one.
    teacher
        Answers the queries.
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
    StorageError
        If something cannot be written, what is to be continued is damaged, or a run has left a checkpoint or
        queries in the directory and ``resume`` is False.
    """
    if not resume:
        for path in (directory.checkpoint, directory.queries):
            if path.exists():
                raise StorageError(f"{path} is there already; resume that run or choose another folder")
    built = world.build()
    ppo_seed, posterior_seed, candidate_seed = spawn_seeds(seed, 3)
    engine = EngineVecEnv(built, config.ppo.num_envs, seed=ppo_seed)
    posterior = make_posterior(config, len(components), np.random.default_rng(posterior_seed))
    venv = ScalarisedRewards(engine, components, posterior.weights())
    model = make_ppo(config.ppo, venv, ppo_seed, device, tensorboard)
    standard = standard_callbacks(config.ppo, config.steps, built.objective_names, on_progress)
    monitor = next(callback for callback in standard if isinstance(callback, ObjectiveMonitor))
    learner = PreferenceLearner(venv, posterior, teacher, config, candidate_seed, directory, monitor)
    learner.restore(model)
    learn(model, config.steps, [*standard, learner])
    learner.save(model)
    return AlignedAgent(model.policy, posterior.weights(), model.num_timesteps)


def make_posterior(config: MoralConfig, dim: int, rng: np.random.Generator) -> Posterior:
    """Make the posterior over ``dim`` weights that a configuration asks for, before any answer."""
    prior: Prior = PRIORS[config.prior](dim)
    rationality = config.rationality if config.prior == "ball" else 1.0
    likelihood: Likelihood = LIKELIHOODS[config.likelihood](rationality)
    return Posterior(prior, likelihood, SAMPLERS[config.sampler], num_samples=config.samples, rng=rng)


class Episode(NamedTuple):
    """What is kept of a finished episode for the next queries."""

    returns: NDArray[np.float32]
    """Undiscounted vector return, shape (d,)."""
    objectives: NDArray[np.int64]
    """Ground-truth counters at the end, shape (m,)."""
    replay: Replay
    """The episode itself."""


class PreferenceLearner(BaseCallback):
    """Chooses queries, asks the teacher, updates the posterior and replaces the weights.

    Each query compares two of the last finished episodes, one per environment. It acts between rollouts,
    where training can be saved and continued exactly.

    Parameters
    ----------
    venv
        The environments whose weights it replaces.
    posterior
        What it knows of the weights.
    teacher
        Answers the queries.
    config
        How many queries, when, and how they are chosen.
    seed
        Entropy of the candidates.
    directory
        Where it writes.
    monitor
        Told how many queries are answered.
    """

    def __init__(
        self,
        venv: ScalarisedRewards,
        posterior: Posterior,
        teacher: Teacher,
        config: MoralConfig,
        seed: int,
        directory: RunDirectory,
        monitor: ObjectiveMonitor,
    ) -> None:
        super().__init__()
        self._venv = venv
        self._posterior = posterior
        self._teacher = teacher
        self._config = config
        self._directory = directory
        self._monitor = monitor
        self._rng = np.random.default_rng(seed)
        self._recent: deque[Episode] = deque(maxlen=venv.num_envs)
        self._answered: list[dict[str, Any]] = []
        self._rollouts = 0

    def restore(self, model: PPO) -> None:
        """Go on from the last checkpoint, if there is one, and from the queries answered since.

        Raises
        ------
        StorageError
            If what is in the run directory is damaged or of another run.
        """
        for path in (self._directory.queries, self._directory.metrics):
            repair_lines(path)
        self._answered = _read_answers(self._directory.queries)
        if self._directory.checkpoint.exists():
            self._load_checkpoint(model)
        # Training goes through the rollouts after the checkpoint once more, and writes their lines again.
        lines = read_lines(self._directory.metrics)
        kept = [line for line in lines if line["env_steps"] <= model.num_timesteps]
        if len(kept) < len(lines):
            write_lines(self._directory.metrics, kept)

    def _load_checkpoint(self, model: PPO) -> None:
        arrays, metadata = read_tensors(self._directory.checkpoint, "moral-checkpoint")
        try:
            load_ppo_state(model, arrays, metadata["ppo"])
            posterior = metadata["posterior"]
            self._posterior.load_state_dict(
                {**posterior, "returns": arrays["posterior.returns"], "samples": arrays["posterior.samples"]}
            )
            self._rng.bit_generator.state = metadata["candidates"]
            self._teacher.load_state_dict(metadata["teacher"])
            self._monitor.means = metadata["objectives"]
            names = ("returns", "objectives", "streams", "actions")
            recent = zip(*(arrays[f"recent.{name}"] for name in names), strict=True)
            self._recent.extend(
                Episode(returns, objectives, Replay(int(stream), actions))
                for returns, objectives, stream, actions in recent
            )
        except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
            reason = first_line(error)
            raise StorageError(f"{self._directory.checkpoint} does not fit this run: {reason}") from error
        self._monitor.queries = self._posterior.num_queries
        if len(self._answered) < self._posterior.num_queries:
            raise StorageError(
                f"{self._directory.queries} has {len(self._answered)} answers; "
                f"the checkpoint has {self._posterior.num_queries}"
            )

    def save(self, model: PPO) -> None:
        """Write a checkpoint.

        Raises
        ------
        StorageError
            If it cannot be written; the last one is untouched then.
        """
        arrays, ppo = ppo_state(model)
        posterior = self._posterior.state_dict()
        arrays["posterior.returns"] = posterior.pop("returns")
        arrays["posterior.samples"] = posterior.pop("samples")
        recent = self._recent
        arrays["recent.returns"] = np.array([episode.returns for episode in recent], dtype=np.float32)
        arrays["recent.objectives"] = np.array([episode.objectives for episode in recent], dtype=np.int64)
        arrays["recent.streams"] = np.array([episode.replay.stream for episode in recent], dtype=np.uint64)
        arrays["recent.actions"] = np.array([episode.replay.actions for episode in recent], dtype=np.uint8)
        metadata = {
            "kind": "moral-checkpoint",
            "ppo": ppo,
            "posterior": posterior,
            "candidates": self._rng.bit_generator.state,
            "teacher": self._teacher.state_dict(),
            "objectives": self._monitor.means,
        }
        write_tensors(self._directory.checkpoint, arrays, metadata)

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self._recent.extend(
                Episode(info["returns"], info["objectives"], info["replay"])
                for info in self.locals["infos"]
                if "returns" in info
            )
        return True

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        self._rollouts += 1
        save = self._rollouts % self._config.checkpoint_every == 0
        while self._query_is_due and len(self._recent) > 1:
            self._ask()
            save = True
        if save:
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

    @property
    def _query_is_due(self) -> bool:
        asked, queries = self._posterior.num_queries, self._config.queries
        span = self._config.query_span * self._config.steps
        return asked < queries and self.num_timesteps >= span * (asked + 1) / queries

    def _ask(self) -> None:
        number = self._posterior.num_queries
        query, record = self._choose_query()
        if number < len(self._answered):
            # Answered before a crash that came before the checkpoint: the teacher is not asked again.
            record = self._answered[number]
            query = Query(np.array(record["returns"]), np.array(record["objectives"]))
            self._teacher.load_state_dict(record["teacher"])
        else:
            preference = self._teacher.prefer(query)
            if preference is None:
                # Skipped: the next try waits for other episodes.
                self._recent.clear()
                return
            record |= {"query": number, "preference": preference.value, "teacher": self._teacher.state_dict()}
            append_line(self._directory.queries, record)
            self._answered.append(record)
        self._posterior.add(query.returns, Preference(record["preference"]))
        self._venv.weights = self._posterior.weights()
        self._monitor.queries = self._posterior.num_queries

    def _choose_query(self) -> tuple[Query, dict[str, Any]]:
        returns = np.array([episode.returns for episode in self._recent], dtype=np.float64)
        count = len(returns)
        first = self._rng.integers(count, size=self._config.candidates)
        second = (first + self._rng.integers(1, count, size=self._config.candidates)) % count
        pairs = np.stack([first, second], axis=1)
        # Equal returns teach nothing, yet volume removal under a logistic likelihood likes them best.
        differ = ~np.isclose(returns[first], returns[second]).all(axis=1)
        pairs = pairs[differ] if differ.any() else pairs
        acquisition = ACQUISITIONS[self._config.acquisition]
        scores = acquisition(self._posterior.samples, returns[pairs], self._posterior.likelihood, self._rng)
        pair = [self._recent[index] for index in pairs[np.argmax(scores)]]
        query = Query(
            np.array([episode.returns for episode in pair], dtype=np.float64),
            np.array([episode.objectives for episode in pair]),
        )
        record = {
            "env_steps": self.num_timesteps,
            "returns": query.returns.tolist(),
            "objectives": query.objectives.tolist(),
            "episodes": [episode.replay.to_json() for episode in pair],
        }
        return query, record


def _read_answers(path: Path) -> list[dict[str, Any]]:
    """Read the answered queries, checked: a damaged one must not come to light in the middle of training."""
    answers = read_lines(path)
    for number, record in enumerate(answers):
        try:
            Query(np.array(record["returns"]), np.array(record["objectives"]))
            Preference(record["preference"])
            valid = record["query"] == number and isinstance(record["teacher"], dict)
        except (KeyError, TypeError, ValueError):
            valid = False
        if not valid:
            raise StorageError(
                f"{path} is damaged in line {number + 1}: it is not the answer to query {number}"
            )
    return answers
