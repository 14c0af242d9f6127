"""How consistent recorded answers are: with themselves, with others, and with what a posterior predicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest  # type: ignore[import-untyped]

from moral_algorithms.answers import Answer
from moral_algorithms.preferences import Posterior, Preference

MakePosterior = Callable[[], Posterior]
"""Makes a posterior without any answer, every time the same."""

_SWAPPED = {
    Preference.FIRST: Preference.SECOND,
    Preference.SECOND: Preference.FIRST,
    Preference.EQUAL: Preference.EQUAL,
}
_LEVEL = 0.95
# Shares of answers that are predicted: by chance, and at least where somebody tries to answer well.
_CHANCE, _HONEST = 0.5, 0.8


@dataclass(frozen=True)
class Agreement:
    """How often something that might agree with answers did."""

    count: int
    """How often it could."""
    share: float | None
    """How often it did, 0 to 1; None if it never could."""
    low: float | None
    """Lower end of the exact 95 % confidence interval of that share (Clopper and Pearson 1934)."""
    high: float | None
    """Upper end."""

    @classmethod
    def of(cls, agreed: Sequence[bool]) -> Agreement:
        """Count."""
        if not agreed:
            return cls(0, None, None, None)
        interval = binomtest(sum(agreed), len(agreed)).proportion_ci(_LEVEL, "exact")
        return cls(len(agreed), sum(agreed) / len(agreed), float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Consistency:
    """How consistent one person's answers are."""

    who: str
    """Whose."""
    answers: int
    """Answers that say something."""
    cannot_tell: int
    """Answers that do not."""
    median_seconds: float | None
    """Median response time; None where there is none."""
    repeated: Agreement
    """Repeated queries (sides swapped) that were answered as before."""
    predicted: Agreement
    """Strict answers that the posterior after all other answers of the person predicts (leave-one-out)."""
    others: Agreement
    """Strict answers that the posterior after all other people's answers predicts."""
    suspicion: str | None
    """malice, noise or None.

    malice if other people's answers predict this person's surely worse than chance; noise if they, or where
    there are none the person's own other answers, surely predict fewer than 80 % of them.
    """

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def measure_consistency(
    people: Sequence[tuple[str, Sequence[Answer], NDArray[np.float64]]], make_posterior: MakePosterior
) -> list[Consistency]:
    """Measure how consistent people are.

    Parameters
    ----------
    people
        For each their name, all of their answers that stand, n in number, and the vector returns of the pairs
        under one reward vector, shape (n, 2, d).
    make_posterior
        Makes the posterior that predicts.

    Returns
    -------
    list of Consistency
        One for each person.
    """
    measured = []
    for index, (who, answers, returns) in enumerate(people):
        strict = [row for row, answer in enumerate(answers) if _is_strict(answer)]
        own = make_posterior()
        for row, answer in enumerate(answers):
            if answer.preference is not None:
                own.add(returns[row], answer.preference)
        predicted = [_predicts(own, returns[row], answers[row], left_out=True) for row in strict]
        theirs = make_posterior()
        for other, (_, other_answers, other_returns) in enumerate(people):
            for row, answer in enumerate(other_answers if other != index else ()):
                if answer.preference is not None:
                    theirs.add(other_returns[row], answer.preference)
        rows = strict if theirs.num_queries else []
        others = Agreement.of([_predicts(theirs, returns[row], answers[row]) for row in rows])
        seconds = [answer.seconds for answer in answers if answer.seconds is not None]
        measured.append(
            Consistency(
                who=who,
                answers=sum(answer.preference is not None for answer in answers),
                cannot_tell=sum(answer.preference is None for answer in answers),
                median_seconds=float(np.median(seconds)) if seconds else None,
                repeated=Agreement.of(_repeats(answers)),
                predicted=Agreement.of(predicted if len(strict) > 1 else []),
                others=others,
                suspicion=_suspect(others, Agreement.of(predicted)),
            )
        )
    return measured


def _is_strict(answer: Answer) -> bool:
    return answer.preference in (Preference.FIRST, Preference.SECOND)


def _predicts(
    posterior: Posterior, pair: NDArray[np.float64], answer: Answer, left_out: bool = False
) -> bool:
    """Whether a posterior gives an answer the greater probability; if ``left_out``, without that answer.

    Its samples then count as the inverse of the answer's likelihood (Gelfand 1996).
    """
    difference = posterior.samples @ (pair[0] - pair[1])
    sign = 1.0 if answer.preference is Preference.FIRST else -1.0
    said = posterior.likelihood.log_probability(sign * difference)
    other = posterior.likelihood.log_probability(-sign * difference)
    weights = np.exp(said.min() - said) if left_out else np.ones_like(said)
    return bool(weights @ np.exp(said) > weights @ np.exp(other))


def _repeats(answers: Sequence[Answer]) -> list[bool]:
    """Whether each repeated query got the answer that it had before, sides swapped."""
    before = {answer.number: answer.preference for answer in answers}
    agreed = []
    for answer in answers:
        original = before.get(answer.asked.repeats) if answer.asked.repeats is not None else None
        if original is not None and answer.preference is not None:
            agreed.append(answer.preference is _SWAPPED[original])
    return agreed


def _suspect(others: Agreement, own: Agreement) -> str | None:
    if others.high is not None and others.high < _CHANCE:
        return "malice"
    judged = others if others.count else own
    return "noise" if judged.high is not None and judged.high < _HONEST else None
