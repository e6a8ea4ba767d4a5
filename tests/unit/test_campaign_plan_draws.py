"""Draws of a campaign's axes: each has the distribution that it says, wherever it is drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bus.settings import INVALID, Reading
from tools.campaign import draws
from tools.campaign.axes import Axes, DrawnAxis
from tools.campaign.samples import make_generator, make_samples

COUNT = 4000
LEAST_P = 1e-3  # a draw with a fixed seed either has it or not: no test here is flaky


def read(**axis: Any) -> DrawnAxis:
    """An axis as a file has it."""
    found = read_all(x=axis)
    assert found is not INVALID
    axis_read = found.by_name["x"]
    assert isinstance(axis_read, DrawnAxis)
    return axis_read


def read_all(**axes: Any) -> Any:
    """Axes as a file has them."""
    reading = Reading(Axes, axes)
    assert not reading.problems, reading.problems
    return reading.value


def draw(axis: DrawnAxis, count: int = COUNT, sampling: Any = "random") -> list[Any]:
    """Values of an axis."""
    columns = [f"x.{index}" for index in range(axis.width)]
    return [axis.draw([float(u) for u in row]) for row in make_samples(sampling, 1, columns, count)]


@pytest.mark.parametrize(
    ("axis", "cdf"),
    [
        ({"uniform": [-2, 3]}, stats.uniform(-2, 5).cdf),
        ({"normal": {"mean": 2, "sigma": 0.5}}, stats.norm(2, 0.5).cdf),
        ({"log_uniform": [1e-6, 1e-2]}, stats.loguniform(1e-6, 1e-2).cdf),
        (
            {"truncated_normal": {"mean": 1, "sigma": 2, "lower": 0, "upper": 5}},
            stats.truncnorm(-0.5, 2.0, 1, 2).cdf,
        ),
        ({"poisson": {"rate_per_s": 0.05, "from_s": 10, "until_s": 50}}, stats.truncexpon(2.0, 10, 20).cdf),
    ],
)
def test_distributions(axis: dict[str, Any], cdf: Callable[[Any], Any]) -> None:
    """Each continuous distribution is the one that scipy has under its name (Kolmogorov & Smirnov)."""
    values = draw(read(**axis))
    assert stats.kstest(values, cdf).pvalue > LEAST_P


def test_far_tail_of_a_truncated_normal() -> None:
    """Where both ends lie 8 sigma out, values stay between them and have the exact mean of the tail."""
    values = draw(read(truncated_normal={"mean": 0, "sigma": 1, "lower": 8, "upper": 9}))
    assert min(values) >= 8.0
    assert max(values) <= 9.0
    exact, spread = stats.truncnorm.stats(8, 9, moments="mv")
    assert np.mean(values) == pytest.approx(float(exact), abs=4 * math.sqrt(float(spread) / COUNT))


def test_categories() -> None:
    """Each category comes as often as its weight says (chi-square), and never with a weight of 0."""
    values = draw(read(categorical={"a": 5, "b": 3, "c": 2, "never": 0}))
    counts = [values.count(word) for word in ("a", "b", "c")]
    assert sum(counts) == COUNT
    assert stats.chisquare(counts, [0.5 * COUNT, 0.3 * COUNT, 0.2 * COUNT]).pvalue > LEAST_P
    assert draws.choose(1.0 - 2.0**-53, [1.0, 0.0]) == 0


def test_whole_numbers() -> None:
    """Whole numbers from end to end, both there, are as likely as each other (chi-square)."""
    values = draw(read(integer=[3, 8]))
    assert stats.chisquare([values.count(number) for number in range(3, 9)]).pvalue > LEAST_P
    assert {type(value) for value in values} == {int}
    assert draws.draw_whole(1.0 - 2.0**-53, 0, 2**53 - 1) == 2**53 - 1


def test_attitudes_are_uniform_on_so3() -> None:
    """Moments of the rotation matrix' trace are 0, 1, 1 and 3 to the fourth power (Haar measure), the angle's CDF fits."""
    turns = np.array(draw(read(attitude={}), 20_000))
    assert np.allclose(np.linalg.norm(turns, axis=1), 1.0, atol=1e-12)
    trace = 4.0 * turns[:, 0] ** 2 - 1.0
    for power, exact in ((1, 0.0), (2, 1.0), (3, 1.0), (4, 3.0)):  # Catalan-like: integrals over SO(3)
        sample = trace**power
        assert np.mean(sample) == pytest.approx(exact, abs=4 * np.std(sample) / math.sqrt(sample.size))
    angle = 2.0 * np.arccos(np.clip(turns[:, 0], -1.0, 1.0))
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / math.pi).pvalue > LEAST_P
    # the image of any fixed vector is uniform on the sphere: each of its coordinates is uniform in [-1, 1]
    w, x, y, z = turns.T
    for coordinate in (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)):
        assert stats.kstest(coordinate, stats.uniform(-1, 2).cdf).pvalue > LEAST_P


def test_small_turns() -> None:
    """A turn within 30 deg never is more, and its angle has the density 1 - cos on that stretch."""
    turns = np.array(draw(read(attitude={"within_deg": 30})))
    angle = 2.0 * np.arccos(turns[:, 0])
    most = math.radians(30)
    assert np.max(angle) <= most + 1e-9
    assert stats.kstest(angle, lambda a: (a - np.sin(a)) / (most - math.sin(most))).pvalue > LEAST_P


def test_directions_are_uniform_on_the_sphere() -> None:
    """Every coordinate of a random direction is uniform (Archimedes), its length is as asked."""
    arrows = np.array(draw(read(direction={"length": 0.2})))
    assert np.allclose(np.linalg.norm(arrows, axis=1), 0.2, atol=1e-12)
    for index in range(3):
        assert stats.kstest(arrows[:, index], stats.uniform(-0.2, 0.4).cdf).pvalue > LEAST_P


def test_gaps_of_a_poisson_process_are_exponential() -> None:
    """Gaps of a train are exponential where none is cut off, and counts in a window are Poisson's."""
    shape = {"rate_per_s": 0.02, "from_s": 5, "until_s": 105}
    trains = draw(read(poisson_train=shape))
    counts = np.array([len(train) for train in trains])
    expected = stats.poisson(2.0).pmf(range(6)) * COUNT
    observed = [int(np.sum(counts == count)) for count in range(6)]
    assert stats.chisquare([*observed, COUNT - sum(observed)], [*expected, COUNT - sum(expected)]).pvalue > LEAST_P
    long = [draws.draw_train(row, 0.5, 0.0, 1e9) for row in make_samples("random", 3, [f"g{i}" for i in range(8)], 500)]
    gaps = np.diff(np.array(long), axis=1, prepend=0.0).ravel()
    assert stats.kstest(gaps, stats.expon(0, 2.0).cdf).pvalue > LEAST_P
    assert all(5.0 < t_s < 105.0 for train in trains for t_s in train)


