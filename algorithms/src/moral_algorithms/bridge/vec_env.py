"""The engine as a Stable-Baselines3 ``VecEnv``, without a loop over environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from moral_algorithms.replay import Replay
from moral_envs.engine import Engine
from moral_envs.streams import spawn_streams
from moral_envs.world import World


class Transitions(NamedTuple):
    """A batch of transitions (s, a, s') of one step, one row per agent of every environment."""

    observations: NDArray[np.uint8]
    """Shape (n, C, H, W)."""
    actions: NDArray[np.int64]
    """Shape (n,)."""
    next_observations: NDArray[np.uint8]
    """Shape (n, C, H, W): the true next observations, also where the episode ended."""
    vector_rewards: NDArray[np.float32]
    """The environment's own reward vectors, shape (n, k)."""


class EngineVecEnv(VecEnv):
    """A batch of environments for Stable-Baselines3, each agent one of its environments.

    Its scalar reward is the plain sum of the reward vector, where
    :class:`~moral_algorithms.bridge.reward_vector.ScalarisedRewards` puts weights. Every info has a
    ``vector_reward``, float32 of shape (k,). The info of an ended episode also carries
    ``terminal_observation`` and ``TimeLimit.truncated``, so that value estimates bootstrap at the
    horizon (and not at a terminal state), the final ``objectives``, int64 of shape (m,), and a ``replay``
    (:class:`Replay`).

    Parameters
    ----------
    world
        The rules.
    num_envs
        Environments in the batch.
    num_agents
        Agents per environment, who share the policy; rows are environment-major.
    team_reward
        Pay every agent the sum over all agents.
    seed
        Entropy of the environments' random streams, from the first reset on; None takes it from the
        operating system.

    Attributes
    ----------
    transitions : Transitions or None
        The last step since the last reset, for wrappers that compute rewards on the whole batch. Its arrays
        are shared: read them, do not change them.

    Raises
    ------
    ValueError
        If a number is out of range, or agents and objects do not fit into the world.
    """

    def __init__(
        self,
        world: World,
        num_envs: int,
        num_agents: int = 1,
        team_reward: bool = False,
        seed: int | None = None,
    ) -> None:
        self.engine = Engine(world, num_envs, num_agents, team_reward)
        self.engine.seed(spawn_streams(seed, num_envs))
        self.render_mode = None
        observation_space = spaces.Box(0, 1, shape=self.engine.observation_shape, dtype=np.uint8)
        super().__init__(num_envs * num_agents, observation_space, spaces.Discrete(world.num_actions))
        self.transitions: Transitions | None = None
        self._actions = np.zeros((num_envs, num_agents), dtype=np.int64)
        self._history = np.zeros((world.horizon, num_envs, num_agents), dtype=np.uint8)
        self._starts = self.engine.streams.copy()
        self._observations = self._observe()

    @property
    def world(self) -> World:
        """The rules."""
        return self.engine.world

    def reset(self) -> NDArray[np.uint8]:
        """Start new episodes everywhere; ``seed(s)`` before it chooses the random streams."""
        if self._seeds[0] is not None:
            self.engine.seed(spawn_streams(self._seeds[0], self.engine.num_envs))
        self._reset_seeds()
        self._reset_options()
        self._starts = self.engine.streams.copy()
        self.engine.reset()
        self.transitions = None
        self._observations = self._observe()
        return self._observations.copy()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions, integers of shape (n,), for ``step_wait``."""
        actions = np.asarray(actions)
        assert actions.shape == (self.num_envs,), f"actions {actions.shape} are not ({self.num_envs},)"
        assert actions.dtype.kind in "iu", f"actions are {actions.dtype}, not integers"
        self._actions = actions.astype(np.int64).reshape(self.engine.num_envs, self.engine.num_agents)

    def step_wait(self) -> VecEnvStepReturn:
        """Take the step: observations (n, C, H, W), rewards (n,), dones (n,) and one info per row."""
        before, actions = self._observations, self._actions.reshape(-1)
        self._history[self.engine.elapsed, np.arange(self.engine.num_envs)] = self._actions
        step = self.engine.step(self._actions)
        vector_rewards = step.rewards.reshape(self.num_envs, -1)
        after = self._observe()
        self.transitions = Transitions(before, actions, after, vector_rewards)
        infos: list[dict[str, Any]] = [{"vector_reward": row} for row in vector_rewards.copy()]
        ended = step.terminations | step.truncations
        dones = np.repeat(ended, self.engine.num_agents)
        self._observations = after
        if step.any_end:
            objectives = self.engine.objectives.reshape(self.num_envs, -1)
            lengths = self.engine.elapsed
            for row in dones.nonzero()[0]:
                env = row // self.engine.num_agents
                infos[row]["objectives"] = objectives[row]
                history = self._history[: lengths[env], env]
                infos[row]["replay"] = Replay(int(self._starts[env]), history.copy())
                infos[row]["terminal_observation"] = after[row].copy()
                infos[row]["TimeLimit.truncated"] = bool(step.truncations[env])
            self._starts = np.where(ended, self.engine.streams, self._starts)
            self.engine.reset(ended)
            self._observations = self._observe()
        return self._observations.copy(), vector_rewards.sum(axis=1), dones, infos

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copy the state of the engine and of the replays into arrays, for an exact continuation."""
        own: dict[str, NDArray[Any]] = {"starts": self._starts.copy(), "history": self._history.copy()}
        return {**{f"engine.{name}": value for name, value in self.engine.state_dict().items()}, **own}

    def load_state_dict(self, state: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
        """Continue from what :meth:`state_dict` returned, of as many environments and agents of this world.

        Returns
        -------
        uint8 array of shape (n, C, H, W)
            The observations from which it goes on.

        Raises
        ------
        ValueError
            If the state is of other environments.
        """
        prefix = "engine."
        engine = {name[len(prefix) :]: value for name, value in state.items() if name.startswith(prefix)}
        shape = state["history"].shape
        if shape != self._history.shape:
            raise ValueError(f"state['history'] has shape {shape}; it must be {self._history.shape}")
        self.engine.load_state_dict(engine)
        self._starts, self._history = state["starts"].copy(), state["history"].copy()
        self.transitions = None
        self._observations = self._observe()
        return self._observations.copy()

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return the same attribute for every row: rows share one engine."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Rows share one engine, so attributes cannot be set for some of them."""
        raise NotImplementedError("the rows of an EngineVecEnv share one engine; set its attributes directly")

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Rows share one engine, so methods cannot be called for some of them."""
        raise NotImplementedError("the rows of an EngineVecEnv share one engine; call its methods directly")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """No row is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """No pictures: see ``moral watch`` for episodes of a trained policy."""
        return [None] * self.num_envs

    def _observe(self) -> NDArray[np.uint8]:
        return self.engine.observe().reshape(self.num_envs, *self.engine.observation_shape)
