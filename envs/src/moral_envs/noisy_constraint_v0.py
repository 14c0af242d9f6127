"""Noisy Constraint: one decision, whose cost is seen through noise.

## Description
A constrained Markov decision process of three states, too small to be hard in itself. From the start S
action 0 leads to S1 and action 1 to S2, and there the episode ends. S2 pays more and costs more. Whoever
bounds the cost by a threshold between the two costs wants S1. But what is seen is the cost plus noise, as
from a constraint that was learned, so the threshold has to be chosen for the noise, too:
`success_probability` says how often it then leads to the right decision.

    [S ]-0-> S1   reward 0.5, cost 0
        -1-> S2   reward 1, cost 1

The frame is `single_env(render_mode="ansi")` after `reset()`; the brackets show the state.

## Observation Space
A `uint8` array of shape `(3,)`: 1 for the state of S, S1, S2 that holds, 0 for the others.

## Action Space
`Discrete(2)`: go to S1, go to S2.

## Reward Space
A `float32` array of shape `(2,)`, named by `reward_names`:

- `reward`: what the state pays that is entered.
- `constraint`: minus its cost as it is observed, drawn anew each time from a normal distribution around the
  true cost with standard deviation `noise`. The sign makes more better in both components.

`info["objectives"]`, `int64` of shape `(2,)` and named by `objective_names`, counts which state was entered,
free of noise: `safe` for S1 and `unsafe` for S2. The true cost is `costs @ info["objectives"]`.

## Starting State
Always S.

## Episode Termination
After one step: S1 and S2 are terminal.

## Arguments
All faces take:

- `rewards` (default `(0.5, 1.0)`): what S1 and S2 pay.
- `costs` (default `(0.0, 1.0)`): what they cost.
- `noise` (default 0): standard deviation of an observed cost.
- `render_mode`: `None`, `"ansi"` or `"rgb_array"`.

`single_env` (Gymnasium, also `gymnasium.make("moral/NoisyConstraint-v0")`), `parallel_env` (PettingZoo's
parallel interface, of the one agent `agent_0`) and `env` (its agent-environment cycle) take no more.
`vector_env` (Gymnasium's vector interface, also `gymnasium.make_vec("moral/NoisyConstraint-v0",
num_envs=...)`) also takes:

- `num_envs` (default 1): environments in the batch.
- `autoreset_mode` (default `AutoresetMode.NEXT_STEP`): when an environment whose episode has ended is
  reset.

## Version History
- v0: first version.

## Credits
The example of section 3.1.2 of the thesis "Aligning AI with human norms: multi-objective deep reinforcement
learning with active preference elicitation" (Peschl, TU Delft 2021), its figure 3.2. The text gives the
costs 0 and 1 and says that S2 pays more; the default rewards are this package's choice, since the
figure's are not in the text.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray
from pettingzoo import AECEnv, ParallelEnv

from moral_envs.arguments import as_integer, is_finite, require_integer
from moral_envs.diagram import STATE_NAMES, draw_ansi, draw_rgb
from moral_envs.faces.common import Frame, of_agent, require_render_mode
from moral_envs.faces.resets import (
    Seeds,
    known_seed,
    require_mask,
    require_started,
    require_streams,
    still_waiting,
)
from moral_envs.streams import draw_integers, seed_unseeded, spawn_streams

__all__ = ["env", "parallel_env", "single_env", "success_probability", "vector_env"]

REWARD_NAMES = ("reward", "constraint")
OBJECTIVE_NAMES = ("safe", "unsafe")
NUM_ACTIONS = 2
RENDER_MODES = ("ansi", "rgb_array")

_AGENT = "agent_0"
_START = 0
_HALF_WORD = 2**16

Observation = NDArray[np.uint8]
Reward = NDArray[np.float32]
Info = dict[str, Any]


def success_probability(threshold: float, noise: float, costs: tuple[float, float] = (0.0, 1.0)) -> float:
    """Probability that a threshold on observed costs leads to S1 (thesis, equation 3.6).

    One cost of each state is observed. S1 is chosen if its cost seems to be within the threshold and that of
    S2 does not.

    Parameters
    ----------
    threshold
        The greatest cost that is allowed.
    noise
        Standard deviation of an observed cost, 0 or more.
    costs
        The true costs of S1 and S2.

    Returns
    -------
    float
        The probability.

    Raises
    ------
    ValueError
        If the threshold is no number, the noise negative, or the costs are not two.
    """
    payoffs = Payoffs(costs=costs, noise=noise)
    given: object = threshold
    if not isinstance(given, numbers.Real) or math.isnan(given):
        raise ValueError(f"threshold is {threshold!r}; it must be a number")
    safe, unsafe = (_probability_within(threshold, cost, payoffs.noise) for cost in payoffs.costs)
    return safe * (1 - unsafe)


def _probability_within(threshold: float, cost: float, noise: float) -> float:
    """Probability that an observed cost is at most the threshold."""
    if noise == 0:
        return float(cost <= threshold)
    return (1 + math.erf((threshold - cost) / (noise * math.sqrt(2)))) / 2


@dataclass(frozen=True)
class Payoffs:
    """What S1 and S2 pay and cost.

    Parameters
    ----------
    rewards, costs
        Of S1 and S2, finite.
    noise
        Standard deviation of an observed cost, 0 or more.

    Raises
    ------
    ValueError
        If a number is missing or out of range.
    """

    rewards: tuple[float, float] = (0.5, 1.0)
    costs: tuple[float, float] = (0.0, 1.0)
    noise: float = 0.0

    def __post_init__(self) -> None:
        for name in ("rewards", "costs"):
            pair = getattr(self, name)
            numbers = list(pair) if isinstance(pair, (Sequence, np.ndarray)) else []
            if len(numbers) != 2 or not all(map(is_finite, numbers)):
                raise ValueError(f"{name} is {pair!r}; it must be two finite numbers, for S1 and S2")
            object.__setattr__(self, name, (float(numbers[0]), float(numbers[1])))
        if not is_finite(self.noise) or self.noise < 0:
            raise ValueError(f"noise is {self.noise!r}; it must be a finite number, 0 or more")
        object.__setattr__(self, "noise", float(self.noise))

    @property
    def vectors(self) -> NDArray[np.float64]:
        """Reward vectors without noise, a row for each action."""
        return np.stack([self.rewards, 0.0 - np.array(self.costs)], axis=1)


class _Decisions:
    """A batch of environments: who is in which state, and what entering one pays."""

    def __init__(self, payoffs: Payoffs, num_envs: int = 1) -> None:
        self.payoffs = payoffs
        self.num_envs = require_integer("num_envs", num_envs, 1, "at least 1")
        self._vectors = payoffs.vectors
        self._streams = spawn_streams(None, self.num_envs)
        self._unseeded = np.ones(self.num_envs, dtype=np.bool_)
        self.states = np.full(self.num_envs, _START, dtype=np.int64)

    @property
    def objectives(self) -> NDArray[np.int64]:
        """Which terminal state was entered, int64 (n, 2), a fresh array."""
        return np.asarray(self.states[:, None] == [1, 2], dtype=np.int64)

    def observe(self) -> Observation:
        """Show the states, uint8 (n, 3), a fresh array."""
        return np.asarray(self.states[:, None] == np.arange(len(STATE_NAMES)), dtype=np.uint8)

    def seed(self, streams: NDArray[np.uint64], mask: NDArray[np.bool_] | None = None) -> None:
        """Set the random streams of all environments, or of those in ``mask``."""
        np.copyto(self._streams, streams, where=True if mask is None else mask)
        self._unseeded[slice(None) if mask is None else mask] = False

    def seed_unseeded(self, seed: int | None, mask: NDArray[np.bool_] | None = None) -> None:
        """Seed those environments that have never been seeded, when an episode starts: copies then differ."""
        seed_unseeded(self._streams, self._unseeded, seed, mask)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Go back to the start in all environments, or in those in ``mask``."""
        self.states[slice(None) if mask is None else mask] = _START

    def step(self, actions: ArrayLike) -> Reward:
        """Decide where the state is S, and go back to S elsewhere; returns rewards (n, 2), fresh."""
        chosen = np.asarray(actions)
        if chosen.dtype.kind not in "iu":
            raise ValueError(f"actions have dtype {chosen.dtype}; they must be integers")
        if chosen.shape != self.states.shape:
            raise ValueError(f"actions have shape {chosen.shape}; they must have shape {self.states.shape}")
        wrong = (chosen < 0) | (chosen >= NUM_ACTIONS)
        if wrong.any():
            raise ValueError(f"actions contain {chosen[wrong][0]}; an action is 0 to {NUM_ACTIONS - 1}")
        deciding = self.states == _START
        rewards = np.zeros((self.num_envs, len(REWARD_NAMES)), dtype=np.float64)
        rewards[deciding] = self._vectors[chosen[deciding]]
        streams = self._streams[deciding]
        rewards[deciding, 1] -= self.payoffs.noise * _draw_normal(streams)
        self._streams[deciding] = streams
        self.states[:] = np.where(deciding, 1 + chosen, _START)
        return rewards.astype(np.float32)

    def draw(self, render_mode: str | None) -> tuple[Frame, ...] | None:
        """Draw every environment as ``render_mode`` says; None without a render mode."""
        if render_mode is None:
            return None
        draw = draw_ansi if render_mode == "ansi" else draw_rgb
        rewards, costs = self.payoffs.rewards, self.payoffs.costs
        return tuple(draw(rewards, costs, state) for state in self.states.tolist())


