"""The paper's filter of a wheel: current and speed of a DC motor, and its exact discretisation."""

from __future__ import annotations

import math
from typing import Final

Mat2 = tuple[float, float, float, float]  # rows first
TERMS: Final = 12  # of the series, after which nothing is left at the norm below
SMALL: Final = 0.125
MOST_HALVINGS: Final = 60


def discretise(f: Mat2, dt_s: float) -> tuple[Mat2, Mat2]:
    """Return Phi = exp(F dt) and the integral of exp(F s) over 0 .. dt, of a 2 x 2 matrix F.

    By the series for a short part of dt, then doubling: S(2t) = S(t) + Phi(t) S(t), Phi(2t) = Phi(t)^2. Euler's I + F dt is
    no stand-in for it: at R/L = 100/s and 0.1 s it has the eigenvalue -9.
    """
    a, b, c, d = f
    norm = max(abs(a) + abs(b), abs(c) + abs(d)) * dt_s
    halvings = 0
    while norm > SMALL and halvings < MOST_HALVINGS:
        norm *= 0.5
        halvings += 1
    h = dt_s / 2.0**halvings
    term: Mat2 = (1.0, 0.0, 0.0, 1.0)
    phi, total = term, (h, 0.0, 0.0, h)
    for k in range(1, TERMS + 1):
        term = _scale(_times(term, f), h / k)
        phi = _add(phi, term)
        total = _add(total, _scale(term, h / (k + 1)))
    for _ in range(halvings):
        total = _add(total, _times(phi, total))
        phi = _times(phi, phi)
    return phi, total


def _times(m: Mat2, n: Mat2) -> Mat2:
    a, b, c, d = m
    e, f, g, h = n
    return (a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h)


def _add(m: Mat2, n: Mat2) -> Mat2:
    return (m[0] + n[0], m[1] + n[1], m[2] + n[2], m[3] + n[3])


def _scale(m: Mat2, k: float) -> Mat2:
    return (m[0] * k, m[1] * k, m[2] * k, m[3] * k)


class PaperFilter:
    """x = [i, w], dx/dt = F x + B U - [0, M_F0 tanh(w / 0.1) / J], both measured: the paper's (13)-(16), rederived.

    Differs from the paper: Phi and Gamma are the exact ones; dry friction is a known input, taken at the last estimate.
    """

    __slots__ = (
        "_dry_rad_s2", "_dt_s", "_f", "_input", "_noise", "_p", "_phi", "_total", "current_a", "deviation", "residual",
        "speed_rad_s",
    )  # fmt: skip

    def __init__(self, f: Mat2, input_gain: float, dry_rad_s2: float, noise_a: float, noise_rad_s: float) -> None:
        """input_gain : B[0], of the command [A/(V s)]; dry_rad_s2 : dry friction over inertia"""
        self._f = f
        self._input = input_gain
        self._dry_rad_s2 = dry_rad_s2
        self._noise = (noise_a * noise_a, noise_rad_s * noise_rad_s)
        self._dt_s = -1.0
        self._phi: Mat2 = (1.0, 0.0, 0.0, 1.0)
        self._total: Mat2 = (0.0, 0.0, 0.0, 0.0)
        self.restart(0.0, 0.0)

    def restart(self, current_a: float, speed_rad_s: float) -> None:
        """Start from measurements: x_0 = E x, P_0 their covariance (16)."""
        self.current_a, self.speed_rad_s = current_a, speed_rad_s
        self._p = (self._noise[0], 0.0, self._noise[1])
        self.residual = (0.0, 0.0)  # innovations of current and speed [A], [rad/s]
        self.deviation = (1.0, 1.0)  # their standard deviations

    def step(self, dt_s: float, command: float, current_a: float, speed_rad_s: float, heard: bool) -> None:
        """Advance over dt_s (15); without measurements it predicts."""
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._phi, self._total = discretise(self._f, dt_s)
        a, b, c, d = self._phi
        e, f, g, h = self._total
        i, w = self.current_a, self.speed_rad_s
        push, brake = self._input * command, self._dry_rad_s2 * math.tanh(w / 0.1)
        i, w = a * i + b * w + e * push - f * brake, c * i + d * w + g * push - h * brake
        p, q, r = self._p
        aq, cq = a * p + b * q, c * p + d * q
        ar, cr = a * q + b * r, c * q + d * r
        p, q, r = a * aq + b * ar + 4e-6 * dt_s, c * aq + d * ar, c * cq + d * cr + 4.5e-5 * dt_s
        if heard:
            s, t = p + self._noise[0], r + self._noise[1]
            det = s * t - q * q
            y, z = current_a - i, speed_rad_s - w
            k11, k12 = (p * t - q * q) / det, (q * s - p * q) / det
            k21, k22 = (q * t - r * q) / det, (r * s - q * q) / det
            i, w = i + k11 * y + k12 * z, w + k21 * y + k22 * z
            p, q, r = p - k11 * p - k12 * q, q - k11 * q - k12 * r, r - k21 * q - k22 * r
            self.residual, self.deviation = (y, z), (math.sqrt(s), math.sqrt(t))
        self.current_a, self.speed_rad_s, self._p = i, w, (p, q, r)
