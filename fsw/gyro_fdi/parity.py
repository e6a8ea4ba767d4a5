"""Kinematic parity: how far the gyro turned against how far the stars turned, over windows of several lengths.

No dynamics in it, so no wheel fault, misalignment, inertia error or external torque can raise it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from bus.attitude import IDENTITY, conjugate, dcm_from_quaternion, log_map, multiply, normalise
from bus.linear import ZERO3
from bus.units import Mat3, Vec3, Vec4
from fsw.records import Flags3
from fsw.rotation import turn

_ZERO9 = (0.0,) * 9
Sum9 = tuple[float, ...]  # integral of R(q_g), row by row [s]


class Mark(NamedTuple):
    """Gyro integration as it stood at one instant."""

    tick: int
    q_g: Vec4  # gyro integrated from an arbitrary start
    lever: Sum9  # integral of R(q_g) dt [s]
    turned_rad: Vec3  # integral of |rate| per axis
    coast_rad: Vec3  # integral of the gyro-less rate per axis


class Frame(NamedTuple):
    """A star-tracker attitude with the gyro integration at the instant it was taken."""

    q_st: Vec4
    mark: Mark


class Healthy(NamedTuple):
    """What a gyro and a star tracker without fault may do."""

    arw_rad_sqrt_s: float
    bias_max_rad_s: float
    scale_max: float
    star_sigma_rad: Vec3


class ParityHit(NamedTuple):
    """An axis beyond its threshold."""

    axis: int
    statistic: float  # in standard deviations
    window_s: float


class Parity:
    """Compares gyro and star tracker at each star-tracker frame. `integrate` every tick, `test` every frame."""

    def __init__(
        self, healthy: Healthy, windows_s: Sequence[float], tick_s: float, sigma: float, suspect_sigma: float
    ) -> None:
        """windows_s: lengths in seconds; each becomes the nearest whole number of star-tracker frames, at least one."""
        self._healthy = healthy
        self._star_var: Vec3 = tuple(s * s for s in healthy.star_sigma_rad)  # type: ignore[assignment]
        self._windows_s = tuple(sorted(windows_s))
        self._tick_s = tick_s
        self._sigma, self._suspect_sigma = sigma, suspect_sigma
        self.reset()

    def reset(self) -> None:
        """Forget everything, the rate of frames included."""
        self._q: Vec4 = IDENTITY
        self._lever: Sum9 = _ZERO9
        self._turned, self._coast = ZERO3, ZERO3
        self._period = 0  # ticks between frames, the shortest seen
        self._last_tick = -1
        self._windows: tuple[int, ...] = ()
        self.flush()

    def flush(self, keep: Frame | None = None) -> None:
        """Forget all frames but one: after an alarm, windows that reach back before it would accuse the wrong axis.

        keep : a frame taken at this very tick; one taken earlier has some of the faulty rate between it and now
        """
        self._frames: dict[int, Frame] = {keep.mark.tick: keep} if keep is not None else {}
        self._exceeded: dict[tuple[int, int], float] = {}
        self.worst = 0.0

    def integrate(self, rate_b_rad_s: Vec3, coast_b_rad_s: Vec3, dt_s: float) -> None:
        """Turn by one tick.

        rate_b_rad_s  : rate under test (bias taken off), or on axes in alarm the gyro-less rate, body axes [rad/s]
        coast_b_rad_s : gyro-less rate, body axes [rad/s]
        """
        x, y, z = rate_b_rad_s
        self._q = q = normalise(turn(self._q, x * dt_s, y * dt_s, z * dt_s))
        (a, b, c), (d, e, f), (g, h, i) = dcm_from_quaternion(q)
        s = self._lever
        self._lever = (
            s[0] + a * dt_s, s[1] + b * dt_s, s[2] + c * dt_s,
            s[3] + d * dt_s, s[4] + e * dt_s, s[5] + f * dt_s,
            s[6] + g * dt_s, s[7] + h * dt_s, s[8] + i * dt_s,
        )  # fmt: skip
        wx, wy, wz = coast_b_rad_s
        t = self._turned
        self._turned = (t[0] + abs(wx) * dt_s, t[1] + abs(wy) * dt_s, t[2] + abs(wz) * dt_s)
        k = self._coast
        self._coast = (k[0] + wx * dt_s, k[1] + wy * dt_s, k[2] + wz * dt_s)

    def mark(self, tick: int) -> Mark:
        """Return the integration as it stands, labelled with a tick."""
        return Mark(tick, self._q, self._lever, self._turned, self._coast)

    def test(self, frame: Frame, suspect: Flags3, excluded: Flags3) -> list[ParityHit]:
        """Add a star-tracker frame; return the axes found faulty in the shortest window that finds any.

        An axis is faulty beyond `sigma` in two frames running of one window with one sign, or beyond `suspect_sigma`
        at once while suspect. Excluded axes (already in alarm) are not tested.
        """
        tick = frame.mark.tick
        self._learn_period(tick)
        frames = self._frames
        frames[tick] = frame
        oldest = tick - (self._windows[-1] if self._windows else 0)
        while frames and (first := next(iter(frames))) < oldest:
            del frames[first]
        self.worst = 0.0
        hits: list[ParityHit] = []
        for window in self._windows:
            start = frames.get(tick - window)
            if start is None:
                continue
            hits = self._judge(window, self._compare(start, frame), suspect, excluded)
            if hits:
                break
        return hits

    def _judge(self, window: int, statistics: Vec3, suspect: Flags3, excluded: Flags3) -> list[ParityHit]:
        hits = []
        for axis in (0, 1, 2):
            z, key = statistics[axis], (window, axis)
            size = abs(z)
            before = self._exceeded.get(key, 0.0)
            self._exceeded[key] = z if size > self._sigma else 0.0
            if excluded[axis]:
                continue
            if size > self.worst:
                self.worst = size
            if (size > self._sigma and before * z > 0.0) or (suspect[axis] and size > self._suspect_sigma):
                hits.append(ParityHit(axis, size, window * self._tick_s))
        return hits

    def _compare(self, start: Frame, end: Frame) -> Vec3:
        """Mean gyro error per axis over a window, in standard deviations, signed; zero within what is healthy."""
        healthy, s = self._healthy, self._star_var
        duration = (end.mark.tick - start.mark.tick) * self._tick_s
        star_turn = multiply(conjugate(start.q_st), end.q_st)
        gyro_turn = multiply(conjugate(start.mark.q_g), end.mark.q_g)
        phi = log_map(multiply(conjugate(star_turn), gyro_turn))
        fx, fy, fz = _solve(_lever_between(start.mark, end.mark), phi)
        (a, b, c), (d, e, f), (g, h, i) = dcm_from_quaternion(star_turn)
        walk = healthy.arw_rad_sqrt_s**2 * duration
        t0, t1 = start.mark.turned_rad, end.mark.turned_rad
        allowed = healthy.bias_max_rad_s * duration + healthy.scale_max * max(
            t1[0] - t0[0], t1[1] - t0[1], t1[2] - t0[2]
        )
        return (
            _score(fx * duration, allowed, s[0] + s[0] * a * a + s[1] * d * d + s[2] * g * g + walk),
            _score(fy * duration, allowed, s[1] + s[0] * b * b + s[1] * e * e + s[2] * h * h + walk),
            _score(fz * duration, allowed, s[2] + s[0] * c * c + s[1] * f * f + s[2] * i * i + walk),
        )

    def _learn_period(self, tick: int) -> None:
        """Take the shortest time between frames seen so far for the star tracker's period."""
        gap, self._last_tick = tick - self._last_tick, tick
        if self._last_tick < gap or gap < 1 or (self._period and gap >= self._period):
            return
        self._period = gap
        self._windows = tuple(sorted({max(1, round(w / (gap * self._tick_s))) * gap for w in self._windows_s}))
        self._exceeded.clear()


