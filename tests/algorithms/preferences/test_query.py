"""Queries and preferences."""

import json

import numpy as np
import pytest

from moral_algorithms.preferences import Preference, Query

RETURNS = np.array([[0.5, 1.0], [0.25, 0.0]])
OBJECTIVES = np.array([[3, 1, 0], [0, 2, 5]])


@pytest.mark.parametrize("preference", Preference)
def test_a_preference_survives_json(preference: Preference) -> None:
    text = json.dumps({"preference": preference})
    assert text == f'{{"preference": "{preference.value}"}}'
    assert Preference(json.loads(text)["preference"]) is preference


@pytest.mark.parametrize("value", ["skipped", None, 1])
def test_what_is_no_preference_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="it must be 'first', 'second' or 'equal'"):
        Preference(value)


def test_a_query_keeps_its_own_read_only_arrays() -> None:
    returns, objectives = RETURNS.copy(), OBJECTIVES.copy()
    query = Query(returns, objectives)
    returns[:] = 9.0
    objectives[:] = 9
    np.testing.assert_array_equal(query.returns, RETURNS)
    np.testing.assert_array_equal(query.objectives, OBJECTIVES)
    assert query.returns.dtype == np.float64
    assert query.objectives.dtype == np.int64
    with pytest.raises(ValueError, match="read-only"):
        query.returns[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        query.objectives[0, 0] = 1


@pytest.mark.parametrize(
    ("returns", "objectives", "message"),
    [
        (RETURNS[0], OBJECTIVES, r"returns has shape \(2,\)"),
        (np.zeros((3, 2)), OBJECTIVES, r"returns has shape \(3, 2\)"),
        (np.array([[np.nan, 0.0], [0.0, 0.0]]), OBJECTIVES, "every value must be finite"),
        (RETURNS, OBJECTIVES[:1], r"objectives has shape \(1, 3\)"),
        (RETURNS, OBJECTIVES.astype(float), "counters must be integers"),
    ],
)
def test_a_malformed_query_is_refused(returns: np.ndarray, objectives: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Query(returns, objectives)
