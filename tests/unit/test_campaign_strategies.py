"""Strategies of campaigns, against runs whose answers have closed forms."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import scipy.stats

from bus.errors import ConfigError
from bus.settings import build
from tools.campaign.plan import Point, derive_seed
from tools.campaign.results import AxisInfo, Judged, RunResult
from tools.campaign.statistics import Tally
from tools.campaign.strategies import make_strategy
from tools.campaign.strategies.answers import normalise_margin
from tools.campaign.strategies.settings import (
    BoundarySettings,
    IndicesSettings,
    PlanSettings,
    StrategySettings,
    UntilSettings,
    WorstSettings,
)
from tools.campaign.strategies.until import is_known

Judge = Callable[[Point, random.Random], Any]


@dataclass
class Space:
    """A campaign as strategies see it: a list axis `law`, two drawn ones."""

    strategy: StrategySettings
    seed: int = 3
    name: str = "fake"
    laws: tuple[str, ...] = ("smc", "pid")
    repeats: int = 1
    metrics: dict[str, str] = field(default_factory=lambda: {"effort": "N m s"})

    @property
    def axes(self) -> tuple[AxisInfo, ...]:
        return (
            AxisInfo(name="law", kind="values", labels=self.laws),
            AxisInfo(name="x", kind="uniform", unit="deg"),
            AxisInfo(name="y", kind="uniform"),
        )

    def points(self) -> list[Point]:
        return [
            Point(values={"law": law, "x": 0.5, "y": 0.25}, labels={"law": law, "x": "0.5", "y": "0.25"}, repeat=i)
            for law in self.laws
            for i in range(self.repeats)
        ]

    def sample(self, u: Sequence[float]) -> Point:
        x, y = (round(4.0 * value - 2.0, 9) for value in u)
        return Point(values={"x": x, "y": y}, labels={"x": f"{x:g}", "y": f"{y:g}"})


class Bench:
    """Flies points by a closed form; keeps what it was asked, and answers what it knows from what it kept."""

    def __init__(self, judge: Judge, known: Sequence[RunResult] = ()) -> None:
        self.judge, self.known = judge, list(known)
        self.batches: list[list[Point]] = []
        self.results: list[RunResult] = []
        self.flown = 0

    def __call__(self, points: Sequence[Point]) -> list[RunResult]:
        self.batches.append(list(points))
        found = [self._answer(len(self.results) + i, point) for i, point in enumerate(points)]
        self.results += found
        return found

    def _answer(self, number: int, point: Point) -> RunResult:
        if number < len(self.known):
            assert self.known[number].values == point.values, "a resumed search asked something else"
            return self.known[number]
        self.flown += 1
        seed = derive_seed(1, number)
        margin = self.judge(point, random.Random(seed))
        outcome = "infra" if margin is None else "pass" if margin >= 0.0 else "fail"
        verdicts = () if margin is None else (_verdict(margin),)
        return RunResult(
            number=number, values=point.values, labels=point.labels, repeat=point.repeat, base="b", overrides=(),
            seed=seed, outcome=outcome, verdicts=verdicts, metrics={"effort": margin and -margin},
        )  # fmt: skip


def _verdict(margin: float) -> Judged:
    outcome = "pass" if margin >= 0.0 else "fail"
    return Judged(name="points", id="R-1", outcome=outcome, value=1.0 - margin, margin=margin, bound="at most 1")


def fly(settings: StrategySettings, judge: Judge, **space: Any) -> tuple[Any, Bench]:
    bench = Bench(judge)
    return make_strategy(Space(settings, **space)).run(bench), bench


# -- plan and until ------------------------------------------------------------------------------------------------


def test_a_plan_is_flown_whole_and_at_once() -> None:
    """One batch with the points of the plan in its order."""
    found, bench = fly(PlanSettings(), lambda point, rng: 1.0, repeats=3)
    assert found == {}
    assert [len(batch) for batch in bench.batches] == [6]
    assert bench.batches[0] == Space(PlanSettings(), repeats=3).points()


def test_until_stops_as_soon_as_the_interval_of_scipy_is_narrow() -> None:
    """The exact interval of scipy reaches at most the half width at the last look, and further at the one before."""
    settings = UntilSettings(kind="until", half_width=0.05, batch=40, most=5000)
    found, bench = fly(settings, lambda point, rng: rng.random() - 0.2)
    passed = np.cumsum([result.outcome == "pass" for result in bench.results])
    widths = []
    for n in range(40, len(bench.results) + 1, 40):
        low, high = scipy.stats.binomtest(int(passed[n - 1]), n).proportion_ci(0.95, method="exact")
        share = passed[n - 1] / n
        widths.append(max(share - low, high - share))
    assert found["reached"]
    assert widths[-1] <= 0.05 < widths[-2]
    assert found["looks"] == len(widths) == len(bench.batches)
    assert found["rate"] == pytest.approx(0.8, abs=0.06)


def test_every_run_of_until_is_a_new_one_and_laws_share_them() -> None:
    """No place is flown twice with the same repeat; over any whole number of rounds both laws fly equally often."""
    settings = UntilSettings(kind="until", half_width=0.001, batch=60, most=600)
    found, bench = fly(settings, lambda point, rng: rng.random() - 0.5, repeats=3)
    assert not found["reached"]
    keys = [(result.labels["law"], result.repeat) for result in bench.results]
    assert len(set(keys)) == len(keys) == 600
    assert sum(law == "smc" for law, _ in keys) == 300


def test_infra_runs_make_no_rate() -> None:
    """A campaign in which nothing can be flown ends at its limit, with no rate and the widest interval."""
    found, bench = fly(UntilSettings(kind="until", half_width=0.1, most=100), lambda point, rng: None)
    assert (found["rate"], found["interval"], found["reached"], found["infra"]) == (None, [0.0, 1.0], False, 100)
    assert len(bench.results) == 100


def exact_coverage(settings: UntilSettings, p: float) -> tuple[float, float]:
    """Probability that the last interval holds p, and the mean number of runs: over all courses, no simulation."""
    alive = np.array([1.0])
    step = scipy.stats.binom.pmf(np.arange(settings.batch + 1), settings.batch, p)
    covered = runs = 0.0
    from tools.campaign.strategies.until import interval_of

    for n in range(settings.batch, settings.most + 1, settings.batch):
        alive = np.convolve(alive, step)
        for s in np.flatnonzero(alive > 1e-12):
            tally = Tally(int(s), n - int(s))
            if is_known(settings, tally) or n == settings.most:
                low, high = interval_of(settings, tally)
                covered += alive[s] * (low <= p <= high)
                runs += alive[s] * n
                alive[s] = 0.0
    return covered, runs


@pytest.mark.parametrize(("p", "least"), [(0.5, 0.94), (0.9, 0.94), (0.98, 0.94)])
def test_what_looking_often_costs(p: float, least: float) -> None:
    """The nominal 95 % of Clopper-Pearson, looked at after each batch of 50 until +-5 %: what is left, computed exactly."""
    settings = UntilSettings(kind="until", half_width=0.05, batch=50, most=1000)
    covered, _ = exact_coverage(settings, p)
    assert least <= covered < 1.0


@pytest.mark.parametrize("p", [0.5, 0.9])
def test_the_sequence_keeps_its_word(p: float) -> None:
    """The confidence sequence covers at least 95 % when it is stopped by what it says, and costs more runs."""
    settings = UntilSettings(kind="until", half_width=0.1, batch=25, most=1000, interval="confidence_sequence")
    covered, runs = exact_coverage(settings, p)
    assert covered >= 0.95
    assert runs > exact_coverage(replace(settings, interval="clopper_pearson"), p)[1]


# -- boundary ------------------------------------------------------------------------------------------------------


def boundary(**keys: Any) -> BoundarySettings:
    return BoundarySettings(**{"kind": "boundary", "axis": "x", "lower": 0.0, "upper": 8.0, "tolerance": 0.01, **keys})


def test_a_sharp_boundary_is_found_for_each_law() -> None:
    """Thresholds at e and pi are bracketed within the tolerance in log2(8 / 0.01) halvings of one batch each."""
    threshold = {"smc": math.e, "pid": math.pi}
    found, bench = fly(boundary(repeats=2), lambda point, rng: threshold[point.values["law"]] - point.values["x"])
    assert len(bench.batches) == 1 + math.ceil(math.log2(8.0 / 0.01))
    for item in found["boundaries"]:
        (change,) = item["changes"]
        assert change["lower"] <= threshold[item["labels"]["law"]] <= change["upper"]
        assert change["upper"] - change["lower"] <= 0.01
        assert (change["below"], change["above"]) == ("pass", "fail")


def test_a_noisy_boundary_is_found_within_its_noise() -> None:
    """Runs pass with the probability of a logistic curve; 31 repeats find its middle to within a tenth of its width."""

    def judge(point: Point, rng: random.Random) -> float:
        return 1.0 / (1.0 + math.exp((point.values["x"] - 5.0) / 0.5)) - rng.random()

    found, _ = fly(boundary(repeats=31, tolerance=0.05), judge, laws=("smc",))
    (change,) = found["boundaries"][0]["changes"][:1]
    assert 0.5 * (change["lower"] + change["upper"]) == pytest.approx(5.0, abs=0.5)


def test_the_interval_asks_for_more_repeats_only_where_it_must() -> None:
    """Far from the boundary the first repeats decide; at a coin's value it takes all that are allowed, and that is said."""

    def judge(point: Point, rng: random.Random) -> float:
        chance = 1.0 if point.values["x"] < 3.9 else 0.0 if point.values["x"] > 4.1 else 0.5
        return chance - rng.random()

    settings = boundary(decide="interval", repeats=8, most_repeats=24, tolerance=3.0)
    found, _ = fly(settings, judge, laws=("smc",))
    judged = {level["value"]: level["judged"] for level in found["boundaries"][0]["levels"]}
    assert judged[0.0] == judged[8.0] == 8
    assert judged[4.0] == 24 or next(lv for lv in found["boundaries"][0]["levels"] if lv["value"] == 4.0)["sure"]


