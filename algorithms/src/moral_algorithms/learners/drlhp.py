"""DRLHP: a policy and a reward network, learned side by side from preferences (Christiano et al. 2017).

The agent is given no reward. A teacher compares pairs of clips of its episodes; an ensemble of networks
r(s, a) is fitted to the answers under a Bradley-Terry model (thesis eq. 4.15); PPO trains on the mean of the
networks' standardised rewards. A first share of the queries is about episodes of the untrained policy, the
others are spread over the training; those are asked whose answer the members of the ensemble disagree about.

The networks see states, actions and answers. The world's own rewards and its counters they never see: the
counters go to the teacher, those within the two clips and no others.

An answer is on the disk before it counts. After a crash training goes on from the last checkpoint; answers
that were given since are used where they belong and not asked for again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import get_device

from moral_algorithms.bridge import EngineVecEnv, LearnedActionReward, Replay, ScalarisedRewards
from moral_algorithms.learners.clips import AnsweredClips, play_untrained
from moral_algorithms.learners.interview import Interview
from moral_algorithms.learners.ppo import (
    BatchedBootstrap,
    EntropySchedule,
    ObjectiveMonitor,
    OnProgress,
    PPOConfig,
    learn,
    least_steps,
    make_ppo,
    sampling_seed,
)
from moral_algorithms.learners.resuming import ResumableLearner, require_unstarted
from moral_algorithms.learners.reward_model import RewardModel, RewardModelConfig
from moral_algorithms.networks.rewards import ActionRewardEnsemble
from moral_algorithms.preferences import Teacher
from moral_algorithms.run_directory import RunDirectory, append_line
from moral_algorithms.seeding import spawn_seeds
from moral_algorithms.storage import Arrays, arrays_under
from moral_algorithms.worlds import WorldSpec
from moral_envs.world import World

SCHEDULES = ("constant", "decaying")
"""How the queries are spread over training."""

# States by which rewards are standardised.
_STANDARDISING = 4096


@dataclass(frozen=True)
class DRLHPConfig:
    """How DRLHP trains and asks."""

    steps: int = 1_200_000
    """Environment steps, those of the untrained policy's episodes included."""
    queries: int = 1000
    """Questions to the teacher."""
    clip_length: int = 25
    """Steps of the clips that are compared; 0 compares whole episodes."""
    initial_share: float = 0.25
    """Part of the queries that is asked about episodes of the untrained policy."""
    schedule: str = "decaying"
    """How the others are spread: constant, or decaying, as 1 / (10 % of the training + time)."""
    query_span: float = 1.0
    """Part of the training over which they are spread; after it nobody corrects the reward any more."""
    candidates: int = 10
    """Random pairs of clips per query, of which those that the ensemble disagrees about most are asked."""
    checkpoint_every: int = 20
    """Rollouts between checkpoints."""
    reward: RewardModelConfig = field(default_factory=RewardModelConfig)
    """How the reward is learned from the answers."""
    ppo: PPOConfig = field(
        default_factory=lambda: PPOConfig(
            batch_size=800, epochs=5, gae_lambda=0.9, entropy_start=0.05, entropy_end=0.0
        )
    )
    """Hyperparameters of PPO."""

    def __post_init__(self) -> None:
        minima = {"steps": 1, "queries": 0, "clip_length": 0, "candidates": 1, "checkpoint_every": 1}
        for name, minimum in minima.items():
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least {minimum}")
        if not 0 <= self.initial_share <= 1:
            raise ValueError(f"initial_share is {self.initial_share}; it must be 0 to 1")
        if self.schedule not in SCHEDULES:
            raise ValueError(f"schedule is {self.schedule!r}; it must be one of {list(SCHEDULES)}")
        if not 0 < self.query_span <= 1:
            raise ValueError(f"query_span is {self.query_span}; it must be above 0 and at most 1")

    @property
    def initial_queries(self) -> int:
        """Queries about episodes of the untrained policy."""
        return round(self.initial_share * self.queries)

    def due_queries(self, progress: float) -> int:
        """How many queries should have been asked after a part of the time in which one can, from 0 on."""
        done = min(progress / self.query_span, 1.0)
        if self.schedule == "decaying":
            # The integral of 1 / (0.1 + t), so that it is 1 at the end.
            done = math.log1p(done * self.query_span / 0.1) / math.log1p(self.query_span / 0.1)
        # Rounding errors must not swallow the last one.
        return self.initial_queries + int((self.queries - self.initial_queries) * done + 1e-9)


