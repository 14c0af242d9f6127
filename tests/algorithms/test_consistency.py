"""Consistency: who contradicts themselves, who answers by chance, and who against all others."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from moral_algorithms.answers import Answer, AskedQuery
from moral_algorithms.consistency import Agreement, measure_consistency
from moral_algorithms.preferences import BradleyTerry, Posterior, Preference, Query, RationalityPrior
from moral_algorithms.replay import Replay

EPISODES = (Replay(0, np.zeros((1, 1), np.uint8)), Replay(1, np.zeros((1, 1), np.uint8)))
Person = tuple[str, list[Answer], NDArray[np.float64]]


def make_posterior() -> Posterior:
    return Posterior(RationalityPrior(2), BradleyTerry(), num_samples=100, rng=np.random.default_rng(0))


def person(who: str, count: int, seed: int, contrary: bool = False, random: bool = False) -> Person:
    """Somebody to whom the first component is worth four times the second."""
    rng = np.random.default_rng(seed)
    pairs = rng.random((count, 2, 2))
    answers = []
    for number, pair in enumerate(pairs):
        first = bool((pair[0] - pair[1]) @ [0.8, 0.2] > 0) != contrary
        if random:
            first = bool(rng.random() < 0.5)
        asked = AskedQuery(number, number, 0, Query(pair, np.zeros((2, 1), np.int64)), EPISODES)
        answers.append(Answer(asked, Preference.FIRST if first else Preference.SECOND, who, seconds=2.0))
    return who, answers, pairs


def test_honest_answers_are_predicted_by_the_others_of_their_own_and_of_other_people() -> None:
    ada, bob = measure_consistency([person("ada", 24, 1), person("bob", 24, 2)], make_posterior)
    for one in (ada, bob):
        assert one.predicted.share is not None
        assert one.others.share is not None
        assert one.predicted.share > 0.8
        assert one.others.share > 0.85
        assert one.suspicion is None
        assert (one.answers, one.cannot_tell, one.median_seconds) == (24, 0, 2.0)
    assert (ada.predicted.count, ada.others.count) == (24, 24)


def test_malice_and_noise_are_told_apart() -> None:
    people = [
        *(person("honest", 20, seed) for seed in range(4)),
        person("contrary", 20, 8, contrary=True),
        person("random", 20, 9, random=True),
    ]
    suspicions = [one.suspicion for one in measure_consistency(people, make_posterior)]
    assert suspicions == [None, None, None, None, "malice", "noise"]


def test_alone_a_random_person_is_suspected_of_noise() -> None:
    (one,) = measure_consistency([person("random", 60, 9, random=True)], make_posterior)
    assert one.others.count == 0
    assert one.suspicion == "noise"


def test_repeated_queries_agree_when_the_sides_are_swapped() -> None:
    who, answers, pairs = person("ada", 6, 3)
    said = {True: Preference.FIRST, False: Preference.SECOND}
    for original, alike in ((0, True), (1, True), (2, False)):
        was_first = answers[original].preference is Preference.FIRST
        swapped = pairs[original][::-1]
        query = Query(swapped, np.zeros((2, 1), np.int64))
        asked = AskedQuery(len(answers), 5, 0, query, EPISODES, repeats=original)
        answers.append(Answer(asked, said[was_first != alike], who))
        pairs = np.concatenate([pairs, swapped[None]])
    (one,) = measure_consistency([(who, answers, pairs)], make_posterior)
    assert one.repeated.count == 3
    assert one.repeated.share == pytest.approx(2 / 3)


def test_cannot_tell_and_equal_predict_nothing() -> None:
    who, answers, pairs = person("ada", 4, 4)
    answers[1] = Answer(answers[1].asked, None, who)
    answers[2] = Answer(answers[2].asked, Preference.EQUAL, who)
    (one,) = measure_consistency([(who, answers, pairs)], make_posterior)
    assert (one.answers, one.cannot_tell, one.predicted.count) == (3, 1, 2)


def test_without_answers_nothing_is_claimed() -> None:
    (one,) = measure_consistency([("nobody", [], np.empty((0, 2, 2)))], make_posterior)
    assert one.predicted == Agreement(0, None, None, None)
    assert one.suspicion is None