@pytest.mark.parametrize(("margin", "word"), [(1.0, "pass"), (-1.0, "fail")])
def test_no_boundary_is_said(margin: float, word: str) -> None:
    """Where both ends answer alike nothing is halved and the words say which answer it was."""
    found, bench = fly(boundary(), lambda point, rng: margin)
    assert len(bench.batches) == 1
    assert all(item["changes"] == [] for item in found["boundaries"])
    assert f"no boundary inside: outcome is a {word} at every value" in found["summary"][0]


def test_an_answer_that_changes_twice_is_named() -> None:
    """Fails between 3 and 5 alone: with enough levels both changes are found and the words say NOT MONOTONIC."""
    found, _ = fly(boundary(levels=9, repeats=1), lambda point, rng: abs(point.values["x"] - 4.0) - 1.005)
    item = found["boundaries"][0]
    assert not item["monotonic"]
    edges = [0.5 * (change["lower"] + change["upper"]) for change in item["changes"]]
    assert edges == pytest.approx([2.995, 5.005], abs=0.01)
    assert "NOT MONOTONIC" in item["words"]


def test_what_cannot_be_judged_is_no_answer() -> None:
    """A value at which every run is infra is neither a pass nor a fail, and the search ends with these words."""
    found, _ = fly(boundary(), lambda point, rng: None if 1.0 < point.values["x"] < 7.0 else 4.0 - point.values["x"])
    assert "not to be judged at 4" in found["summary"][0]
    assert found["boundaries"][0]["changes"][0]["lower"] == 0.0