def _paper(world: WorldSpec) -> DRLHPConfig:
    """Take the thesis's networks and settings (B.1, B.1.3, tables B.4 and B.7)."""
    delivery = world.name == "delivery"
    horizon = world.build().horizon
    episodes = 12
    return DRLHPConfig(
        steps=12_000_000,
        queries=5000 if delivery else 1000,
        clip_length=0,
        initial_share=0.0,
        schedule="constant",
        query_span=1.0,
        candidates=1,
        reward=RewardModelConfig(
            architecture="paper",
            members=1,
            lapse=0.0,
            # One for every 50 environment steps.
            updates=max(episodes * horizon // 50, 1),
            batch_size=12 if delivery else 32,
            learning_rate=3e-5,
            weight_decay=0.0,
        ),
        ppo=PPOConfig(
            policy="paper",
            num_envs=episodes,
            rollout_steps=horizon,
            batch_size=episodes * horizon,
            epochs=5,
            learning_rate=3e-4,
            gamma=0.999,
            clip_range=0.1,
            entropy_start=1.0,
            entropy_end=1.0,
        ),
    )


def _fast(world: WorldSpec) -> DRLHPConfig:
    """Take egocentric networks, clips and an ensemble; the horizon bounds the clips."""
    config = DRLHPConfig()
    return replace(config, clip_length=min(config.clip_length, world.build().horizon))


PRESETS: dict[str, Callable[[WorldSpec], DRLHPConfig]] = {"fast": _fast, "paper": _paper}
"""Configurations for a world, by name."""


class PreferredAgent(NamedTuple):
    """What DRLHP found."""

    policy: ActorCriticPolicy
    """The trained policy."""
    network: ActionRewardEnsemble
    """The learned reward r(s, a)."""
    queries: int
    """Answers it was given."""
    env_steps: int
    """Environment steps it took, those of the untrained policy's episodes included."""


def train_drlhp(
    world: WorldSpec,
    teacher: Teacher,
    config: DRLHPConfig,
    seed: int,
    directory: RunDirectory,
    device: str = "cpu",
    tensorboard: Path | None = None,
    on_progress: OnProgress | None = None,
    resume: bool = False,
) -> PreferredAgent:
    """Train an agent, from the start or from where a run in the directory stands.

    Parameters
    ----------
    world
        Where it acts; all its episodes must be of the same length.
    teacher
        Answers the queries.
    config
        How it trains and asks.
    seed
        Entropy of environments, networks, actions, clips and batches.
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
        If episodes of this world may end early, clips are longer than they are, or there are too few steps.
    StorageError
        If something cannot be written, what is to be continued is damaged, or a run has left a checkpoint or
        queries in the directory and ``resume`` is False.
    """
    if not resume:
        require_unstarted(directory)
    built = world.build()
    require_fitting(config, built)
    ppo_seed, network_seed, batch_seed, pair_seed, start_seed = spawn_seeds(seed, 5)
    engine = EngineVecEnv(built, config.ppo.num_envs, seed=ppo_seed)
    shape = engine.engine.observation_shape
    with sampling_seed(network_seed):
        network = ActionRewardEnsemble(
            shape, built.num_actions, config.reward.architecture, config.reward.members
        ).to(get_device(device))
    venv = ScalarisedRewards(engine, [LearnedActionReward("preferred", network)], [1.0])
    model = make_ppo(config.ppo, venv, ppo_seed, device, tensorboard)
    length = clip_length(config, built)
    answers = AnsweredClips(shape, length, config.queries)
    reward = RewardModel(network, answers, config.reward, batch_seed)
    training_steps = config.steps - untrained_steps(config, built)
    schedule = EntropySchedule(config.ppo.entropy_start, config.ppo.entropy_end, training_steps)
    monitor = ObjectiveMonitor(built.objective_names, training_steps, on_progress)
    interview = Interview(built, reward, teacher, length, config.candidates, pair_seed, directory.queries)
    learner = RewardLearner(built, reward, interview, config, start_seed, directory, monitor)
    interview.read(config.queries)
    learner.restore(model)
    learn(model, training_steps, [schedule, BatchedBootstrap(), monitor, learner])
    learner.save(model)
    env_steps = model.num_timesteps + untrained_steps(config, built)
    return PreferredAgent(model.policy, network, len(answers), env_steps)


def clip_length(config: DRLHPConfig, world: World) -> int:
    """Count the steps of the clips that are compared."""
    return config.clip_length or world.horizon


def untrained_steps(config: DRLHPConfig, world: World) -> int:
    """Environment steps of the untrained policy's episodes, one for each environment."""
    return config.ppo.num_envs * world.horizon if config.initial_queries else 0


def require_fitting(config: DRLHPConfig, world: World) -> None:
    """Raise a ValueError if DRLHP cannot train so in this world."""
    if world.ends_early:
        raise ValueError(f"world is {world.name}; its episodes must all take the same number of steps")
    if config.clip_length > world.horizon:
        raise ValueError(
            f"clip_length is {config.clip_length}; an episode of {world.name} has {world.horizon} steps"
        )
    if config.ppo.num_envs < 2:
        raise ValueError(f"ppo.num_envs is {config.ppo.num_envs}; it must be at least 2, to compare episodes")
    if config.steps <= untrained_steps(config, world):
        raise ValueError(
            f"steps is {config.steps}; it must be more than the {untrained_steps(config, world)} "
            "of the untrained policy"
        )
    least = untrained_steps(config, world) + least_steps(config.ppo, world)
    if config.queries > config.initial_queries and config.steps < least:
        raise ValueError(
            f"steps is {config.steps}; it must be at least {least}, for queries are about whole episodes of "
            f"{config.ppo.num_envs} environments, and what is learned from them needs a rollout more"
        )


class RewardLearner(ResumableLearner):
    """Has queries asked, fits the reward to the answers and standardises it.

    It acts at the end of a rollout, on episodes that ended since it last asked, one per environment.

    Parameters
    ----------
    world
        The rules.
    reward
        The ensemble and the answers.
    interview
        Chooses the queries and has them answered.
    config
        How many queries, and when.
    seed
        Entropy of the untrained policy's episodes.
    directory
        Where it writes.
    monitor
        Told how many queries are answered.
    """

    def __init__(
        self,
        world: World,
        reward: RewardModel,
        interview: Interview,
        config: DRLHPConfig,
        seed: int,
        directory: RunDirectory,
        monitor: ObjectiveMonitor,
    ) -> None:
        super().__init__("drlhp-checkpoint", directory, monitor, untrained_steps(config, world))
        self._world = world
        self._reward = reward
        self._interview = interview
        self._config = config
        self._seed = seed
        self._recent: deque[Replay] = deque(maxlen=config.ppo.num_envs)
        # States and actions of whole episodes: environments run in step, and a single rollout may hold only
        # beginnings or only ends, by which the other rewards would be scaled far too large or too small.
        self._experience: deque[tuple[NDArray[np.uint8], NDArray[np.int64]]] = deque(
            maxlen=math.ceil(world.horizon / config.ppo.rollout_steps)
        )
        self._rollouts = 0
        self._training_steps = config.steps - untrained_steps(config, world)
        # Nothing is learned from answers after the last rollout; and episodes end together, so that after the
        # last end before it there is none to ask about.
        rollout_steps = config.ppo.num_envs * config.ppo.rollout_steps
        round_steps = config.ppo.num_envs * world.horizon
        before_last = (self._training_steps - 1) // rollout_steps * rollout_steps
        self._asking_steps = before_last // round_steps * round_steps or self._training_steps

    @property
    def _env_steps(self) -> int:
        return self.num_timesteps + self._steps_before

    def state_dict(self) -> tuple[Arrays, dict[str, Any]]:
        """Copy the state of reward and interview, the last episodes and what rewards are standardised by."""
        reward_arrays, reward = self._reward.state_dict()
        arrays = {f"reward.{name}": value for name, value in reward_arrays.items()}
        arrays["recent.streams"] = np.array([replay.stream for replay in self._recent], dtype=np.uint64)
        arrays["recent.actions"] = np.array([replay.actions for replay in self._recent], dtype=np.uint8)
        for number, (states, taken) in enumerate(self._experience):
            arrays[f"experience.{number}.states"], arrays[f"experience.{number}.actions"] = states, taken
        interview = self._interview.state_dict()
        return arrays, {"experience": len(self._experience), "interview": interview, "reward": reward}

    def load_state_dict(self, arrays: Arrays, metadata: dict[str, Any]) -> None:
        """Go on where :meth:`state_dict` was taken, with the answers that the interview has read."""
        self._interview.load_state_dict(metadata["interview"])
        self._monitor.queries = self._interview.num_answers
        self._reward.load_state_dict(arrays_under(arrays, "reward."), metadata["reward"])
        recent = zip(arrays["recent.streams"], arrays["recent.actions"], strict=True)
        self._recent.extend(Replay(int(stream), actions) for stream, actions in recent)
        for number in range(int(metadata["experience"])):
            part = f"experience.{number}"
            self._experience.append((arrays[f"{part}.states"], arrays[f"{part}.actions"]))

    def _on_rollout_start(self) -> None:
        assert isinstance(self.model, PPO)
        self._rollouts += 1
        if self.num_timesteps == 0 and self._config.initial_queries:
            self._begin(self.model.policy)
        elif self._rollouts % self._config.checkpoint_every == 0:
            self.save(self.model)

    def _begin(self, policy: ActorCriticPolicy) -> None:
        """Ask about the untrained policy and fit the first reward."""
        starts, actions = spawn_seeds(self._seed, 2)
        with sampling_seed(actions):
            replays = play_untrained(policy, self._world, self._config.ppo.num_envs, starts)
        recording = self._interview.ask(replays, self._config.initial_queries, env_steps=0)
        self._monitor.queries = self._interview.num_answers
        self._reward.train(self._config.reward.initial_updates)
        self._standardise([(recording.states.reshape(-1, *recording.states.shape[2:]), recording.actions)])

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self._recent.extend(info["replay"] for info in self.locals["infos"] if "replay" in info)
        return True

    def _on_rollout_end(self) -> None:
        assert isinstance(self.model, PPO)
        asked = self._config.due_queries(self.num_timesteps / self._asking_steps)
        due = asked - self._interview.num_answers
        if due > 0 and len(self._recent) > 1:
            self._interview.ask(list(self._recent), due, self._env_steps)
            self._monitor.queries = self._interview.num_answers
            # The next ones are about other episodes.
            self._recent.clear()
        self._reward.train(self._config.reward.updates, 1 - self.num_timesteps / self._training_steps)
        buffer = self.model.rollout_buffer
        states = buffer.observations.reshape(-1, *buffer.observations.shape[2:])
        # Evenly over time and environments, without a draw.
        rows = np.linspace(0, len(states) - 1, min(self._share, len(states))).astype(np.int64)
        self._experience.append((states[rows], buffer.actions.reshape(-1)[rows].astype(np.int64)))
        self._standardise(list(self._experience))
        for name, loss in self._reward.losses.items():
            self.logger.record(f"reward/{name}_loss", loss)
        line = {
            "env_steps": self._env_steps,
            "queries": self._interview.num_answers,
            "losses": dict(self._reward.losses),
            "objectives": self._monitor.means,
        }
        append_line(self._directory.metrics, line)

    @property
    def _share(self) -> int:
        """States of each rollout by which rewards are standardised."""
        assert self._experience.maxlen is not None
        return math.ceil(_STANDARDISING / self._experience.maxlen)

    def _standardise(self, experience: list[tuple[NDArray[np.uint8], NDArray[np.int64]]]) -> None:
        """Standardise the rewards by what the policy did of late; without an answer there are none."""
        if self._interview.num_answers == 0:
            return
        device = self._reward.network.means.device
        states = np.concatenate([part for part, _ in experience])
        actions = np.concatenate([part.reshape(-1) for _, part in experience])
        self._reward.network.standardise(
            torch.from_numpy(states).to(device), torch.from_numpy(actions).to(device)
        )
