"""How weights are inferred from preferences: priors, likelihoods and the choice of queries, by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from moral_algorithms.preferences import (
    ACQUISITIONS,
    SAMPLERS,
    BallPrior,
    BradleyTerry,
    ExponentialProxy,
    Likelihood,
    Posterior,
    Prior,
    RationalityPrior,
)

PRIORS: dict[str, Callable[[int, float], Prior]] = {
    "rationality": lambda dim, concentration: RationalityPrior(dim, concentration=concentration),
    "ball": lambda dim, _: BallPrior(dim),
}
"""Priors over the weights by name, made from their number and a concentration."""

LIKELIHOODS: dict[str, Callable[[float, float], Likelihood]] = {
    "bradley_terry": BradleyTerry,
    "exponential": lambda rationality, _: ExponentialProxy(rationality),
}
"""Likelihoods of a preference by name, made from a rationality and a lapse rate."""


_RATIONALITY = 20.0


@dataclass(frozen=True)
class InferenceConfig:
    """How many queries there are, how they are chosen and what is learned from the answers."""

    queries: int = 25
    """Questions to the teacher."""
    candidates: int = 2000
    """Random pairs of recent episodes from which each query is chosen."""
    acquisition: str = "expected_regret"
    """How: expected_regret, mutual_information, volume_removal or random."""
    prior: str = "rationality"
    """Prior over the weights: rationality (infers the teacher's) or ball (thesis eq. 4.4)."""
    concentration: float = 1.0
    """Of the rationality prior's weights: 1 holds all alike, more that every component counts. The ball prior
    has none."""
    likelihood: str = "bradley_terry"
    """Likelihood of an answer: bradley_terry (eq. 4.1) or exponential (eq. 4.12)."""
    rationality: float = _RATIONALITY
    """Scale of the likelihood on returns of order one under the ball prior; the other prior infers it."""
    lapse: float = 0.1
    """Share of the answers that the bradley_terry likelihood takes to be random, so that no single one rules
    anything out for good. The exponential likelihood knows none: 0."""
    sampler: str = "hit_and_run"
    """Sampler of the posterior: hit_and_run or metropolis (thesis)."""
    samples: int = 1000
    """Samples of the posterior."""

    def __post_init__(self) -> None:
        for name, minimum in (("queries", 0), ("candidates", 1), ("samples", 2)):
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least {minimum}")
        choices: dict[str, Sequence[str]] = {
            "acquisition": sorted(ACQUISITIONS),
            "prior": sorted(PRIORS),
            "likelihood": sorted(LIKELIHOODS),
            "sampler": sorted(SAMPLERS),
        }
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}; it must be one of {known}")
        if not (math.isfinite(self.rationality) and self.rationality > 0):
            raise ValueError(f"rationality is {self.rationality}; it must be positive and finite")
        if not 0 <= self.lapse < 1:
            raise ValueError(f"lapse is {self.lapse}; it must be at least 0 and below 1")
        if not (math.isfinite(self.concentration) and self.concentration >= 1):
            raise ValueError(f"concentration is {self.concentration}; it must be at least 1 and finite")
        if self.prior == "ball" and self.concentration != 1:
            raise ValueError(f"concentration is {self.concentration}; it must be 1 with the ball prior")
        if self.prior == "rationality" and self.rationality != _RATIONALITY:
            raise ValueError(
                f"rationality is {self.rationality}; it belongs to the ball prior, the other infers it"
            )
        if self.likelihood == "exponential" and self.prior != "ball":
            raise ValueError(
                f"prior is {self.prior!r}; it must be 'ball' with the exponential likelihood, which tells "
                "nothing of a teacher's rationality"
            )
        if self.likelihood == "exponential" and self.lapse:
            raise ValueError(f"lapse is {self.lapse}; it must be 0 with the exponential likelihood")


def make_posterior(config: InferenceConfig, dim: int, rng: np.random.Generator) -> Posterior:
    """Make the posterior over ``dim`` weights that a configuration asks for, before any answer."""
    prior = PRIORS[config.prior](dim, config.concentration)
    rationality = config.rationality if config.prior == "ball" else 1.0
    likelihood = LIKELIHOODS[config.likelihood](rationality, config.lapse)
    return Posterior(prior, likelihood, SAMPLERS[config.sampler], num_samples=config.samples, rng=rng)
