"""Rates, intervals and tests: what can be said of a share that was seen in so many runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

CONFIDENCE: Final = 0.95
MOST_TABLES: Final = 2000  # runs of both sides: with more the least p-value is nothing
BISECTIONS: Final = 60  # halvings of an interval below 1: to the last bit

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Tally:
    """How many runs came to what. A pass is a pass; nothing else counts as one."""

    passed: int = 0
    failed: int = 0
    not_executed: int = 0
    infra: int = 0

    @property
    def judged(self) -> int:
        """Runs that were flown and were to be judged; what was not executed is among them, what is infra is not."""
        return self.passed + self.failed + self.not_executed

    @property
    def planned(self) -> int:
        """All runs, those that could not be flown too."""
        return self.judged + self.infra

    @property
    def rate(self) -> float | None:
        """Share of the judged runs that passed; None without any."""
        return self.passed / self.judged if self.judged else None

    @property
    def least_rate(self) -> float | None:
        """Share of all runs that passed, as if every infra run had failed; None without any."""
        return self.passed / self.planned if self.planned else None

    def interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Clopper-Pearson interval of `rate`; (0, 1) without a judged run."""
        return clopper_pearson(self.passed, self.judged, confidence)


def clopper_pearson(passed: int, judged: int, confidence: float = CONFIDENCE) -> Interval:
    """Exact interval of a share, by quantiles of the beta distribution (Clopper & Pearson 1934).

    Covers the true share with at least `confidence` when the number of runs was fixed beforehand. (0, 1) for none.
    """
    if judged == 0:
        return 0.0, 1.0
    from scipy.special import betaincinv  # scipy.stats is slow to import, and this is all that it would do

    tail = 0.5 * (1.0 - confidence)
    lower = 0.0 if passed == 0 else float(betaincinv(passed, judged - passed + 1, tail))
    upper = 1.0 if passed == judged else float(betaincinv(passed + 1, judged - passed, 1.0 - tail))
    return lower, upper


def confidence_sequence(passed: int, judged: int, confidence: float = CONFIDENCE) -> Interval:
    """Interval of a share that holds at every look at once, however often one looks and whenever one stops.

    The shares p that Robbins' mixture (1970) does not reject: B(s + 1, n - s + 1) < p^s (1 - p)^(n - s) / (1 - confidence),
    with a uniform mixture. By Ville's inequality the true share is within all of the intervals with at least `confidence`.
    """
    if judged == 0:
        return 0.0, 1.0
    failed = judged - passed
    seen = math.lgamma(passed + 1.0) + math.lgamma(failed + 1.0) - math.lgamma(judged + 2.0)
    least = seen + math.log(1.0 - confidence)
    share = passed / judged

    def holds(p: float) -> bool:
        likelihood = (passed * math.log(p) if passed else 0.0) + (failed * math.log1p(-p) if failed else 0.0)
        return likelihood > least

    lower = 0.0 if passed == 0 else _bisect(holds, 0.0, share)
    upper = 1.0 if failed == 0 else _bisect(holds, 1.0, share)
    return lower, upper


def _bisect(holds: Callable[[float], bool], outside: float, inside: float) -> float:
    for _ in range(BISECTIONS):
        middle = 0.5 * (outside + inside)
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return outside


def half_width(interval: Interval, share: float) -> float:
    """How far an interval reaches from the share that was seen, to the side where it reaches further."""
    return max(share - interval[0], interval[1] - share)


# -- tests ---------------------------------------------------------------------------------------------------------


def fisher_exact(a: Tally, b: Tally) -> float:
    """Two-sided p-value of Fisher's exact test: as unequal shares as these, or more, from one and the same share.

    1 where either side has no judged run. The sum of all tables with the same margins that are no more probable.
    """
    if not a.judged or not b.judged:
        return 1.0
    return _fisher(a.passed, a.judged, b.passed, b.judged)


