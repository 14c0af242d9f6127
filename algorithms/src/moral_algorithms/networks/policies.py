"""The agent's networks: ``fast`` sees the world from where it stands, ``paper`` is the thesis's."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from torch import nn
from torch.nn import functional

from moral_algorithms.networks.egocentric import SparseEgocentricCrop, planes_of
from moral_algorithms.networks.optimisers import EagerAdam
from moral_algorithms.networks.precision import fast_matmul
from moral_algorithms.networks.sparse import Index, SparseLinear, SparseRows


class EgocentricFeatures(BaseFeaturesExtractor):
    """A multilayer perceptron on the planes cropped around the agent.

    Parameters
    ----------
    observation_space
        Planes of shape (C, H, W).
    radius
        Cells seen in each direction.
    hidden
        Sizes of the layers, each followed by a ReLU; the last is the number of features.
    """

    def __init__(self, observation_space: spaces.Box, radius: int, hidden: tuple[int, ...]) -> None:
        super().__init__(observation_space, hidden[-1])
        channels, height, width = observation_space.shape
        self.encode = SparseEgocentricCrop((channels, height, width), radius)
        self.layers = perceptron((self.encode.size, *hidden))

    def forward(self, observations: torch.Tensor | SparseRows) -> torch.Tensor:
        """Features of a batch.

        Parameters
        ----------
        observations
            0/1 planes of any dtype, shape (n, C, H, W), or what ``encode`` makes of them.

        Returns
        -------
        float32 tensor of shape (n, hidden[-1])
        """
        rows = (
            self.encode(planes_of(observations)) if isinstance(observations, torch.Tensor) else observations
        )
        with fast_matmul(next(self.parameters()).device):
            features: torch.Tensor = self.layers(rows)
        return features.float()


class Encoded(Protocol):
    """Encoded observations of some rows."""

    def __getitem__(self, index: Index, /) -> Encoded:
        """Take some of the rows."""
        ...


class EncodingPolicy(ActorCriticPolicy):
    """An actor and critic whose features extractor has a part in which nothing is learned, ``encode``.

    What it makes of an array of observations is :class:`Encoded`, and ``forward`` takes it instead of them.
    """

    def encode(self, observations: NDArray[Any]) -> Encoded:
        """Encode observations (n, ...)."""
        encoded: Encoded = self.features_extractor.encode(observations)  # type: ignore[operator]
        return encoded

    def extract_features(
        self, obs: Any, features_extractor: BaseFeaturesExtractor | None = None
    ) -> torch.Tensor:
        """Features of observations or of what they were encoded as."""
        # Without SB3's preprocessing, which makes whole planes float32 only to cut most of them away.
        features: torch.Tensor = (features_extractor or self.features_extractor)(obs)
        return features

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Values (n, 1), and logarithms of actions' probabilities and entropies, both (n,)."""
        # SB3's distribution normalises logits twice and makes probabilities of them once more.
        latent_pi, latent_vf = self.mlp_extractor(self.extract_features(obs))
        logarithms = functional.log_softmax(self.action_net(latent_pi), dim=1)
        entropies = -(logarithms.exp() * logarithms).sum(dim=1)
        return self.value_net(latent_vf), logarithms.gather(1, actions.long()[:, None])[:, 0], entropies


class EgocentricPolicy(EncodingPolicy):
    """Actor and critic as linear heads on shared :class:`EgocentricFeatures`.

    Parameters
    ----------
    radius
        Cells seen in each direction.
    hidden
        Sizes of the shared layers.
    *args, **kwargs
        For :class:`~stable_baselines3.common.policies.ActorCriticPolicy`.
    """

    def __init__(
        self, *args: Any, radius: int = 5, hidden: tuple[int, ...] = (256, 256), **kwargs: Any
    ) -> None:
        kwargs.setdefault("optimizer_class", EagerAdam)
        kwargs.update(
            net_arch=[],
            features_extractor_class=EgocentricFeatures,
            features_extractor_kwargs={"radius": radius, "hidden": tuple(hidden)},
        )
        super().__init__(*args, **kwargs)


