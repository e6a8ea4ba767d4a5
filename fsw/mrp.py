"""Modified Rodrigues parameters sigma = e tan(theta/4): kinematics, rotation, error, and which of the two sets to use.

Every attitude has two sets, sigma and its shadow -sigma/|sigma|^2: those of q and of -q. Guidance has already chosen the
sign of the error quaternion, with hysteresis, so q0 may be as low as -0.1 and |sigma|^2 as high as 1.1/0.9. Laws take the
set of that very quaternion (`find_mrp`) and do not choose again: two switches with two thresholds would disagree in between.
`ShadowSwitch` is for whoever has parameters that no guidance has looked at.

Source: Li & Liu 2011, eq (8) and its note on the shadow set; Schaub & Junkins, Analytical Mechanics of Space Systems, 2003,
sec 3.5. Written for the conventions of bus/attitude.py: v_i = R(q_ib) v_b.
"""

from __future__ import annotations

from typing import Final

from bus.attitude import shadow_mrp
from bus.linear import ZERO3
from bus.units import Mat3, Vec3, Vec4

LEAST_Q0: Final = -0.5  # below this the other set is taken, whoever chose: sigma grows beyond bounds at -1
LEAST_DENOMINATOR: Final = 1e-10  # of the error's quotient; it vanishes for a whole turn between the two
SWITCH_SQUARE: Final = 1.1  # |sigma|^2 from which on the shadow set is used: 2.7 deg past the half turn, each way


def find_mrp(q: Vec4) -> Vec3:
    """Return the parameters of the very quaternion, q_v/(1 + q0) [1]; |sigma| > 1 for q0 < 0, those of -q below -0.5."""
    q0, x, y, z = q
    scale = 1.0 / (1.0 + q0) if q0 >= LEAST_Q0 else -1.0 / (1.0 - q0)
    return (x * scale, y * scale, z * scale)


def find_kinematics(sigma: Vec3) -> Mat3:
    """Return G, shape (3, 3), with sigma' = G omega: ((1 - s.s) I + 2 [s x] + 2 s s^T)/4 (eq (8)), omega in body axes.

    G^T G = ((1 + s.s)/4)^2 I, and s^T G = (1 + s.s)/4 s^T.
    """
    x, y, z = sigma
    k = 0.25 * (1.0 - x * x - y * y - z * z)
    return (
        (k + 0.5 * x * x, 0.5 * (x * y - z), 0.5 * (x * z + y)),
        (0.5 * (x * y + z), k + 0.5 * y * y, 0.5 * (y * z - x)),
        (0.5 * (x * z - y), 0.5 * (y * z + x), k + 0.5 * z * z),
    )


def find_rotation(sigma: Vec3) -> Mat3:
    """Return R, shape (3, 3), from inertial to body axes: v_b = R v_i, I + (8 [s x]^2 - 4 (1 - s.s) [s x])/(1 + s.s)^2."""
    x, y, z = sigma
    square = x * x + y * y + z * z
    scale = 1.0 / (1.0 + square)
    a, b = 8.0 * scale * scale, 4.0 * (1.0 - square) * scale * scale
    return (
        (1.0 - a * (y * y + z * z), a * x * y + b * z, a * x * z - b * y),
        (a * x * y - b * z, 1.0 - a * (x * x + z * z), a * y * z + b * x),
        (a * x * z + b * y, a * y * z - b * x, 1.0 - a * (x * x + y * y)),
    )


def find_mrp_error(sigma: Vec3, sigma_d: Vec3) -> Vec3:
    """Return the parameters of the body relative to a target, |sigma_e| <= 1: R(sigma_e) = R(sigma) R(sigma_d)^T.

    The quotient ((1 - d.d) s - (1 - s.s) d + 2 s x d)/(1 + s.s d.d + 2 s.d), with the shadow of s where it has no value.
    """
    dx, dy, dz = sigma_d
    d = dx * dx + dy * dy + dz * dz
    denominator = _find_denominator(sigma, sigma_d, d)
    if denominator < LEAST_DENOMINATOR:
        sigma = shadow_mrp(sigma)
        denominator = _find_denominator(sigma, sigma_d, d)
    x, y, z = sigma
    k, l = (1.0 - d) / denominator, (1.0 - x * x - y * y - z * z) / denominator
    m = 2.0 / denominator
    return shorten(
        (
            k * x - l * dx + m * (y * dz - z * dy),
            k * y - l * dy + m * (z * dx - x * dz),
            k * z - l * dz + m * (x * dy - y * dx),
        )
    )


def _find_denominator(sigma: Vec3, sigma_d: Vec3, square_d: float) -> float:
    (x, y, z), (dx, dy, dz) = sigma, sigma_d
    return 1.0 + (x * x + y * y + z * z) * square_d + 2.0 * (x * dx + y * dy + z * dz)


def shorten(sigma: Vec3) -> Vec3:
    """Return the set of the short rotation, |sigma| <= 1: the shadow of what is longer."""
    x, y, z = sigma
    return shadow_mrp(sigma) if x * x + y * y + z * z > 1.0 else sigma


class ShadowSwitch:
    """Keeps to one set of parameters through the half turn, until its square exceeds a threshold.

    Without hysteresis, noise near the half turn changes the set at every sample, and a law's torque its sign.
    """

    __slots__ = ("_last", "_most")

    def __init__(self, most_square: float = SWITCH_SQUARE) -> None:
        """most_square : |sigma|^2 from which on the other set is used; 1: none kept beyond the half turn."""
        self._most = most_square
        self.reset()

    def reset(self) -> None:
        """Forget the side; the next set is that of the short rotation."""
        self._last = ZERO3

    def choose(self, sigma: Vec3) -> Vec3:
        """Return the given parameters or their shadow: what is on the side kept so far, within the threshold."""
        x, y, z = sigma
        square = x * x + y * y + z * z
        px, py, pz = self._last
        if square > self._most:
            other = True
        elif square * self._most < 1.0:  # the shadow would be beyond the threshold
            other = False
        else:
            along = x * px + y * py + z * pz
            other = square > 1.0 if along == 0.0 else along < 0.0
        self._last = chosen = shadow_mrp(sigma) if other else sigma
        return chosen
