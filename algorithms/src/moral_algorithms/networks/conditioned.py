"""A policy for every scalarisation: the ``fast`` network with the weights as further inputs.

The weights enter the first layer alone. For fixed ones their part of it is a bias, and what remains is an
ordinary ``fast`` policy.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from moral_algorithms.bridge.reward_vector import require_weights
from moral_algorithms.networks.egocentric import SparseEgocentricCrop
from moral_algorithms.networks.optimisers import EagerAdam
from moral_algorithms.networks.policies import EgocentricPolicy, EncodingPolicy, perceptron
from moral_algorithms.networks.precision import fast_matmul
from moral_algorithms.networks.sparse import Index, SparseRows

RADIUS = 5
HIDDEN = (256, 256)

# A handful of weights stands beside hundreds of cells. On the cells' scale training hardly sees them, and the
# policy becomes the same for all; on a much larger one it learns slowly.
_LOUDNESS = 8.0


class ConditionedRows(NamedTuple):
    """Encoded observations of a policy for all weights."""

    planes: SparseRows
    """The crop around the agent, n rows."""
    weights: torch.Tensor
    """float32 of shape (n, d)."""

    def __getitem__(self, index: Index) -> ConditionedRows:  # type: ignore[override]
        """Take some of the rows."""
        planes, weights = self
        return ConditionedRows(planes[index], weights[index])


class ConditionedFeatures(BaseFeaturesExtractor):
    """A multilayer perceptron on the crop around the agent and on the scalarisation weights.

    The weights are seen as multiples of their mean and, for the small ones, as logarithms of their ratio to
    the largest.

    Parameters
    ----------
    observation_space
        As :func:`conditioned_space` makes it.
    shape
        Shape (C, H, W) of the planes.
    span
        Ratio to the largest weight below which weights look alike, above 1.
    hidden
        Sizes of the layers, each followed by a ReLU.
    """

    def __init__(
        self, observation_space: spaces.Box, shape: tuple[int, int, int], span: float, hidden: tuple[int, ...]
    ) -> None:
        super().__init__(observation_space, hidden[-1])
        self.shape = shape
        self.span = span
        self.crop = SparseEgocentricCrop(shape, RADIUS)
        components = observation_space.shape[0] - math.prod(shape)
        self.layers = perceptron((self.crop.size, *hidden))
        self.conditioning = nn.Linear(2 * components, hidden[0], bias=False)

    def encode(self, observations: NDArray[np.float32]) -> ConditionedRows:
        """Take planes and weights (n, C * H * W + d) apart."""
        cells = math.prod(self.shape)
        planes = observations[:, :cells].astype(np.uint8).reshape(-1, *self.shape)
        weights = torch.from_numpy(observations[:, cells:].copy())
        return ConditionedRows(self.crop(planes), weights.to(self.conditioning.weight.device))

    def shift(self, weights: torch.Tensor) -> torch.Tensor:
        """Compute what weights (n, d), not all zero, add to the first layer, shape (n, hidden[0])."""
        # Of about the size of what the crop adds: smaller inputs are learned late, and policies stay alike.
        shares = weights / weights.mean(dim=1, keepdim=True)
        ratios = weights / weights.amax(dim=1, keepdim=True)
        logarithms = torch.log(ratios.clamp(min=1 / self.span))
        shift: torch.Tensor = self.conditioning(_LOUDNESS * torch.cat([shares, logarithms], dim=1))
        return shift

    def forward(self, observations: torch.Tensor | ConditionedRows) -> torch.Tensor:
        """Features (n, hidden[-1]) of planes and weights, or of what ``encode`` makes of them."""
        if isinstance(observations, torch.Tensor):
            observations = self.encode(observations.detach().cpu().numpy())
        planes, weights = observations
        # In full precision: half would round the weights.
        first = self.layers[0](planes) + self.shift(weights)
        with fast_matmul(first.device):
            features: torch.Tensor = self.layers[1:](first)
        return features.float()


class ConditionedPolicy(EncodingPolicy):
    """Actor and critic as linear heads on shared :class:`ConditionedFeatures`.

    Parameters
    ----------
    *args, **kwargs
        For :class:`~stable_baselines3.common.policies.ActorCriticPolicy`; observations are float32 vectors,
        planes and weights one after the other.
    shape
        Shape (C, H, W) of the planes.
    components
        Number d of weights.
    span
        Ratio to the largest weight below which weights look alike, above 1.
    """

    def __init__(
        self, *args: Any, shape: tuple[int, int, int], components: int, span: float, **kwargs: Any
    ) -> None:
        self.shape = shape
        self.components = components
        self.span = span
        kwargs.setdefault("optimizer_class", EagerAdam)
        kwargs.update(
            net_arch=[],
            features_extractor_class=ConditionedFeatures,
            features_extractor_kwargs={"shape": shape, "span": span, "hidden": HIDDEN},
        )
        super().__init__(*args, **kwargs)

    @classmethod
    def build(
        cls, shape: tuple[int, int, int], num_actions: int, components: int, span: float
    ) -> ConditionedPolicy:
        """Make one with fresh parameters, for planes of a shape (C, H, W)."""
        space = conditioned_space(shape, components)
        actions = spaces.Discrete(num_actions)
        return cls(space, actions, lambda _: 0.0, shape=shape, components=components, span=span)

    def policy_at(self, weights: ArrayLike) -> EgocentricPolicy:
        """Make the ``fast`` policy that this one is under fixed weights, on the same device, ready to act.

        Parameters
        ----------
        weights
            Scalarisation weights, shape (d,), not negative and not all zero; only their ratios matter.

        Raises
        ------
        ValueError
            If the weights are something else.
        """
        names = tuple(f"component {number}" for number in range(1, self.components + 1))
        checked = torch.from_numpy(require_weights(weights, names)).to(self.device)
        planes = spaces.Box(0, 1, shape=self.shape, dtype=np.uint8)
        policy = EgocentricPolicy(
            planes, self.action_space, lambda _: 0.0, radius=RADIUS, hidden=HIDDEN, ortho_init=False
        )
        assert isinstance(self.features_extractor, ConditionedFeatures)
        with torch.no_grad():
            shift = self.features_extractor.shift(checked[None])[0]
        state = {name: value for name, value in self.state_dict().items() if "conditioning" not in name}
        for name in state:
            if name.endswith("features_extractor.layers.0.bias"):
                state[name] = state[name] + shift
        policy.load_state_dict(state)
        policy.to(self.device).set_training_mode(False)
        return policy


def conditioned_space(shape: tuple[int, int, int], components: int) -> spaces.Box:
    """Space of flattened planes (C, H, W), followed by weights."""
    return spaces.Box(0, 1, shape=(math.prod(shape) + components,), dtype=np.float32)