def _draw_normal(streams: NDArray[np.uint64]) -> NDArray[np.float64]:
    """One standard normal number from every stream (Box and Muller), four draws each."""
    high, low, turn, part = draw_integers(streams, np.full(4, _HALF_WORD, dtype=np.uint64))
    radius = np.sqrt(-2 * np.log((high * _HALF_WORD + low + 1) / _HALF_WORD**2))
    return np.asarray(radius * np.cos(2 * np.pi * (turn * _HALF_WORD + part) / _HALF_WORD**2))


def _observation_space() -> spaces.Space[Any]:
    return spaces.Box(0, 1, shape=(len(STATE_NAMES),), dtype=np.uint8)


def _action_space() -> spaces.Space[Any]:
    return spaces.Discrete(NUM_ACTIONS)


def _reward_space(payoffs: Payoffs) -> spaces.Space[Any]:
    # Nothing is paid in a step that only resets.
    low, high = (bound([*payoffs.vectors, (0, 0)], axis=0) for bound in (np.min, np.max))
    if payoffs.noise > 0:
        low[1], high[1] = -np.inf, np.inf
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


class NoisyConstraintEnv(gymnasium.Env[Observation, int]):
    """The decision as a Gymnasium environment whose reward is a float32 array of shape (2,).

    Parameters
    ----------
    payoffs
        What the states pay and cost.
    render_mode
        None, ``"ansi"`` or ``"rgb_array"``.
    """

    def __init__(self, payoffs: Payoffs, render_mode: str | None = None) -> None:
        self._decisions = _Decisions(payoffs)
        self._running = False
        self.render_mode = require_render_mode(render_mode, RENDER_MODES)
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": 1}
        self.observation_space = _observation_space()
        self.action_space = _action_space()
        self.reward_space = _reward_space(payoffs)
        self.reward_dim = len(REWARD_NAMES)
        self.reward_names = REWARD_NAMES
        self.objective_names = OBJECTIVE_NAMES

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Start an episode; without a seed the random stream goes on from the last episode."""
        if seed is not None:
            seed = require_integer("seed", seed, 0, "0 or more")
            self._decisions.seed(spawn_streams(seed, 1))
        super().reset(seed=seed, options=options)
        self._decisions.seed_unseeded(known_seed(self.np_random_seed))
        self._decisions.reset()
        self._running = True
        return self._decisions.observe()[0], self._info()

    def step(self, action: int | np.integer[Any]) -> tuple[Observation, Reward, bool, bool, Info]:
        """Decide, which ends the episode."""
        if not self._running:
            raise ValueError("action was given outside an episode; call reset first")
        reward = self._decisions.step(np.reshape(action, -1))[0]
        self._running = False
        return self._decisions.observe()[0], reward, True, False, self._info()

    def render(self) -> Any:
        """Draw the current state as ``render_mode`` says."""
        frames = self._decisions.draw(self.render_mode)
        return None if frames is None else frames[0]

    def state(self) -> Observation:
        """Show the state, uint8 (3,), a fresh array."""
        shown: Observation = self._decisions.observe()[0]
        return shown

    def _info(self) -> Info:
        return {"objectives": self._decisions.objectives[0]}


class NoisyConstraintVectorEnv(VectorEnv[Observation, ArrayLike, NDArray[Any]]):
    """A batch of decisions; rewards are float32 arrays of shape (n, 2).

    ``infos`` and the modes of resetting are those of :class:`~moral_envs.faces.vector.GridVectorEnv`.

    Parameters
    ----------
    payoffs
        What the states pay and cost.
    num_envs
        Environments in the batch.
    render_mode
        None, ``"ansi"`` or ``"rgb_array"``.
    autoreset_mode
        When an environment whose episode has ended is reset.
    """

    def __init__(
        self,
        payoffs: Payoffs,
        num_envs: int = 1,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self._decisions = _Decisions(payoffs, num_envs)
        self.num_envs = num_envs = self._decisions.num_envs
        self.render_mode = require_render_mode(render_mode, RENDER_MODES)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            modes = [mode.value for mode in AutoresetMode]
            raise ValueError(f"autoreset_mode is {autoreset_mode!r}; it must be one of {modes}") from error
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": 1,
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = _observation_space()
        self.single_action_space = _action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.reward_space = _reward_space(payoffs)
        self.reward_dim = len(REWARD_NAMES)
        self.reward_names = REWARD_NAMES
        self.objective_names = OBJECTIVE_NAMES
        self.agent_reward_names = (REWARD_NAMES,)
        # Which environments wait for their first reset; None: none.
        self._unstarted: NDArray[np.bool_] | None = np.ones(num_envs, dtype=np.bool_)

    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start episodes in all environments, or in those of ``options["reset_mask"]``.

        An integer seed gives every environment a stream of its own, spawned from it; with a sequence,
        environment ``i`` goes through what a single environment does after ``reset(seed=seed[i])``.
        """
        mask = require_mask(options, self.num_envs)
        streams = require_streams(seed, self.num_envs, mask)
        if streams is not None:
            self._decisions.seed(streams.states, streams.given)
        super().reset(seed=as_integer(seed))
        self._decisions.seed_unseeded(known_seed(self.np_random_seed), mask)
        self._decisions.reset(mask)
        self._unstarted = still_waiting(self._unstarted, mask)
        return self._decisions.observe(), self._infos()

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observation, Reward, NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Take one step in every environment; ``actions`` are integers of shape (n,)."""
        require_started(self._unstarted)
        deciding = self._decisions.states == _START
        if self.autoreset_mode == AutoresetMode.DISABLED and not deciding.all():
            ended = int(deciding.argmin())
            raise ValueError(f"actions were given after the end of environment {ended}; call reset first")
        rewards = self._decisions.step(actions)
        final: Info = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            final = self._final(deciding)
            self._decisions.reset()
        truncations = np.zeros(self.num_envs, dtype=np.bool_)
        return self._decisions.observe(), rewards, deciding, truncations, {**self._infos(), **final}

    def render(self) -> tuple[Frame, ...] | None:
        """Draw all environments as ``render_mode`` says."""
        return self._decisions.draw(self.render_mode)

    def _final(self, ended: NDArray[np.bool_]) -> Info:
        observations = np.empty(self.num_envs, dtype=object)
        observations[:] = list(self._decisions.observe())
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": {"objectives": self._decisions.objectives, "_objectives": ended.copy()},
            "_final_info": ended.copy(),
        }

    def _infos(self) -> Info:
        everywhere = np.ones(self.num_envs, dtype=np.bool_)
        return {"objectives": self._decisions.objectives, "_objectives": everywhere}


class _OneAgent:
    """What the two PettingZoo faces share: the decision as Gymnasium has it, and its only agent."""

    def __init__(self, payoffs: Payoffs, render_mode: str | None = None) -> None:
        super().__init__()
        self._single = NoisyConstraintEnv(payoffs, render_mode)
        self.render_mode = self._single.render_mode
        self.metadata = {
            **self._single.metadata,
            "name": "noisy_constraint_v0",
            "is_parallelizable": True,
            "central_observation": True,
        }
        self.reward_names = REWARD_NAMES
        self.objective_names = OBJECTIVE_NAMES
        self.possible_agents = [_AGENT]
        self.agents: list[str] = []
        self.observation_spaces: dict[str, spaces.Space[Any]] = {_AGENT: self._single.observation_space}
        self.action_spaces: dict[str, spaces.Space[Any]] = {_AGENT: self._single.action_space}
        self.reward_spaces: dict[str, spaces.Space[Any]] = {_AGENT: self._single.reward_space}
        self.agent_reward_names = {_AGENT: REWARD_NAMES}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Space of the agent's observations, always the same object."""
        return of_agent(self.observation_spaces, agent)

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Space of the agent's actions, always the same object."""
        return of_agent(self.action_spaces, agent)

    def reward_space(self, agent: str) -> spaces.Space[Any]:
        """Space of the agent's reward vectors, always the same object."""
        return of_agent(self.reward_spaces, agent)

    def render(self) -> Any:
        """Draw the current state as ``render_mode`` says."""
        return self._single.render()

    def state(self) -> Observation:
        """Show the state as the agent sees it, uint8 (3,)."""
        return self._single.state()

    @property
    def state_space(self) -> spaces.Space[Any]:
        """Space of :meth:`state`."""
        return _observation_space()

    def get_central_observation_space(self) -> spaces.Space[Any]:
        """Space of :meth:`state`, for MOMAland's ``CentraliseAgent``."""
        return _observation_space()

    def close(self) -> None:
        """Nothing to release."""