# -- worst ---------------------------------------------------------------------------------------------------------

SPHERE = WorstSettings(kind="worst", generations=30, population=16)


def sphere(point: Point, rng: random.Random) -> float:
    """Smallest at (0.7, -1.1)."""
    return (point.values["x"] - 0.7) ** 2 + (point.values["y"] + 1.1) ** 2 + 0.1


def test_the_worst_place_of_a_sphere_is_found() -> None:
    """The least margin of a paraboloid is at its closed-form place; each generation was one batch; no fail, no proof."""
    found, bench = fly(SPHERE, sphere)
    assert [len(batch) for batch in bench.batches] == [16] * 31
    values = found["worst"]["values"]
    assert (values["x"], values["y"]) == pytest.approx((0.7, -1.1), abs=0.02)
    assert found["trace"] == sorted(found["trace"], reverse=True)
    assert "no proof" in found["summary"][0]


def test_a_metric_is_searched_both_ways() -> None:
    """The largest effort is that of the smallest margin; the smallest lies in the corner furthest from it."""
    most, _ = fly(replace(SPHERE, metric="effort"), sphere)
    assert most["worst"]["value"] == pytest.approx(-0.1, abs=1e-3)
    least, _ = fly(replace(SPHERE, metric="effort", sense="smallest"), sphere)
    assert (least["worst"]["values"]["x"], least["worst"]["values"]["y"]) == pytest.approx((-2.0, 2.0), abs=0.05)


def test_the_same_answers_give_the_same_questions() -> None:
    """Two searches are equal; one that was stopped after 100 runs and resumed flies the rest and nothing else."""
    first, bench = fly(SPHERE, sphere)
    second, again = fly(SPHERE, sphere)
    assert bench.batches == again.batches
    resumed = Bench(sphere, bench.results[:100])
    assert make_strategy(Space(SPHERE)).run(resumed) == first == second
    assert resumed.flown == len(bench.results) - 100


def test_a_search_stops_at_the_first_fail() -> None:
    """With stop_at_fail the generation that holds a fail is the last."""
    settings = replace(SPHERE, stop_at_fail=True)
    found, bench = fly(settings, lambda point, rng: sphere(point, rng) - 0.3)
    fails = [any(result.outcome == "fail" for result in bench.results[i : i + 16]) for i in range(0, found["runs"], 16)]
    assert fails == [False] * (len(fails) - 1) + [True]
    assert found["worst"]["outcome"] == "fail"


def test_an_infra_run_is_never_the_worst() -> None:
    """A search in which half the space cannot be flown finds the worst of the other half."""
    found, _ = fly(SPHERE, lambda point, rng: None if point.values["x"] > 0.0 else sphere(point, rng))
    assert found["infra"] > 0
    assert found["worst"]["values"]["x"] == pytest.approx(0.0, abs=0.05)
    assert found["worst"]["outcome"] == "pass"


