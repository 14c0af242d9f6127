"""The reward vector of a learner and the wrapper that scalarises it with replaceable weights."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from moral_algorithms.bridge.vec_env import EngineVecEnv, Transitions
from moral_algorithms.networks.rewards import ActionRewardEnsemble, ShapedRewardNetwork
from moral_algorithms.networks.sparse import Rows
from moral_algorithms.networks.stamps import Stamp, stamp


class RewardComponent(Protocol):
    """One component of a reward vector, evaluated on a whole batch of transitions."""

    name: str

    def __call__(self, transitions: Transitions) -> NDArray[np.float32]:
        """Compute float32 rewards of shape (n,) for a batch of n transitions."""
        ...


class PrimaryReward:
    """A component read from the environment's own reward vector, times a constant.

    Parameters
    ----------
    world_reward_names
        The names of the environment's reward vector.
    name
        Which of them.
    scale
        What it is multiplied with, for instance one over the return of a policy that pursues it alone
        (eq. 5.2).

    Raises
    ------
    ValueError
        If there is no reward of that name.
    """

    def __init__(self, world_reward_names: Sequence[str], name: str, scale: float = 1.0) -> None:
        if name not in world_reward_names:
            raise ValueError(f"reward component is {name!r}; it must be one of {tuple(world_reward_names)}")
        self.name = name
        self.scale = scale
        self._index = list(world_reward_names).index(name)

    def __call__(self, transitions: Transitions) -> NDArray[np.float32]:
        """Compute rewards of shape (n,)."""
        rewards: NDArray[np.float32] = transitions.vector_rewards[:, self._index] * np.float32(self.scale)
        return rewards


class EncodedStates:
    """What reward networks of one architecture see of states (n, C, H, W).

    Parameters
    ----------
    network
        One of the networks.
    remembered
        How many of the last batches are kept, so that each is encoded once for all. Arrays are told apart by
        identity: one that is given again must not have changed.

    Attributes
    ----------
    encode : callable
        Encodes states and keeps nothing.
    """

    def __init__(self, network: ShapedRewardNetwork, remembered: int = 0) -> None:
        self.encode = network.encode
        self._last: deque[tuple[NDArray[np.uint8], Rows]] = deque(maxlen=remembered)

    def __call__(self, states: NDArray[np.uint8]) -> Rows:
        """Encode states (n, C, H, W)."""
        for known, seen in self._last:
            if known is states:
                return seen
        encoded = self.encode(states)
        self._last.append((states, encoded))
        return encoded


class LearnedReward:
    """A component computed by a reward network on (s, s'), times a constant.

    Parameters
    ----------
    name
        Its name in the reward vector.
    network
        AIRL's reward f(s, s'); its parameters may change between two steps.
    scale
        What it is multiplied with, for instance one over the imitation policy's return (eq. 5.2).

    Attributes
    ----------
    encoded : EncodedStates
        What the network sees; in a :class:`ScalarisedRewards`, components of one architecture on one device
        share it.
    """

    def __init__(self, name: str, network: ShapedRewardNetwork, scale: float = 1.0) -> None:
        self.name = name
        self.network = network
        self.scale = scale
        self.encoded = EncodedStates(network)
        self._valued: tuple[NDArray[np.uint8], Stamp, tuple[torch.Tensor, torch.Tensor]] | None = None
        self._remember = False

    def share(self, encoded: EncodedStates) -> None:
        """Take encoded states from there, and keep what the last were worth, which are the next step's first.

        From now on, arrays of states that are given again must not have changed.
        """
        self.encoded, self._remember, self._valued = encoded, True, None

    def __call__(self, transitions: Transitions) -> NDArray[np.float32]:
        """Compute rewards of shape (n,)."""
        now = stamp(self.network)
        with torch.no_grad():
            g, h = self._values(transitions.observations, now)
            _, next_h = self._values(transitions.next_observations, now)
            rewards = self.network.combine(g, h, next_h)
        array: NDArray[np.float32] = rewards.cpu().numpy() * np.float32(self.scale)
        return array

    def _values(self, states: NDArray[np.uint8], now: Stamp) -> tuple[torch.Tensor, torch.Tensor]:
        """Compute g and h, unless they have just been computed."""
        known = self._valued
        if known is not None and known[0] is states and known[1] == now:
            return known[2]
        values = self.network.values(self.encoded(states))
        if self._remember:
            self._valued = states, now, values
        return values


class LearnedActionReward:
    """A component computed by an ensemble of reward networks on (s, a), standardised.

    Parameters
    ----------
    name
        Its name in the reward vector.
    network
        The ensemble; its scales may change between two steps.
    """

    def __init__(self, name: str, network: ActionRewardEnsemble) -> None:
        self.name = name
        self.network = network

    def __call__(self, transitions: Transitions) -> NDArray[np.float32]:
        """Compute rewards of shape (n,)."""
        device = self.network.means.device
        with torch.no_grad():
            rewards = self.network.standardised(
                torch.from_numpy(transitions.observations).to(device),
                torch.from_numpy(transitions.actions).to(device),
            )
        array: NDArray[np.float32] = rewards.cpu().numpy()
        return array


def _share_encodings(components: Iterable[RewardComponent]) -> None:
    """Let learned rewards of one architecture encode each state once for all of them.

    The next states of one step are the states of the following one, unless an episode ended; the environments
    hand out fresh arrays at every step.
    """
    shared: dict[tuple[str, torch.device], EncodedStates] = {}
    for component in components:
        if isinstance(component, LearnedReward):
            device = next(component.network.parameters()).device
            key = (component.network.architecture, device)
            if key not in shared:
                shared[key] = EncodedStates(component.network, remembered=2)
            component.share(shared[key])


def require_weights(weights: ArrayLike, names: Sequence[str]) -> NDArray[np.float32]:
    """Scalarisation weights as a fresh float32 array of shape (k,), checked.

    Raises
    ------
    ValueError
        If there is not one finite, non-negative weight per component, or all are zero.
    """
    array = np.array(weights, dtype=np.float32)
    if array.shape != (len(names),):
        raise ValueError(
            f"weights are {array.tolist()}; there must be {len(names)}, one for each of {tuple(names)}"
        )
    if not np.isfinite(array).all() or (array < 0).any() or not array.any():
        raise ValueError(
            f"weights are {array.tolist()}; they must be finite and not negative, and not all zero"
        )
    return array


class ScalarisedRewards(VecEnvWrapper):
    """Replaces the reward by ``weights @ components(s, a, s')``.

    Parameters
    ----------
    venv
        The environments.
    components
        The reward vector: components of different names, one per weight.
    weights
        Scalarisation weights, shape (d,), not negative and not all zero.

    Attributes
    ----------
    rewards : float32 array of shape (n, d)
        The components at the last step.
    returns : float32 array of shape (n, d)
        Undiscounted returns of the current episodes, the last step included; of an ended episode until the
        next step.

    Raises
    ------
    ValueError
        If two components share a name, or the weights do not fit the components.
    """

    venv: EngineVecEnv

    def __init__(self, venv: EngineVecEnv, components: Sequence[RewardComponent], weights: ArrayLike) -> None:
        super().__init__(venv)
        self.components = tuple(components)
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"components are named {self.names}; every name must be another")
        _share_encodings(self.components)
        self.weights = weights
        self.rewards = np.zeros((self.num_envs, len(self.components)), dtype=np.float32)
        self.returns = np.zeros_like(self.rewards)
        self._dones = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components."""
        return tuple(component.name for component in self.components)

    @property
    def weights(self) -> NDArray[np.float32]:
        """Scalarisation weights, a copy of shape (d,).

        Set them to scalarise differently from the next step on; from above other wrappers, with
        ``set_attr("weights", ...)``.
        """
        return self._weights.copy()

    @weights.setter
    def weights(self, weights: ArrayLike) -> None:
        self._weights = require_weights(weights, self.names)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Find an attribute of every environment; ``weights`` are those of all."""
        if attr_name == "weights":
            return [self.weights for _ in self._get_indices(indices)]
        return super().get_attr(attr_name, indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set ``weights``, for all environments: so they are reached from wrappers above this one.

        Raises
        ------
        ValueError
            If the weights do not fit the components, or are to be those of some environments only.
        """
        if attr_name != "weights":
            super().set_attr(attr_name, value, indices)
        elif indices is not None:
            raise ValueError(f"indices are {indices}; all environments have the same weights")
        else:
            self.weights = value

    def reset(self) -> NDArray[np.uint8]:
        """Start new episodes everywhere."""
        self.returns = np.zeros_like(self.returns)
        self._dones = np.zeros_like(self._dones)
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Take the step; ``infos[i]["returns"]`` of an ended episode holds its vector return, shape (d,)."""
        observations, _, dones, infos = self.venv.step_wait()
        transitions = self.venv.transitions
        assert transitions is not None
        # New arrays at every step: what somebody has kept of an earlier one stays as it is.
        self.rewards = np.empty_like(self.rewards)
        for column, component in enumerate(self.components):
            rewards = component(transitions)
            assert rewards.shape == (self.num_envs,), f"{component.name}: {rewards.shape} is not (n,)"
            self.rewards[:, column] = rewards
        self.returns = np.where(self._dones[:, None], 0, self.returns) + self.rewards
        self._dones = dones
        for row in dones.nonzero()[0]:
            infos[row]["returns"] = self.returns[row].copy()
        return observations, self.rewards @ self._weights, dones, infos

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copy the state of environments, returns and weights into arrays, for an exact continuation."""
        own = {"returns": self.returns.copy(), "dones": self._dones.copy(), "weights": self._weights.copy()}
        return {**{f"venv.{name}": value for name, value in self.venv.state_dict().items()}, **own}

    def load_state_dict(self, state: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
        """Continue from what :meth:`state_dict` returned.

        Returns
        -------
        uint8 array of shape (n, C, H, W)
            The observations from which it goes on.

        Raises
        ------
        ValueError
            If the state is of other environments or of another number of components.
        """
        prefix = "venv."
        inner = {name[len(prefix) :]: value for name, value in state.items() if name.startswith(prefix)}
        weights = require_weights(state["weights"], self.names)
        observations = self.venv.load_state_dict(inner)
        self.returns, self._dones, self._weights = state["returns"].copy(), state["dones"].copy(), weights
        return observations