@pytest.mark.parametrize("sampling", ["latin_hypercube", "sobol"])
def test_one_sample_in_every_stratum(sampling: Any) -> None:
    """64 samples of a Latin hypercube, and of Sobol's sequence, have one in each 64th of every column."""
    samples = make_samples(sampling, 5, ["a.0", "b.0", "c.0"], 64)
    for column in samples.T:
        assert sorted(np.floor(column * 64).astype(int)) == list(range(64))


def test_sobol_is_a_net() -> None:
    """Shifted or not, 64 of Sobol's points in two columns have one in each box of 8 by 8: a (0, 6, 2)-net."""
    samples = make_samples("sobol", 5, ["a.0", "b.0"], 64)
    boxes = {(int(a * 8), int(b * 8)) for a, b in samples}
    assert len(boxes) == 64
    assert not np.array_equal(samples, make_samples("sobol", 6, ["a.0", "b.0"], 64))


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube"])
def test_an_axis_more_leaves_the_others_as_they_are(sampling: Any) -> None:
    """Draws of an axis come from its own name: with another axis before it they are the same bits."""
    alone = make_samples(sampling, 9, ["b.0"], 32)[:, 0]
    assert np.array_equal(make_samples(sampling, 9, ["a.0", "b.0"], 32)[:, 1], alone)
    assert not np.array_equal(make_samples(sampling, 10, ["b.0"], 32)[:, 0], alone)