def interpolate(before: Mark, after: Mark, tick: int) -> Mark:
    """Return the integration at a tick between two marks."""
    if tick >= after.tick:
        return after
    if tick <= before.tick:
        return before
    k = (tick - before.tick) / (after.tick - before.tick)
    x, y, z = log_map(multiply(conjugate(before.q_g), after.q_g))
    lever = _mix(before.lever, after.lever, k)
    turned = _mix(before.turned_rad, after.turned_rad, k)
    coast = _mix(before.coast_rad, after.coast_rad, k)
    return Mark(tick, turn(before.q_g, k * x, k * y, k * z), lever, turned, coast)  # type: ignore[arg-type]


def _mix(before: tuple[float, ...], after: tuple[float, ...], k: float) -> tuple[float, ...]:
    return tuple([p + k * (q - p) for p, q in zip(before, after, strict=True)])


def _lever_between(start: Mark, end: Mark) -> Mat3:
    """G = R(q_g,end)' integral R(q_g) dt: constant rate error (body axes) to rotation error at the end [s]."""
    (a, b, c), (d, e, f), (g, h, i) = dcm_from_quaternion(end.q_g)
    p, q = start.lever, end.lever
    m00, m01, m02 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    m10, m11, m12 = q[3] - p[3], q[4] - p[4], q[5] - p[5]
    m20, m21, m22 = q[6] - p[6], q[7] - p[7], q[8] - p[8]
    return (
        (a * m00 + d * m10 + g * m20, a * m01 + d * m11 + g * m21, a * m02 + d * m12 + g * m22),
        (b * m00 + e * m10 + h * m20, b * m01 + e * m11 + h * m21, b * m02 + e * m12 + h * m22),
        (c * m00 + f * m10 + i * m20, c * m01 + f * m11 + i * m21, c * m02 + f * m12 + i * m22),
    )


def _solve(m: Mat3, v: Vec3) -> Vec3:
    """m^-1 v by cofactors; zeros where m is singular (turned through many revolutions within one window)."""
    (a, b, c), (d, e, f), (g, h, i) = m
    p, q, r = e * i - f * h, f * g - d * i, d * h - e * g
    det = a * p + b * q + c * r
    if abs(det) < 1e-12:
        return ZERO3
    x, y, z = v
    return (
        (p * x + (c * h - b * i) * y + (b * f - c * e) * z) / det,
        (q * x + (a * i - c * g) * y + (c * d - a * f) * z) / det,
        (r * x + (b * g - a * h) * y + (a * e - b * d) * z) / det,
    )


def _score(error_rad: float, allowed_rad: float, variance_rad2: float) -> float:
    over = abs(error_rad) - allowed_rad
    return math.copysign(over / math.sqrt(variance_rad2), error_rad) if over > 0.0 else 0.0