class NoisyConstraintParallelEnv(_OneAgent, ParallelEnv[str, Observation, int]):
    """The decision of one agent as a PettingZoo parallel environment with vector rewards.

    Parameters
    ----------
    payoffs
        What the states pay and cost.
    render_mode
        None, ``"ansi"`` or ``"rgb_array"``.
    """

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, Info]]:
        """Start an episode; without a seed the random stream goes on from the last episode."""
        observation, info = self._single.reset(seed=seed, options=options)
        self.agents = list(self.possible_agents)
        return {_AGENT: observation}, {_AGENT: info}

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[dict[str, Observation], dict[str, Reward], dict[str, bool], dict[str, bool], dict[str, Info]]:
        """Decide, which ends the episode."""
        if not self.agents:
            raise ValueError("actions were given outside an episode; call reset first")
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions are {actions!r}; they must be a dict with one for each agent")
        if actions.keys() != {_AGENT}:
            raise ValueError(f"actions are for {list(actions)}; they must be for {self.agents}")
        observation, reward, terminated, truncated, info = self._single.step(actions[_AGENT])
        self.agents = []
        return (
            {_AGENT: observation},
            {_AGENT: reward},
            {_AGENT: terminated},
            {_AGENT: truncated},
            {_AGENT: info},
        )


