"""Fuzzy inference and its tables: against surfaces in exact arithmetic, all 49 rules, and what must hold anywhere."""

from __future__ import annotations

import itertools
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from fsw.controllers.fuzzy import FuzzyTables
from fsw.controllers.fuzzy_tables import Rules, find_rules

ROOT = Path(__file__).resolve().parents[2]
SURFACES = np.load(ROOT / "tests" / "data" / "wheel" / "fuzzy_surfaces.npz")
KEYS = {"canonical": ("KP", "KI", "KD"), "even": ("EKP", "EKI", "EKD")}
CENTRES = np.arange(-3, 4) / 3.0
TABLES = pytest.mark.parametrize("tables", list(KEYS))
INFERENCES = pytest.mark.parametrize("product", [False, True], ids=["min", "prod"])
universe = st.floats(-1.5, 1.5)


def make(tables: str, product: bool) -> FuzzyTables:
    return FuzzyTables(find_rules(tables), product)  # type: ignore[arg-type]


def fire_all(rules: Rules, product: bool, e: float, ec: float) -> float:
    """All 49 rules of a table, as a textbook has them."""
    one, other = (np.maximum(0.0, 1.0 - 3.0 * np.abs(np.clip(x, -1.0, 1.0) - CENTRES)) for x in (e, ec))
    mu = np.outer(one, other) if product else np.minimum.outer(one, other)
    return float((mu * np.array(rules) / 3.0).sum() / mu.sum())


@TABLES
def test_rule_tables_are_those_of_the_reference(tables: str) -> None:
    """Level by level, all three outputs."""
    for rules, key in zip(find_rules(tables), KEYS[tables], strict=True):  # type: ignore[arg-type]
        assert np.array_equal(np.array(rules), SURFACES[f"table_{key}"])


def test_even_tables_follow_their_formulas() -> None:
    """r = |e|, s = ec sgn(e), in levels: dKp = r - 1 + s, dKd = -s (+1 where r = 1), dKi large near zero; cut to -3 .. 3."""

    def cut(level: int) -> int:
        return max(-3, min(3, level))

    kp, ki, kd = find_rules("even")
    for e, ec in itertools.product(range(-3, 4), repeat=2):
        r, s = abs(e), ec * ((e > 0) - (e < 0))
        at = e + 3, ec + 3
        got = kp[at[0]][at[1]], ki[at[0]][at[1]], kd[at[0]][at[1]]
        if r == 0:
            assert got == (0, cut(2 - abs(ec)) if abs(ec) < 3 else -1, abs(ec))
        else:
            assert got == (cut(r - 1 + s), cut({1: 1, 2: -2, 3: -3}[r] - abs(s) // 2), cut(-s + (r == 1)))


@pytest.mark.parametrize("output", [0, 1, 2], ids=KEYS["canonical"])
def test_min_surface_is_the_exact_one(output: int) -> None:
    """Against rational arithmetic on a grid that goes past the universe on all sides, to 1e-12."""
    inference, grid = make("canonical", False), SURFACES["grid"]
    found = np.array([[inference.infer(float(e), float(ec))[output] for ec in grid] for e in grid])
    assert np.abs(found - SURFACES[f"{KEYS['canonical'][output]}_min"]).max() <= 1e-12
    assert np.abs(grid).max() > 1.0


@TABLES
def test_prod_surface_is_bilinear_interpolation(tables: str) -> None:
    """scipy's interpolation of the table is the oracle, to 1e-12, saturated points included; min differs from it."""
    rules = find_rules(tables)  # type: ignore[arg-type]
    inference, plain = make(tables, True), make(tables, False)
    points = np.random.default_rng(3).uniform(-1.3, 1.3, (2000, 2))
    found = np.array([inference.infer(*point) for point in points.tolist()])
    for output, table in enumerate(rules):
        oracle = RegularGridInterpolator((CENTRES, CENTRES), np.array(table) / 3.0)
        assert np.abs(found[:, output] - oracle(np.clip(points, -1.0, 1.0))).max() <= 1e-12
    least = np.array([plain.infer(*point) for point in points.tolist()])
    assert 0.04 < np.abs(found - least).max() < 0.13


@TABLES
@INFERENCES
@given(e=universe, ec=universe)
def test_four_rules_are_all_forty_nine(tables: str, product: bool, e: float, ec: float) -> None:
    """The cell around a point gives what all rules give, and never more than 1."""
    found = make(tables, product).infer(e, ec)
    expected = [fire_all(rules, product, e, ec) for rules in find_rules(tables)]  # type: ignore[arg-type]
    assert found == pytest.approx(expected, abs=1e-13)
    assert max(map(abs, found)) <= 1.0 + 1e-15


@INFERENCES
@given(e=universe, ec=universe)
def test_even_tables_do_not_know_left_from_right(product: bool, e: float, ec: float) -> None:
    """F(-e, -ec) = F(e, ec) for all three outputs."""
    inference = make("even", product)
    assert inference.infer(-e, -ec) == pytest.approx(inference.infer(e, ec), abs=1e-14)


@TABLES
@INFERENCES
@given(e=universe, ec=universe, de=st.floats(-1e-6, 1e-6), dec=st.floats(-1e-6, 1e-6))
def test_surfaces_have_no_steps(tables: str, product: bool, e: float, ec: float, de: float, dec: float) -> None:
    """A small change of the inputs is a small change of the outputs, across cell borders and the end of the universe."""
    inference = make(tables, product)
    change = np.subtract(inference.infer(e + de, ec + dec), inference.infer(e, ec))
    # Neighbouring levels differ by up to 4/3 within 1/3, and both inputs count; twice that for the quotient of "min".
    assert np.abs(change).max() <= 2.0 * 12.0 * (abs(de) + abs(dec)) + 1e-12


def test_canonical_tables_are_nearly_odd() -> None:
    """41 of 49 cells of dKp and 47 of dKi are odd under (e, ec) -> (-e, -ec): a loop that flies left and right unlike."""
    kp, ki, kd = (np.array(rules) for rules in find_rules("canonical"))
    assert [int(np.sum(table == -table[::-1, ::-1])) for table in (kp, ki)] == [41, 47]
    assert not np.array_equal(kd, kd[::-1, ::-1])


@pytest.mark.parametrize("e", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_no_exception(e: float) -> None:
    """Out of a cycle comes no exception: such an input is an end of the universe."""
    inference = make("canonical", False)
    end = 1.0 if e > 0.0 else -1.0
    assert inference.infer(e, 0.3) == inference.infer(end, 0.3)


def test_inference_is_cheap() -> None:
    """Three outputs for three axes in at most 20 us, median, plain Python; a fuzzy library takes 225 ms."""
    inference, samples = make("canonical", False), []
    for k in range(2000):
        e = -1.0 + 0.001 * k
        start = time.perf_counter()
        inference.infer(e, 0.3)
        inference.infer(0.2, e)
        inference.infer(-e, e)
        samples.append(time.perf_counter() - start)
    assert statistics.median(samples) < 20e-6


def test_flight_software_imports_no_fuzzy_library_and_no_scipy() -> None:
    """All of fsw.config and fsw.flight in a fresh interpreter, every algorithm with it."""
    words = (
        "import sys, fsw.flight, fsw.config; print([m for m in ('skfuzzy', 'scipy', 'networkx') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-P", "-c", words], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
