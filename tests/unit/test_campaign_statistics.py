"""Intervals and tests of campaigns, against closed forms and scipy's own."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from tools.campaign.statistics import (
    Tally,
    adjust_holm,
    clopper_pearson,
    confidence_sequence,
    difference_interval,
    fisher_exact,
    least_fisher,
    least_mcnemar,
    mcnemar_exact,
    select_possible,
)


@given(n=st.integers(1, 5000), share=st.floats(0, 1), confidence=st.sampled_from([0.8, 0.95, 0.999]))
def test_clopper_pearson_is_that_of_scipy(n: int, share: float, confidence: float) -> None:
    """The interval equals the exact one of scipy.stats.binomtest for any count, ends included."""
    s = round(share * n)
    expected = scipy.stats.binomtest(s, n).proportion_ci(confidence, method="exact")
    assert clopper_pearson(s, n, confidence) == pytest.approx((expected.low, expected.high), abs=1e-9)


@pytest.mark.parametrize("n", [1, 10, 300])
def test_ends_have_their_closed_forms(n: int) -> None:
    """None of n and all of n give 1 - (alpha/2)^(1/n), the closed form; no runs give no knowledge."""
    reach = 1.0 - 0.025 ** (1.0 / n)
    assert clopper_pearson(0, n) == pytest.approx((0.0, reach), abs=1e-12)
    assert clopper_pearson(n, n) == pytest.approx((1.0 - reach, 1.0), abs=1e-12)
    assert clopper_pearson(0, 0) == (0.0, 1.0)


def test_what_is_no_pass_never_counts_as_one() -> None:
    """The rate is over judged runs, not executed ones among them; the least rate counts infra runs as failed."""
    tally = Tally(passed=6, failed=1, not_executed=3, infra=10)
    assert tally.rate == 0.6
    assert tally.least_rate == 0.3
    assert tally.interval() == clopper_pearson(6, 10)
    assert Tally(infra=4).rate is None


@given(a=st.tuples(st.integers(0, 60), st.integers(1, 60)), b=st.tuples(st.integers(0, 60), st.integers(1, 60)))
def test_fisher_is_that_of_scipy(a: tuple[int, int], b: tuple[int, int]) -> None:
    """The p-value equals that of scipy.stats.fisher_exact."""
    expected = scipy.stats.fisher_exact([list(a), list(b)]).pvalue
    assert fisher_exact(Tally(*a), Tally(*b)) == pytest.approx(expected, rel=1e-6, abs=1e-12)


@given(lost=st.integers(0, 200), won=st.integers(0, 200))
def test_mcnemar_is_a_sign_test(lost: int, won: int) -> None:
    """The p-value equals that of a fair coin's binomial test on the pairs that changed."""
    expected = scipy.stats.binomtest(lost, lost + won).pvalue if lost + won else 1.0
    assert mcnemar_exact(lost, won) == pytest.approx(expected, rel=1e-9)


def test_holm_by_hand() -> None:
    """Holm's worked example: 0.01, 0.04, 0.03, 0.005 of four tests become 0.03, 0.06, 0.06, 0.02."""
    assert adjust_holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert adjust_holm([]) == []


@given(n=st.integers(1, 25), m=st.integers(1, 25), share=st.floats(0, 1))
def test_least_fisher_is_the_least_of_all_tables(n: int, m: int, share: float) -> None:
    """Over every table of the same margins no p-value of scipy is smaller, and one is as small."""
    total = round(share * (n + m))
    tables = [(k, total - k) for k in range(max(0, total - m), min(n, total) + 1)]
    values = [scipy.stats.fisher_exact([[s, n - s], [t, m - t]]).pvalue for s, t in tables]
    s, t = tables[len(tables) // 2]
    assert least_fisher(Tally(s, n - s), Tally(t, m - t)) == pytest.approx(min(values), rel=1e-6)


def test_only_tests_that_can_alarm_are_corrected_for() -> None:
    """Tarone's rule by hand: of 1, 0.04, 0.02, 0.001 at 5 % two can reach 0.025; hopeless ones alone leave none."""
    assert select_possible([1.0, 0.04, 0.02, 0.001], 0.05) == [2, 3]
    assert select_possible([1.0, 1.0, 0.2], 0.05) == []
    assert select_possible([], 0.05) == []
    assert [least_mcnemar(n) for n in (0, 1, 6)] == [1.0, 1.0, pytest.approx(mcnemar_exact(6, 0))]


def test_difference_as_published() -> None:
    """56 of 70 and 48 of 80: Newcombe's published interval of the difference is 0.0524 to 0.3339."""
    low, high = difference_interval(Tally(48, 32), Tally(56, 14)) or (math.nan, math.nan)
    assert (low, high) == pytest.approx((0.0524, 0.3339), abs=5e-5)
    assert difference_interval(Tally(), Tally(1)) is None


def test_the_confidence_sequence_covers_at_every_look() -> None:
    """The true share is outside at any of 400 looks in no more than 5 % of 2000 simulated campaigns."""
    rng = np.random.default_rng(1)
    for p in (0.5, 0.9):
        bounds = [np.array([confidence_sequence(s, n) for s in range(n + 1)]) for n in range(10, 401, 10)]
        passed = rng.binomial(10, p, (2000, 40)).cumsum(axis=1)
        out = np.zeros(2000, bool)
        for look, table in enumerate(bounds):
            out |= (table[passed[:, look], 0] > p) | (table[passed[:, look], 1] < p)
        assert out.mean() < 0.05


def test_the_confidence_sequence_rejects_by_its_ratio() -> None:
    """At both ends of the interval the mixture's likelihood ratio is 1 / alpha, computed by scipy's beta function."""
    low, high = confidence_sequence(180, 200)
    for p in (low, high):
        ratio = math.exp(float(scipy.special.betaln(181, 21)) - 180 * math.log(p) - 20 * math.log1p(-p))
        assert ratio == pytest.approx(20.0, rel=1e-6)