class NoisyConstraintAECEnv(_OneAgent, AECEnv[str, Observation, int | None]):
    """The decision of one agent as a PettingZoo agent-environment-cycle environment with vector rewards.

    Parameters
    ----------
    payoffs
        What the states pay and cost.
    render_mode
        None, ``"ansi"`` or ``"rgb_array"``.
    """

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start an episode; without a seed the random stream goes on from the last episode."""
        _, info = self._single.reset(seed=seed, options=options)
        self.agents = list(self.possible_agents)
        self.agent_selection = _AGENT
        self._keep(np.zeros(len(REWARD_NAMES), dtype=np.float32), False, False, info)

    def step(self, action: int | None) -> None:
        """Decide, which ends the episode; then None takes the agent out."""
        if not self.agents:
            raise ValueError("action was given outside an episode; call reset first")
        if self.terminations[_AGENT]:
            self._was_dead_step(action)
            return
        if not self.action_spaces[_AGENT].contains(action):
            raise ValueError(f"action is {action!r}; it must be 0 to {NUM_ACTIONS - 1}")
        self._keep(*self._single.step(action)[1:])  # type: ignore[arg-type]  # None is not in the space

    def last(self, observe: bool = True) -> tuple[Observation | None, Reward, bool, bool, Info]:
        """Return what the agent sees, got for its decision, and whether the episode has ended."""
        if not self.agents:
            raise ValueError("last was called outside an episode; call reset first")
        self.infos: dict[str, Info] = {
            _AGENT: {name: array.copy() for name, array in self.infos[_AGENT].items()}
        }
        observation, reward, terminated, truncated, info = super().last(observe)
        return observation, reward.copy(), terminated, truncated, info

    def observe(self, agent: str) -> Observation:
        """Show the state, uint8 (3,), a fresh array."""
        self.observation_space(agent)  # refuses an unknown agent
        return self.state()

    def _keep(self, reward: Reward, terminated: bool, truncated: bool, info: Info) -> None:
        self.rewards = {_AGENT: reward}
        self._cumulative_rewards = {_AGENT: reward.copy()}
        self.terminations = {_AGENT: terminated}
        self.truncations = {_AGENT: truncated}
        self.infos = {_AGENT: info}


def single_env(
    *,
    rewards: tuple[float, float] = (0.5, 1.0),
    costs: tuple[float, float] = (0.0, 1.0),
    noise: float = 0.0,
    render_mode: str | None = None,
) -> NoisyConstraintEnv:
    """Noisy Constraint as a Gymnasium environment; see the module for the arguments."""
    payoffs = Payoffs(rewards, costs, noise)
    return NoisyConstraintEnv(payoffs, render_mode)


def vector_env(
    num_envs: int = 1,
    *,
    rewards: tuple[float, float] = (0.5, 1.0),
    costs: tuple[float, float] = (0.0, 1.0),
    noise: float = 0.0,
    render_mode: str | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
) -> NoisyConstraintVectorEnv:
    """Noisy Constraint as a Gymnasium vector environment; see the module for the arguments."""
    payoffs = Payoffs(rewards, costs, noise)
    return NoisyConstraintVectorEnv(payoffs, num_envs, render_mode, autoreset_mode)


def parallel_env(
    *,
    rewards: tuple[float, float] = (0.5, 1.0),
    costs: tuple[float, float] = (0.0, 1.0),
    noise: float = 0.0,
    render_mode: str | None = None,
) -> NoisyConstraintParallelEnv:
    """Noisy Constraint as a PettingZoo parallel environment; see the module for the arguments."""
    payoffs = Payoffs(rewards, costs, noise)
    return NoisyConstraintParallelEnv(payoffs, render_mode)


def env(
    *,
    rewards: tuple[float, float] = (0.5, 1.0),
    costs: tuple[float, float] = (0.0, 1.0),
    noise: float = 0.0,
    render_mode: str | None = None,
) -> NoisyConstraintAECEnv:
    """Noisy Constraint as PettingZoo's agent-environment cycle; see the module for the arguments."""
    payoffs = Payoffs(rewards, costs, noise)
    return NoisyConstraintAECEnv(payoffs, render_mode)


# Where Gymnasium looks for render modes before it makes an environment.
setattr(single_env, "metadata", {"render_modes": list(RENDER_MODES), "render_fps": 1})  # noqa: B010
