"""Which pairs of episodes become candidates for a query."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from moral_algorithms.learners.asking import Episode, QueryChooser
from moral_algorithms.preferences import BradleyTerry, Posterior, RationalityPrior
from moral_algorithms.replay import Replay


def episodes(returns: ArrayLike) -> list[Episode]:
    nothing = Replay(0, np.zeros((1, 1), dtype=np.uint8))
    rows = np.asarray(returns, dtype=np.float32)
    return [Episode(row, np.zeros(1, dtype=np.int64), nothing) for row in rows]


def chooser(dim: int, candidates: int, centred: float, seed: int = 0) -> QueryChooser:
    rng = np.random.default_rng(1)
    posterior = Posterior(RationalityPrior(dim), BradleyTerry(), num_samples=10, rng=rng)
    return QueryChooser(posterior, "expected_regret", candidates, seed, centred)


def test_centred_pairs_lie_on_both_sides_of_the_mean() -> None:
    # Symmetric about the mean: (0, 4) and (1, 3), whose distance is not asked for.
    returns = [[0.0], [1.0], [2.0], [3.0], [4.0]]
    pairs, found = chooser(1, 1000, 0.1).draw(episodes(returns))
    assert {tuple(sorted(pair)) for pair in pairs.tolist()} == {(0, 4), (1, 3)}
    np.testing.assert_array_equal(found, np.array(returns)[pairs])


def test_the_scales_of_components_do_not_matter() -> None:
    returns = np.random.default_rng(2).normal(size=(30, 3)).astype(np.float32)
    plain, _ = chooser(3, 500, 0.1).draw(episodes(returns))
    scaled, _ = chooser(3, 500, 0.1).draw(episodes(returns * np.array([1, 64, 1 / 64], dtype=np.float32)))
    assert {tuple(pair) for pair in plain.tolist()} == {tuple(pair) for pair in scaled.tolist()}


@given(seed=st.integers(0, 1000), share=st.floats(0.01, 1.0), constant=st.booleans())
@settings(max_examples=50, deadline=None)
def test_those_kept_are_the_most_centred(seed: int, share: float, constant: bool) -> None:
    rng = np.random.default_rng(seed)
    returns = rng.normal(size=(12, 3)) @ rng.normal(size=(3, 3))
    if constant:
        # A component that tells no episode from another must not disturb the others.
        returns[:, 2] = 1.0
    returns = returns.astype(np.float32).astype(np.float64)
    everything, _ = chooser(3, 200, 1.0, seed).draw(episodes(returns))
    kept, _ = chooser(3, 200, share, seed).draw(episodes(returns))
    assert len(kept) == max(round(share * len(everything)), 1)
    varied = returns[:, :2] if constant else returns
    inverse = np.linalg.inv(np.cov(varied.T))
    offsets = varied[everything].mean(axis=1) - varied.mean(axis=0)
    distances = np.array([offset @ inverse @ offset for offset in offsets])
    order = {tuple(pair): distance for pair, distance in zip(everything.tolist(), distances, strict=True)}
    worst = max(order[tuple(pair)] for pair in kept.tolist())
    assert worst <= np.sort(distances)[len(kept) - 1] * (1 + 1e-4) + 1e-9


def test_equal_episodes_are_no_candidates_unless_all_are_equal() -> None:
    pairs, found = chooser(2, 500, 0.5).draw(episodes([[1, 0], [1, 0], [0, 1]]))
    assert (found[:, 0] != found[:, 1]).any(axis=1).all()
    assert len(pairs) > 0
    pairs, _ = chooser(2, 500, 0.5).draw(episodes([[1, 0], [1, 0]]))
    assert len(pairs) == 250


def test_of_a_curved_wish_centred_pairs_tell_the_slope() -> None:
    """A quadratic wish is answered about a pair symmetric about a point as by its tangent plane there."""
    returns = np.random.default_rng(4).normal(size=(256, 2)).astype(np.float32).astype(np.float64)
    mean, slope = returns.mean(axis=0), np.array([1.0, -0.5])

    def as_by_the_plane(centred: float) -> float:
        _, pairs = chooser(2, 4000, centred).draw(episodes(returns))
        away = pairs - mean
        wish = away @ slope - (away**2).sum(axis=-1)
        same = (wish[:, 0] > wish[:, 1]) == (away[:, 0] @ slope > away[:, 1] @ slope)
        return float(same.mean())

    # 0.68 and 1.00; a coin would be right half of the time.
    assert as_by_the_plane(1.0) < 0.75
    assert as_by_the_plane(0.02) > 0.95
