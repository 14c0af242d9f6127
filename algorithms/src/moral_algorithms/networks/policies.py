"""The agent's networks: ``fast`` sees the world from where it stands, ``paper`` is the thesis's."""

from __future__ import annotations

from collections.abc import Generator
from itertools import pairwise
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from torch import nn

from moral_algorithms.networks.egocentric import EgocentricCrop
from moral_algorithms.networks.optimisers import EagerAdam
from moral_algorithms.networks.precision import fast_matmul


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
        self.crop = EgocentricCrop((channels, height, width), radius)
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise((self.crop.size, *hidden)):
            layers += [nn.Linear(inputs, outputs), nn.ReLU()]
        self.layers = nn.Sequential(*layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features of a batch.

        Parameters
        ----------
        observations
            0/1 planes of any dtype, shape (n, C, H, W), or crops of them, shape (n, crop.size).

        Returns
        -------
        float32 tensor of shape (n, hidden[-1])
        """
        crops = observations if observations.dim() == 2 else self.crop(observations)
        with fast_matmul(observations.device):
            features: torch.Tensor = self.layers(crops.float())
        return features.float()


class EgocentricPolicy(ActorCriticPolicy):
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

    def extract_features(  # type: ignore[override]
        self, obs: torch.Tensor, features_extractor: BaseFeaturesExtractor | None = None
    ) -> torch.Tensor:
        """Features of planes (n, C, H, W) or of their crops (n, size)."""
        # Without SB3's preprocessing, which makes whole planes float32 only to cut most of them away.
        features: torch.Tensor = (features_extractor or self.features_extractor)(obs)
        return features


class CroppingRolloutBuffer(RolloutBuffer):
    """SB3's rollout buffer; it hands out crops of the observations, made once instead of once an epoch.

    Attributes
    ----------
    crop : EgocentricCrop
        Makes them. SB3 builds the buffer before the policy: whoever builds both gives it the policy's.
    """

    crop: EgocentricCrop

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """Minibatches of the full buffer in random order, ``observations`` of shape (batch_size, size)."""
        if not self.generator_ready:
            crops = self.crop(self.to_torch(self.observations.reshape(-1, *self.obs_shape), copy=False))
            self.observations = crops.cpu().numpy().reshape(self.buffer_size, self.n_envs, -1)
        yield from super().get(batch_size)


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
