"""Teachers."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moral_algorithms.preferences import (
    LexicographicTeacher,
    NoisyTeacher,
    Preference,
    Query,
    RatioTeacher,
    Teacher,
)

EMERGENCY = ("goal_time", "people_saved")
DELIVERY = ("delivered", "helped", "cleaned", "vases_broken")
SWAPPED = {
    Preference.FIRST: Preference.SECOND,
    Preference.SECOND: Preference.FIRST,
    Preference.EQUAL: Preference.EQUAL,
}


def query(first: list[int], second: list[int]) -> Query:
    return Query(np.zeros((2, 2)), np.array([first, second]))


@pytest.mark.parametrize(
    ("first", "second", "preference"),
    [
        ([0, 3], [75, 2], Preference.FIRST),
        ([75, 2], [0, 3], Preference.SECOND),
        ([10, 4], [9, 4], Preference.FIRST),
        ([9, 4], [10, 4], Preference.SECOND),
        ([9, 4], [9, 4], Preference.EQUAL),
    ],
)
def test_lexicographic_saves_people_first(
    first: list[int], second: list[int], preference: Preference
) -> None:
    teacher = LexicographicTeacher(("people_saved", "goal_time"), EMERGENCY)
    assert teacher.prefer(query(first, second)) is preference


def test_lexicographic_ignores_what_it_does_not_name() -> None:
    malicious = LexicographicTeacher(("vases_broken",), DELIVERY)
    assert malicious.prefer(query([0, 0, 0, 2], [9, 9, 9, 1])) is Preference.FIRST
    assert malicious.prefer(query([0, 0, 0, 1], [9, 9, 9, 1])) is Preference.EQUAL


@pytest.mark.parametrize(
    ("first", "second", "preference"),
    [
        ([6, 2, 2, 0], [3, 3, 3, 0], Preference.FIRST),
        ([6, 2, 2, 0], [3, 1, 1, 7], Preference.EQUAL),
        ([5, 5, 0, 0], [0, 5, 5, 0], Preference.FIRST),
        ([0, 0, 0, 0], [0, 9, 0, 0], Preference.SECOND),
        ([0, 0, 0, 0], [0, 0, 0, 3], Preference.EQUAL),
    ],
)
def test_ratio_is_equation_5_12(first: list[int], second: list[int], preference: Preference) -> None:
    teacher = RatioTeacher({"delivered": 3, "helped": 1, "cleaned": 1}, DELIVERY)
    assert teacher.prefer(query(first, second)) is preference


@given(st.lists(st.integers(1, 20), min_size=6, max_size=6))
def test_ratio_agrees_with_the_formula(counters: list[int]) -> None:
    first, second = np.array(counters[:3]), np.array(counters[3:])
    wanted = np.array([0.5, 0.2, 0.3])
    divergences = [float((j / j.sum() * np.log(j / j.sum() / wanted)).sum()) for j in (first, second)]
    teacher = RatioTeacher(dict(zip(DELIVERY[:3], wanted, strict=True)), DELIVERY)
    answer = teacher.prefer(query([*counters[:3], 0], [*counters[3:], 0]))
    if abs(divergences[0] - divergences[1]) > 1e-9:
        assert answer is (Preference.FIRST if divergences[0] < divergences[1] else Preference.SECOND)
    else:
        assert (answer is Preference.EQUAL) == bool((first * second.sum() == second * first.sum()).all()) or (
            sorted(first) == sorted(second)
        )


@pytest.mark.parametrize(
    "teacher",
    [LexicographicTeacher(DELIVERY[:2], DELIVERY), RatioTeacher({"helped": 2, "cleaned": 1}, DELIVERY)],
)
@given(st.lists(st.integers(0, 4), min_size=8, max_size=8))
def test_swapping_the_trajectories_swaps_the_answer(teacher: Teacher, counters: list[int]) -> None:
    answer = teacher.prefer(query(counters[:4], counters[4:]))
    assert answer is not None
    assert teacher.prefer(query(counters[4:], counters[:4])) is SWAPPED[answer]


@pytest.mark.parametrize(("probability", "wrong"), [(0.0, 0.0), (0.3, 0.15), (1.0, 0.5)])
def test_noise_turns_half_of_its_answers(probability: float, wrong: float) -> None:
    teacher = NoisyTeacher(
        LexicographicTeacher(("people_saved",), EMERGENCY), probability, np.random.default_rng(0)
    )
    answers = [teacher.prefer(query([0, 1], [0, 0])) for _ in range(4000)]
    assert set(answers) <= {Preference.FIRST, Preference.SECOND}
    assert answers.count(Preference.SECOND) / 4000 == pytest.approx(wrong, abs=0.025)


def test_noise_never_answers_equal_of_itself() -> None:
    teacher = NoisyTeacher(LexicographicTeacher(("people_saved",), EMERGENCY), 1.0, np.random.default_rng(1))
    assert Preference.EQUAL not in [teacher.prefer(query([0, 1], [0, 1])) for _ in range(200)]


def test_noisy_teachers_go_on_exactly_after_a_restore() -> None:
    def make(seed: int) -> NoisyTeacher:
        inner = NoisyTeacher(
            LexicographicTeacher(("people_saved",), EMERGENCY), 0.5, np.random.default_rng(seed)
        )
        return NoisyTeacher(inner, 0.3, np.random.default_rng(seed + 1))

    asked = query([0, 1], [0, 0])
    teacher = make(0)
    for _ in range(10):
        teacher.prefer(asked)
    state = json.loads(json.dumps(teacher.state_dict()))
    restored = make(7)
    restored.load_state_dict(state)
    assert [teacher.prefer(asked) for _ in range(100)] == [restored.prefer(asked) for _ in range(100)]


def test_a_teacher_without_state_has_an_empty_one() -> None:
    teacher = LexicographicTeacher(("people_saved",), EMERGENCY)
    assert teacher.state_dict() == {}
    teacher.load_state_dict({})
    with pytest.raises(
        ValueError, match=r"state has the keys \['rng'\]; it must be empty for a stateless teacher"
    ):
        teacher.load_state_dict({"rng": {}})


def test_a_skipped_query_passes_through_noise() -> None:
    class Absent(Teacher):
        def prefer(self, query: Query) -> None:
            return None

    assert NoisyTeacher(Absent(), 0.0, np.random.default_rng(0)).prefer(query([0, 1], [0, 0])) is None


@pytest.mark.parametrize("order", [(), ("people_saved", "people_saved")])
def test_an_order_must_name_objectives_once(order: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="it must name at least one objective, and none twice"):
        LexicographicTeacher(order, EMERGENCY)


def test_unknown_objectives_are_named() -> None:
    with pytest.raises(ValueError, match=r"order names \['helped'\]; the objectives are \['goal_time', "):
        LexicographicTeacher(("helped",), EMERGENCY)
    with pytest.raises(ValueError, match=r"ratio names \['vases'\]; the objectives are"):
        RatioTeacher({"vases": 1.0}, DELIVERY)


@pytest.mark.parametrize("share", [0.0, -1.0, float("nan"), float("inf")])
def test_shares_must_be_positive(share: float) -> None:
    with pytest.raises(ValueError, match="every share must be positive and finite"):
        RatioTeacher({"helped": share, "cleaned": 1.0}, DELIVERY)


def test_an_empty_ratio_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ratio is \{\}; "):
        RatioTeacher({}, DELIVERY)


@pytest.mark.parametrize("probability", [-0.1, 1.1, float("nan")])
def test_noise_must_be_a_probability(probability: float) -> None:
    inner = LexicographicTeacher(("people_saved",), EMERGENCY)
    with pytest.raises(ValueError, match=f"probability is {probability}; it must be between 0 and 1"):
        NoisyTeacher(inner, probability, np.random.default_rng(0))


def test_counters_must_match_the_names() -> None:
    teacher = LexicographicTeacher(("people_saved",), EMERGENCY)
    with pytest.raises(ValueError, match=r"objectives has shape \(2, 3\); it must be \(2, 2\)"):
        teacher.prefer(query([0, 1, 2], [0, 0, 0]))