def least_fisher(a: Tally, b: Tally) -> float:
    """The least p-value that Fisher's test can give for as many runs and as many passes in all; 0 for thousands of runs."""
    if not a.judged or not b.judged:
        return 1.0
    if a.judged + b.judged > MOST_TABLES:
        return 0.0 if 0 < a.passed + b.passed < a.judged + b.judged else 1.0
    total = a.passed + b.passed
    ends = {max(0, total - b.judged), min(a.judged, total)}
    return min(_fisher(k, a.judged, total - k, b.judged) for k in ends)


def _fisher(s: int, n: int, t: int, m: int) -> float:
    """The hypergeometric tables of s of n and t of m; as scipy.stats.fisher_exact, without its 100 us a call."""
    total = s + t
    first, last = max(0, total - m), min(n, total)

    def log_probability(k: int) -> float:
        return _log_choose(n, k) + _log_choose(m, total - k)

    whole = _log_choose(n + m, total)
    here = log_probability(s)
    limit = here + 1e-7  # equal tables differ by rounding
    return min(1.0, sum(math.exp(p - whole) for k in range(first, last + 1) if (p := log_probability(k)) <= limit))


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1.0) - math.lgamma(k + 1.0) - math.lgamma(n - k + 1.0)


def mcnemar_exact(lost: int, won: int) -> float:
    """Two-sided p-value of McNemar's exact test for runs that match one to one.

    lost : pairs that passed before and do not now; won: the other way round. Pairs with equal outcomes say nothing.
    """
    changed = lost + won
    if changed == 0:
        return 1.0
    fewer = min(lost, won)
    tail = sum(math.exp(_log_choose(changed, k) - changed * math.log(2.0)) for k in range(fewer + 1))
    return min(1.0, 2.0 * tail)


def least_mcnemar(changed: int) -> float:
    """The least p-value that McNemar's test can give when so many pairs changed."""
    return min(1.0, 2.0 ** (1 - min(changed, 1000)))


def select_possible(least: Sequence[float], alpha: float) -> list[int]:
    """Which tests are worth correcting for: those that could be significant at all (Tarone 1990).

    least : the least p-value that each could give, from the numbers of runs, passes or changes, which side is better unknown
    Returns their places: the k tests that can reach alpha / k, for the smallest such k.
    """
    for k in range(1, len(least) + 1):
        found = [i for i, p in enumerate(least) if p <= alpha / k]
        if len(found) <= k:
            return found
    return list(range(len(least)))


def adjust_holm(p_values: Sequence[float]) -> list[float]:
    """Adjusted p-values (Holm 1979): below alpha where a test is significant with at most alpha of any false alarm."""
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    adjusted = [1.0] * len(p_values)
    highest = 0.0
    for rank, i in enumerate(order):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = highest
    return adjusted


def difference_interval(a: Tally, b: Tally, confidence: float = CONFIDENCE) -> Interval | None:
    """Interval of the rate of `b` less that of `a`, by Newcombe's hybrid of two Wilson intervals (1998, method 10).

    None where either side has no judged run.
    """
    if not a.judged or not b.judged:
        return None
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * confidence))
    low_a, high_a = _wilson(a.passed, a.judged, z)
    low_b, high_b = _wilson(b.passed, b.judged, z)
    rate_a, rate_b = a.passed / a.judged, b.passed / b.judged
    difference = rate_b - rate_a
    return (
        difference - math.hypot(rate_b - low_b, high_a - rate_a),
        difference + math.hypot(high_b - rate_b, rate_a - low_a),
    )


def _wilson(passed: int, judged: int, z: float) -> Interval:
    share = passed / judged
    centre = (share + z * z / (2.0 * judged)) / (1.0 + z * z / judged)
    reach = z / (1.0 + z * z / judged) * math.sqrt(share * (1.0 - share) / judged + z * z / (4.0 * judged * judged))
    return max(0.0, centre - reach), min(1.0, centre + reach)
