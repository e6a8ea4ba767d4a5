"""Gains of the H-infinity observer banks: found by inertia, sampled exactly for the cycle, refused where unstable."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.errors import DesignError
from bus.linear import invert_symmetric
from bus.units import Mat3
from fsw.gyro_fdi.ts_model import OPERATING_RATE_RAD_S, VERTEX_SIGNS, make_a

GAINS_DIR = Path(__file__).resolve().parent
Array = NDArray[np.float64]
Row9 = tuple[float, float, float, float, float, float, float, float, float]
Row6 = tuple[float, float, float, float, float, float]


class Rule(NamedTuple):
    """One controller, sampled: x <- rows (x, r), v = output x."""

    rows: tuple[Row9, Row9, Row9, Row9, Row9, Row9]
    output: tuple[Row6, Row6, Row6]


def load_bank(inertia_kgm2: Mat3, bank: str, tick_s: float) -> tuple[Rule, ...]:
    """Return the nine rules of bank "a" (known premise) or "b" (unknown premise), sampled for tick_s [s].

    Raises DesignError if there is no design for this inertia, or if a sampled loop is not stable.
    """
    for path in sorted(GAINS_DIR.glob("gains_*.json")):
        document = json.loads(path.read_text())
        if np.allclose(document["inertia_kgm2"], inertia_kgm2, rtol=1e-9, atol=1e-9):
            return _sample_bank(inertia_kgm2, document["banks"][bank], tick_s, f"bank {bank} of {path.name}")
    raise DesignError(
        f"no H-infinity observer gains for inertia {inertia_kgm2} kg m^2 in {GAINS_DIR}; add it to INERTIAS in"
        " tools/design/ts_design.py and run `python -m tools.design.ts_design --write`, or use observer: static"
    )


def require_stable_static(gain_rad_s: float, tick_s: float) -> None:
    """Raise DesignError unless e <- (1 - l T) e, the error of a constant gain l held over T, decays."""
    if not 0.0 < gain_rad_s * tick_s < 2.0:
        raise DesignError(
            f"static observer: gain {gain_rad_s:g} rad/s sampled every {tick_s:g} s is not stable;"
            f" it must be above 0 and below 2/T = {2.0 / tick_s:g} rad/s"
        )


def exponentiate(a: Array) -> Array:
    """Return the matrix exponential by scaling, Taylor series and squaring; design time only."""
    squarings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(a, 1)), 1e-300))) + 4)
    small = a / 2.0**squarings
    total, term = np.eye(len(a)), np.eye(len(a))
    for order in range(1, 14):  # the norm is below 1/16: 16^-14/14! is beyond double precision
        term = term @ small / order
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return np.asarray(total)


def sample(a: Array, b: Array, tick_s: float) -> tuple[Array, Array]:
    """Return (Phi, Gamma) of x' = a x + b u, u held over tick_s [s]."""
    n, m = len(a), b.shape[1]
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a * tick_s, b * tick_s
    block = exponentiate(block)
    return block[:n, :n], block[:n, n:]


def _sample_bank(inertia_kgm2: Mat3, rules: list[dict[str, Any]], tick_s: float, what: str) -> tuple[Rule, ...]:
    j_inv, bank = invert_symmetric(inertia_kgm2), []
    for number, (rule, signs) in enumerate(zip(rules, VERTEX_SIGNS, strict=True)):
        x, y, z = (OPERATING_RATE_RAD_S * sign for sign in signs)
        a_i = np.array(make_a(inertia_kgm2, j_inv, (x, y, z)))
        a, b, c = (np.array(rule[key]) for key in "abc")
        phi, gamma = sample(a, b, tick_s)
        e_phi, e_gamma = sample(a_i, np.eye(3), tick_s)
        loop = np.block([[e_phi, -e_gamma @ c], [gamma, phi]])
        radius = float(np.max(np.abs(np.linalg.eigvals(loop))))
        if not radius < 1.0:
            raise DesignError(
                f"{what}: rule {number} sampled every {tick_s:g} s has spectral radius {radius:.9f}, it must be below"
                " 1; use a shorter cycle or another observer"
            )
        bank.append(Rule(_rows(np.hstack([phi, gamma])), _rows(c)))
    return tuple(bank)


def _rows(matrix: Array) -> Any:
    return tuple(tuple(float(v) for v in row) for row in matrix)