def test_columns_are_independent() -> None:
    """Columns of different names are not correlated (Pearson, Fisher's z within 4 sigma)."""
    samples = make_samples("random", 1, [f"c{index}.0" for index in range(6)], COUNT)
    correlations = np.corrcoef(samples.T)[np.triu_indices(6, 1)]
    assert np.max(np.abs(np.arctanh(correlations))) < 4.0 / math.sqrt(COUNT - 3)


def test_draws_are_the_same_on_any_machine() -> None:
    """The stream of a column is PCG64's, seeded with 128 bits of SHA-256: written out here once, it is never another."""
    import hashlib

    word = int.from_bytes(hashlib.sha256(b"hilsat campaign 1 axis onset_s.0").digest()[:16], "big")
    state = np.random.PCG64(np.random.SeedSequence(word))
    raw = state.random_raw(3)
    expected = (raw >> np.uint64(11)) * 2.0**-53  # as numpy documents its doubles
    assert np.array_equal(make_generator(1, "onset_s.0").random(3), expected)


def test_last_bits_do_not_matter() -> None:
    """A value that is off by a few units in the last place is the same value once it is rounded to 12 digits."""
    for value in (draws.draw_normal(0.3, 1.0, 2.0), draws.draw_log_uniform(0.7, 1e-6, 1.0), 1.0 / 3.0):
        near = [value, math.nextafter(value, math.inf), math.nextafter(math.nextafter(value, -math.inf), -math.inf)]
        assert len({draws.round_all(item) for item in near}) == 1
    assert draws.round_all([0.1 + 0.2, [2, -0.0]]) == [0.3, [2, 0.0]]
    assert math.copysign(1.0, draws.round_all(-0.0)) == 1.0


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        ({"uniform": [1]}, "list of two numbers"),
        ({"uniform": [1, float("nan")]}, "is not a finite number"),
        ({"uniform": [1, 10**400]}, "out of reach"),
        ({"log_uniform": [0, 1]}, "is not above 0"),
        ({"normal": {"sigma": 0}}, "out of range"),
        ({"truncated_normal": {"mean": 0, "sigma": 1, "lower": 40, "upper": 50}}, "40 sigma outside"),
        ({"integer": [1, 2.5]}, "whole numbers"),
        ({"categorical": {"a": 0}}, "no weight above 0"),
        ({"categorical": {"a": -1}}, "is not a weight"),
        ({"categorical": {"a": 1}, "cases": {"b": 1}}, "does not have the labels"),
        ({"poisson": {"rate_per_s": 1, "from_s": 5, "until_s": 5}}, "is not after from_s"),
        ({"poisson_train": {"rate_per_s": 1, "until_s": 50}}, "at most 4"),
        ({"unifrom": [1, 2]}, 'did you mean "uniform"'),
        ({"range": [0, 1]}, "needs step or count"),
        ({"range": [0, 1], "step": 1e-9}, "at most 10000"),
        ({"range": [1, 2], "step": 0.3}, "does not go from 1 to 2: the last value would be 1.9"),
        ({"range": [1, 2], "step": 5}, "the last value would be 1"),
        ({"range": [0, 1], "count": 5, "spacing": "log"}, "ends above 0"),
        ({"values": []}, "is empty"),
        ({"cases": []}, "a mapping is needed"),
        (5, "a list of values is needed"),
    ],
)
def test_what_an_axis_cannot_be(axis: Any, words: str) -> None:
    """An axis that cannot be drawn from is refused, in words that say what is wrong with it."""
    messages = [problem.message for problem in Reading(Axes, {"x": axis}).problems]
    assert any(words in message for message in messages), messages


def test_ranges() -> None:
    """A range has both ends, by step or by count; whole numbers stay whole, a decade has its powers of ten."""
    axes = read_all(
        a={"range": [0.1, 0.9], "step": 0.2}, b={"range": [1, 4], "step": 1}, c={"range": [0, 1], "count": 3},
        d={"range": [1e-3, 1], "count": 4, "spacing": "log"},
    ).by_name  # fmt: skip
    assert [value for _, value in axes["a"].list_items()] == [0.1, 0.3, 0.5, 0.7, 0.9]
    assert [(label, value) for label, value in axes["b"].list_items()] == [("1", 1), ("2", 2), ("3", 3), ("4", 4)]
    assert [value for _, value in axes["c"].list_items()] == [0.0, 0.5, 1.0]
    assert [value for _, value in axes["d"].list_items()] == [0.001, 0.01, 0.1, 1.0]
