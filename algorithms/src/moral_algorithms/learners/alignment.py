"""MORAL's queries to a policy that has been trained for all weights (thesis, algorithm 5 without its PPO).

The policy follows the posterior at once, so that every query compares fresh episodes of the policies that the
answer is about. Nothing is trained between two queries.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from moral_algorithms.bridge import EngineVecEnv, RewardComponent, ScalarisedRewards
from moral_algorithms.learners.asking import Episode, QueryChooser, TeacherAsker, play_once
from moral_algorithms.learners.covering import ConditionedRewards
from moral_algorithms.learners.inference import InferenceConfig, make_posterior
from moral_algorithms.learners.moral import AlignedAgent
from moral_algorithms.learners.ppo import OnProgress, Progress, sampling_seed
from moral_algorithms.networks.conditioned import ConditionedPolicy
from moral_algorithms.preferences import Teacher
from moral_algorithms.preferences.priors import normalise_rows
from moral_algorithms.run_directory import RunDirectory, append_line, write_lines
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import StorageError
from moral_algorithms.worlds import WorldSpec


@dataclass(frozen=True)
class AlignmentConfig(InferenceConfig):
    """How a teacher is asked about a policy for all weights."""

    concentration: float = 5.0
    """Of the rationality prior's weights. With 1 a few answers may leave a component out: the policy follows
    at once, its episodes say nothing more of what is missing, and no answer asks for it again."""
    candidates: int = 4000
    """Random pairs of the fresh episodes from which each query is chosen."""
    centred: float = 1.0
    """Share of the candidates that remain: those nearest to symmetric about the mean of the episodes. Take
    0.05 for a teacher whose wish is smooth but no sum of components, such as a ratio: about such a pair the
    curvature cancels, as in a central difference, and the answer tells the slope at what the policy does. It
    hides rare failures, which are never symmetric. Random queries are chosen from all candidates."""
    episodes: int = 256
    """Fresh episodes for each query."""
    exploration: float = 0.5
    """How far every other episode leaves the posterior's mean: from 0, where all follow it, to 1, where that
    episode is played under a draw of its own, as in Thompson sampling. A policy that gives something up as
    soon as its weight is small shows no episode with it under the mean, and no answer asks for it again; but
    pairs from very different policies tell the shape of the teacher's wish rather than its slope."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.centred <= 1:
            raise ValueError(f"centred is {self.centred}; it must be above 0 and at most 1")
        if self.episodes < 2:
            raise ValueError(f"episodes is {self.episodes}; it must be at least 2, for a query compares two")
        if not 0 <= self.exploration <= 1:
            raise ValueError(f"exploration is {self.exploration}; it must be at least 0 and at most 1")


def ask_teacher(
    world: WorldSpec,
    components: Sequence[RewardComponent],
    policy: ConditionedPolicy,
    teacher: Teacher,
    config: AlignmentConfig,
    seed: int,
    directory: RunDirectory,
    on_progress: OnProgress | None = None,
    resume: bool = False,
) -> AlignedAgent:
    """Find the weights that a teacher's preferences ask for, and the policy under them.

    Parameters
    ----------
    world
        Where the policy was trained.
    components
        The reward vector that it was trained on.
    policy
        The policy for all weights.
    teacher
        Answers the queries.
    config
        How many, and how they are chosen. A query that the teacher skips is replaced by one of other
        episodes, as often in all as there are queries; then there are fewer answers.
    seed
        Entropy of starts, actions, candidates and posterior samples.
    directory
        Where queries and metrics go; the caller holds it. A line of metrics tells what the policy achieves
        under the posterior mean: in half of the episodes before each query, and in all of those at the end.
    on_progress
        Called after the episodes of each query.
    resume
        Use the answers that are in the directory, of a run with the same arguments, and go on after them.

    Returns
    -------
    AlignedAgent
        The ``fast`` policy under the posterior mean, the weights, and the steps of the episodes.

    Raises
    ------
    StorageError
        If something cannot be written, the answers are damaged, or a run has left some in the directory and
        ``resume`` is False.
    """
    if directory.queries.exists() and not resume:
        raise StorageError(f"{directory.queries} is there already; resume that run or choose another folder")
    built = world.build()
    posterior_seed, candidate_seed, engine_seed, actions_seed, weights_seed = spawn_seeds(seed, 5)
    posterior = make_posterior(config, len(components), np.random.default_rng(posterior_seed))
    centred = 1.0 if config.acquisition == "random" else config.centred
    chooser = QueryChooser(posterior, config.acquisition, config.candidates, candidate_seed, centred)
    engine = EngineVecEnv(built, config.episodes, seed=engine_seed)
    vector = ScalarisedRewards(engine, components, posterior.weights())
    weights_rng = np.random.default_rng(weights_seed)
    played = np.empty((config.episodes, len(components)), dtype=np.float32)
    venv = ConditionedRewards(vector, lambda count: played[:count])
    asker = TeacherAsker(teacher, chooser, posterior, 0, config.queries, directory.queries)
    asker.read()
    # Everything is done again but the asking, which takes seconds.
    write_lines(directory.metrics, [])
    env_steps = tries = 0
    with sampling_seed(actions_seed):
        while True:
            weights = posterior.weights()
            done = posterior.num_queries == config.queries or tries == 2 * config.queries
            played = np.tile(weights, (config.episodes, 1)).astype(np.float32)
            if not done:
                draws = normalise_rows(weights_rng.choice(posterior.samples, config.episodes // 2))
                played[1::2] += config.exploration * (draws - weights)
            episodes: deque[Episode] = deque(play_once(policy, venv))
            env_steps += sum(len(episode.replay.actions) for episode in episodes)
            following = list(episodes)[:: 1 if done else 2]
            means = np.mean([episode.objectives for episode in following], axis=0).tolist()
            objectives = dict(zip(built.objective_names, means, strict=True))
            line = {
                "env_steps": env_steps,
                "queries": posterior.num_queries,
                "weights": dict(zip(vector.names, weights.tolist(), strict=True)),
                "objectives": objectives,
            }
            append_line(directory.metrics, line)
            if on_progress is not None:
                skipped = tries - posterior.num_queries
                total = (config.queries + skipped + 1) * config.episodes * built.horizon
                on_progress(Progress(env_steps, total, objectives, posterior.num_queries))
            if done:
                return AlignedAgent(policy.policy_at(weights), weights, env_steps, posterior.num_queries)
            asker.ask(env_steps, episodes)
            tries += 1
