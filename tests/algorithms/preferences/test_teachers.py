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
    TargetTeacher,
    Teacher,
    ratio_divergence,
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


@given(st.permutations(range(3)), st.lists(st.integers(0, 20), min_size=3, max_size=3), st.integers(1, 5))
def test_the_same_counts_in_another_order_are_a_tie(order: list[int], counts: list[int], share: int) -> None:
    teacher = RatioTeacher({name: float(share) for name in DELIVERY[:3]}, DELIVERY)
    swapped = [counts[place] for place in order]
    assert teacher.prefer(query([*counts, 0], [*swapped, 2])) is Preference.EQUAL


def test_divergence_by_hand() -> None:
    objectives = np.array([[3, 1, 1], [5, 5, 0], [0, 0, 0], [0, 0, 7]])
    half = 0.5 * np.log(0.5 / 0.6) + 0.5 * np.log(0.5 / 0.2)
    for scale in (1.0, 0.2):
        divergences = ratio_divergence(objectives, scale * np.array([3.0, 1.0, 1.0]))
        np.testing.assert_allclose(divergences, [0.0, half, np.inf, np.log(5)], atol=1e-15)
        assert (divergences >= 0.0).all()


def test_each_row_may_have_its_own_ratio() -> None:
    objectives = np.array([[2.0, 1.0], [2.0, 1.0]])
    divergences = ratio_divergence(objectives, np.array([[2.0, 1.0], [1.0, 2.0]]))
    np.testing.assert_allclose(divergences, [0.0, np.log(2) / 3], atol=1e-15)
    assert ratio_divergence(objectives[0], np.array([2.0, 1.0])).shape == ()


@pytest.mark.parametrize(
    ("first", "second", "preference"),
    [
        # Squared distances from (8, 3, -, 0) on each side: 0 and 1, 4 and 5, 2 and 4, 5 and 5, 0 and 0.
        ([8, 3, 0, 0], [8, 3, 0, 1], Preference.FIRST),
        ([9, 5, 0, 0], [8, 1, 0, 0], Preference.SECOND),
        ([7, 4, 0, 0], [10, 3, 0, 0], Preference.FIRST),
        ([6, 2, 0, 0], [9, 3, 9, 2], Preference.EQUAL),
        ([8, 3, 12, 0], [8, 3, 0, 0], Preference.EQUAL),
    ],
)
def test_target_is_equation_5_13(first: list[int], second: list[int], preference: Preference) -> None:
    teacher = TargetTeacher({"delivered": 8, "helped": 3, "vases_broken": 0}, DELIVERY)
    assert teacher.prefer(query(first, second)) is preference


@given(
    st.lists(st.integers(0, 12), min_size=8, max_size=8),
    st.lists(st.integers(0, 48), min_size=4, max_size=4),
)
def test_target_agrees_with_the_formula(counters: list[int], quarters: list[int]) -> None:
    # In quarters, so that the formula is exact, ties included.
    first, second = (
        sum((4 * counter - wanted) ** 2 for counter, wanted in zip(j, quarters, strict=True))
        for j in (counters[:4], counters[4:])
    )
    teacher = TargetTeacher({name: q / 4 for name, q in zip(DELIVERY, quarters, strict=True)}, DELIVERY)
    answer = teacher.prefer(query(counters[:4], counters[4:]))
    if first == second:
        assert answer is Preference.EQUAL
    else:
        assert answer is (Preference.FIRST if first < second else Preference.SECOND)


@given(st.permutations([0, 2, 3, 7]), st.floats(0.0, 12.0))
def test_the_same_differences_in_another_order_tie(counters: list[int], wanted: float) -> None:
    teacher = TargetTeacher(dict.fromkeys(DELIVERY, wanted), DELIVERY)
    assert teacher.prefer(query([0, 2, 3, 7], counters)) is Preference.EQUAL


@pytest.mark.parametrize(
    "teacher",
    [
        LexicographicTeacher(DELIVERY[:2], DELIVERY),
        RatioTeacher({"helped": 2, "cleaned": 1}, DELIVERY),
        TargetTeacher({"helped": 2.3, "cleaned": 1.1, "vases_broken": 0.1}, DELIVERY),
    ],
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
    with pytest.raises(ValueError, match=r"target names \['vases'\]; the objectives are"):
        TargetTeacher({"delivered": 3.0, "vases": 0.0}, DELIVERY)


@pytest.mark.parametrize("share", [0.0, -1.0, float("nan"), float("inf")])
def test_shares_must_be_positive(share: float) -> None:
    with pytest.raises(ValueError, match="every share must be positive and finite"):
        RatioTeacher({"helped": share, "cleaned": 1.0}, DELIVERY)


def test_an_empty_ratio_is_refused() -> None:
    with pytest.raises(ValueError, match=r"ratio is \{\}; "):
        RatioTeacher({}, DELIVERY)


@pytest.mark.parametrize("count", [-1.0, float("nan"), float("inf")])
def test_targets_must_be_counts(count: float) -> None:
    with pytest.raises(
        ValueError, match=r"target is \{'helped': .*\}; it must name counts, none negative or inf"
    ):
        TargetTeacher({"helped": count, "cleaned": 1.0}, DELIVERY)


def test_an_empty_target_is_refused() -> None:
    with pytest.raises(ValueError, match=r"target is \{\}; it must name counts"):
        TargetTeacher({}, DELIVERY)


@pytest.mark.parametrize("probability", [-0.1, 1.1, float("nan")])
def test_noise_must_be_a_probability(probability: float) -> None:
    inner = LexicographicTeacher(("people_saved",), EMERGENCY)
    with pytest.raises(ValueError, match=f"probability is {probability}; it must be between 0 and 1"):
        NoisyTeacher(inner, probability, np.random.default_rng(0))


@pytest.mark.parametrize(
    "teacher",
    [
        LexicographicTeacher(("people_saved",), EMERGENCY),
        RatioTeacher({"people_saved": 1}, EMERGENCY),
        TargetTeacher({"people_saved": 1}, EMERGENCY),
    ],
)
def test_counters_must_match_the_names(teacher: Teacher) -> None:
    with pytest.raises(ValueError, match=r"objectives has shape \(2, 3\); it must be \(2, 2\)"):
        teacher.prefer(query([0, 1, 2], [0, 0, 0]))