class EncodingRolloutBuffer(RolloutBuffer):
    """SB3's rollout buffer; what it hands out is encoded once, instead of in every epoch.

    Attributes
    ----------
    policy : EncodingPolicy or None
        Whose encoding it is; without one, observations are handed out as they are. SB3 builds the buffer
        before the policy: whoever builds both sets it.
    """

    policy: EncodingPolicy | None = None

    def reset(self) -> None:
        """Forget the rollout."""
        super().reset()
        self._encoded: Encoded | None = None

    def _get_samples(self, batch_inds: NDArray[np.int64], env: Any = None) -> RolloutBufferSamples:
        """Take a minibatch of the full buffer, its ``observations`` encoded."""
        if self.policy is None:
            return super()._get_samples(batch_inds, env)
        if self._encoded is None:
            self._encoded = self.policy.encode(self.observations)
        others = (self.actions, self.values, self.log_probs, self.advantages, self.returns)
        actions, *scalars = (self.to_torch(values[batch_inds], copy=False) for values in others)
        encoded: Any = self._encoded[batch_inds]
        return RolloutBufferSamples(encoded, actions, *(values.flatten() for values in scalars))


def perceptron(sizes: tuple[int, ...]) -> nn.Sequential:
    """Build layers for sparse rows of ``sizes[0]`` inputs, each followed by a ReLU."""
    layers: list[nn.Module] = [SparseLinear(sizes[0], sizes[1]), nn.ReLU()]
    for inputs, outputs in pairwise(sizes[1:]):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers)


class _ConvolutionalTrunk(BaseFeaturesExtractor):
    """The two convolutions that actor and critic share (thesis B.1.1)."""

    def __init__(self, observation_space: spaces.Box) -> None:
        channels, height, width = observation_space.shape
        super().__init__(observation_space, 256 * (height - 2) * (width - 2))
        self.map_shape = (256, height - 2, width - 2)
        self.layers = nn.Sequential(nn.Conv2d(channels, 64, 2), nn.ReLU(), nn.Conv2d(64, 256, 2), nn.ReLU())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        with fast_matmul(observations.device):
            maps: torch.Tensor = self.layers(observations.contiguous(memory_format=torch.channels_last))
        # Channels last, as they lie in memory: any other order takes copies that cost more than the layers.
        return maps.permute(0, 2, 3, 1).flatten(1)


class _ConvolutionalHeads(nn.Module):
    """One more convolution each for actor and critic, flattened; the linear layers follow in SB3's policy."""

    def __init__(self, map_shape: tuple[int, int, int]) -> None:
        super().__init__()
        channels, height, width = map_shape
        self.map_shape = map_shape
        self.latent_dim_pi = self.latent_dim_vf = 32 * (height - 1) * (width - 1)
        self.actor = nn.Sequential(nn.Conv2d(channels, 32, 2), nn.ReLU())
        self.critic = nn.Sequential(nn.Conv2d(channels, 32, 2), nn.ReLU())

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        return self._head(self.actor, features)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        return self._head(self.critic, features)

    def _head(self, head: nn.Sequential, features: torch.Tensor) -> torch.Tensor:
        channels, height, width = self.map_shape
        maps = features.reshape(-1, height, width, channels).permute(0, 3, 1, 2)
        with fast_matmul(features.device):
            latent: torch.Tensor = head(maps)
        return latent.flatten(1).float()


class ConvolutionalPolicy(ActorCriticPolicy):
    """The thesis's actor-critic network: shared convolutions of 64 and 256 channels, heads of 32 (B.1.1).

    All kernels are 2 x 2, without padding. The arguments are those of
    :class:`~stable_baselines3.common.policies.ActorCriticPolicy`.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("optimizer_class", EagerAdam)
        kwargs.update(features_extractor_class=_ConvolutionalTrunk)
        super().__init__(*args, **kwargs)
        # Only now: SB3's orthogonal initialisation does not accept channels-last weights.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.features_extractor, _ConvolutionalTrunk)
        self.mlp_extractor = _ConvolutionalHeads(self.features_extractor.map_shape)  # type: ignore[assignment]


POLICIES: dict[str, type[ActorCriticPolicy]] = {"fast": EgocentricPolicy, "paper": ConvolutionalPolicy}
"""The presets by name."""