def test_margins_are_comparable() -> None:
    """A margin of its usual size is 0.5 in any unit; more margin is always more; a fail without a number is the worst."""
    scales = {"a": 50.0, "b": 5e-6}
    assert normalise_margin(Judged(name="a", outcome="pass", value=1.0, margin=50.0), scales) == 0.5
    assert normalise_margin(Judged(name="b", outcome="pass", value=1.0, margin=5e-6), scales) == 0.5
    rising = [
        normalise_margin(Judged(name="a", outcome="fail" if m < 0.0 else "pass", value=1.0 - m, margin=m), scales)
        for m in (-900.0, -10.0, -0.1, 0.0, 1e-9, 30.0, 800.0)
    ]
    assert rising == sorted(set(rising))
    assert normalise_margin(Judged(name="a", outcome="fail", value=None, margin=None), scales) == -1.0 < rising[0]


# -- indices -------------------------------------------------------------------------------------------------------


def test_indices_of_a_product() -> None:
    """y = a x + b x y on [-2, 2]: V(a x) = a^2 4/3 alone for x, V(b x y) = b^2 16/9 shared; the closed forms are met."""
    settings = IndicesSettings(kind="indices", metric="effort", samples=1024)
    found, bench = fly(settings, lambda point, rng: point.values["x"] * (1.0 + 0.5 * point.values["y"]))
    alone, shared = 4.0 / 3.0, 0.25 * 16.0 / 9.0
    x, y = found["indices"]
    assert (x["axis"], y["axis"]) == ("x", "y")
    assert x["first_order"] == pytest.approx(alone / (alone + shared), abs=0.03)
    assert x["total_order"] == pytest.approx(1.0, abs=0.03)
    assert y["first_order"] == pytest.approx(0.0, abs=0.03)
    assert y["total_order"] == pytest.approx(shared / (alone + shared), abs=0.03)
    assert x["first_order_interval"][0] < alone / (alone + shared) < x["first_order_interval"][1]
    assert len(bench.results) == found["runs"] == 1024 * 4


def test_indices_say_what_they_could_not_see() -> None:
    """Runs without the number are counted in words that cannot be overlooked; where nothing varies there are none."""
    settings = IndicesSettings(kind="indices", requirement="R-1", samples=64)
    found, _ = fly(settings, lambda point, rng: None if point.values["x"] > 1.5 else point.values["x"])
    assert found["unknown"] > 0
    assert f"NOT TRUE OF ALL RUNS: {found['unknown']} of 256" in found["summary"][-1]
    same, _ = fly(settings, lambda point, rng: 1.0)
    assert "does not vary" in same["summary"][0]


# -- settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (boundary(axis="X1"), "no axis is called 'X1'"),
        (boundary(lower=9.0), "8 is not above lower, 9"),
        (boundary(tolerance=8.0), "not below upper - lower, 8"),
        (boundary(decide="interval", repeats=50), "40 is below repeats, 50"),
        (UntilSettings(kind="until", half_width=0.1, batch=20, most=10), "20 runs are more than `most`, 10"),
        (WorstSettings(kind="worst", metric="efort"), "no metric is called 'efort'; did you mean 'effort'?"),
        (WorstSettings(kind="worst", metric="effort", requirement="R-1"), "is given beside requirement"),
        (IndicesSettings(kind="indices", metric="effort", samples=100), "100 is no power of two; give 64 or 128"),
        (IndicesSettings(kind="indices"), "give one of requirement and metric"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings: StrategySettings, words: str) -> None:
    """Each is a ConfigError that names the key and what is wrong."""
    with pytest.raises(ConfigError, match="strategy") as caught:
        make_strategy(Space(settings))
    assert words in str(caught.value)


def test_a_requirement_that_nothing_is_judged_by_is_refused() -> None:
    """A misspelt requirement ends the campaign after its first batch with the near miss, not with a rate of 0."""
    with pytest.raises(ConfigError, match=r"no run was judged by a requirement 'R-2'.*did you mean R-1"):
        fly(UntilSettings(kind="until", half_width=0.1, pass_rate="R-2"), lambda point, rng: 1.0)


def test_settings_are_read_by_their_kind() -> None:
    """A mapping of a campaign file becomes the settings of its kind; half_width has no default."""

    @dataclass(frozen=True, slots=True, kw_only=True)
    class File:
        strategy: StrategySettings

    read = build(File, {"strategy": {"kind": "until", "half_width": 0.01}}, "f")
    assert read.strategy == UntilSettings(kind="until", half_width=0.01)
    with pytest.raises(ConfigError, match="half_width: is missing"):
        build(File, {"strategy": {"kind": "until"}}, "f")
