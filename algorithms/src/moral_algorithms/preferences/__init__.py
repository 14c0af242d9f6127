"""Preference learning over linear scalarisations: queries, teachers, posterior and acquisition functions.

NumPy only. The chain of a run is

    posterior = Posterior(RationalityPrior(d), BradleyTerry(), rng=np.random.default_rng(seed))
    scores = ACQUISITIONS["volume_removal"](posterior.samples, candidates, posterior.likelihood, rng)
    preference = teacher.prefer(query)
    posterior.add(query.returns, preference)
    posterior.weights()
"""

from .acquisition import (
    ACQUISITIONS,
    Acquisition,
    expected_regret,
    mutual_information,
    random,
    volume_removal,
)
from .likelihoods import BradleyTerry, ExponentialProxy, Likelihood
from .posterior import Posterior
from .priors import BallPrior, Prior, RationalityPrior
from .query import Preference, Query
from .samplers import SAMPLERS, Sampler, hit_and_run, metropolis
from .teachers import (
    LexicographicTeacher,
    NoisyTeacher,
    RatioTeacher,
    TargetTeacher,
    Teacher,
    ratio_divergence,
)

__all__ = [
    "ACQUISITIONS",
    "SAMPLERS",
    "Acquisition",
    "BallPrior",
    "BradleyTerry",
    "ExponentialProxy",
    "LexicographicTeacher",
    "Likelihood",
    "NoisyTeacher",
    "Posterior",
    "Preference",
    "Prior",
    "Query",
    "RatioTeacher",
    "RationalityPrior",
    "Sampler",
    "TargetTeacher",
    "Teacher",
    "expected_regret",
    "hit_and_run",
    "metropolis",
    "mutual_information",
    "random",
    "ratio_divergence",
    "volume_removal",
]
