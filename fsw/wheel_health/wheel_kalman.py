"""Wheel faults by Kalman filters: named from telemetry alone, and what allocator, drive and modes are to do about them."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from bus.linear import ZERO3, ZERO4
from bus.units import Vec3, Vec4
from fsw.families import WheelHealthMonitor
from fsw.records import ALL_WHEELS, ONES4, Flags4, FourReadings, WheelHealth
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import WheelKalmanConfig
from fsw.wheel_health.wheel_watch import WheelWatch
from fsw.wheel_kinds import NONE, UNKNOWN

DITHER_OFF: Final = 0
DITHER_ON: Final = 1
NO_NULL_SPACE: Final = 2
PATIENCE_S: Final = 2.0  # a fault that cannot be told apart for this long asks for dither
LEAST_PART: Final = 0.1  # of the null space's largest torque: a wheel with less of it is not stirred by it


class WheelKalmanInternals(NamedTuple):
    """What the filters are sure of."""

    gain_sigma: Vec4
    dither_nm: Vec4


class WheelKalman(WheelHealthMonitor):
    """Three filters a wheel (driver, torque deficit, rotor) and what follows from them.

    Rederived from the DC-motor form of the paper, see docs/wheel-health.md. Differs from it: three small filters in place of
    one, the alarm by an estimated torque deficit, and a cause is named only once the data can tell.
    """

    def __init__(self, config: WheelKalmanConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: nominal time between calls of `step` [s]."""
        self._config = config
        self._geometry = vehicle.wheels
        self._fitted = vehicle.fitted
        a, b, c, d = (
            WheelWatch(config, motor, inertia, torque, period_s)
            for motor, inertia, torque in zip(
                vehicle.wheel_motors, vehicle.wheel_inertia_kgm2, vehicle.wheels.max_torque_nm, strict=True
            )
        )
        self._watches = (a, b, c, d)
        self._dt_s, self._lag = -1.0, 0.0
        self._acts = config.reaction != "report"
        self.reset()

    def reset(self) -> None:
        """Trust every wheel again."""
        for watch in self._watches:
            watch.reset()
        self._sent: Vec4 | None = None
        self._seen = ZERO4
        self._doubt_s = self._dither_s = 0.0
        self._dither, self._dither_rw_nm = DITHER_OFF, ZERO4

    @property
    def internals(self) -> WheelKalmanInternals:
        """Sigma of each torque gain, and the dither."""
        a, b, c, d = self._watches
        return WheelKalmanInternals((a.gain_sigma, b.gain_sigma, c.gain_sigma, d.gain_sigma), self._dither_rw_nm)

    def note_sent(self, tau_rw_sent_nm: Vec4) -> None:
        """The torques that the frames carried, for the next call of `step` [N m]."""
        self._sent = tau_rw_sent_nm

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Return what is thought of each wheel. The fault torque is needed only to say what of it the shares explain."""
        sent = tau_rw_cmd_nm if self._sent is None else self._sent
        self._sent = None
        p, q, r, s = self._watches
        has_p, has_q, has_r, has_s = self._fitted
        if has_p:
            p.step(dt_s, sent[0], wheels[0])
        if has_q:
            q.step(dt_s, sent[1], wheels[1])
        if has_r:
            r.step(dt_s, sent[2], wheels[2])
        if has_s:
            s.step(dt_s, sent[3], wheels[3])
        kind = (p.kind, q.kind, r.kind, s.kind)
        available, share = ALL_WHEELS, ONES4
        if self._acts:
            available = (p.in_use, q.in_use, r.in_use, s.in_use)
            share = (p.find_share(), q.find_share(), r.find_share(), s.find_share())
        explained = self._explain(dt_s, share, tau_rw_cmd_nm, tau_fault_hat_b_nm)
        self._stir(dt_s, available, tau_fault_hat_b_nm is not None)
        return WheelHealth(
            share,
            available,
            (kind[0] != NONE, kind[1] != NONE, kind[2] != NONE, kind[3] != NONE),
            explained,
            (p.driver_gain, q.driver_gain, r.driver_gain, s.driver_gain),
            (p.rotor.gain, q.rotor.gain, r.rotor.gain, s.rotor.gain),
            (p.rotor.friction_nm, q.rotor.friction_nm, r.rotor.friction_nm, s.rotor.friction_nm),
            (p.deficit.deficit_nm, q.deficit.deficit_nm, r.deficit.deficit_nm, s.deficit.deficit_nm),
            kind,
            (p.confidence, q.confidence, r.confidence, s.confidence),
            self._dither,
            self._dither_rw_nm,
        )

    def _explain(self, dt_s: float, share: Vec4, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None) -> Vec3:
        """The part of the observer's fault torque that the shares account for, seen through its lag [N m].

        None of it where there is no observer: one that never sees a torque says exactly zero.
        """
        if not self._acts:
            return ZERO3
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._lag = 1.0 - math.exp(-dt_s / self._config.observer_lag_s) if dt_s > 0.0 else 0.0
        lag = self._lag
        (a, b, c, d), (e, f, g, h) = self._seen, tau_rw_cmd_nm
        self._seen = a, b, c, d = (a + lag * (e - a), b + lag * (f - b), c + lag * (g - c), d + lag * (h - d))
        if share == ONES4 or tau_fault_hat_b_nm is None or tau_fault_hat_b_nm == ZERO3:
            return ZERO3
        e, f, g, h = share
        x, y, z = self._geometry.combine(((1.0 - e) * a, (1.0 - f) * b, (1.0 - g) * c, (1.0 - h) * d))
        return (-x, -y, -z)

    def _stir(self, dt_s: float, available: Flags4, pointing: bool) -> None:
        """Ask for dither while a fault cannot be told apart, for `dither_s` at most: then it has told what it can."""
        config = self._config
        if not config.dither:
            return
        doubtful: list[int] = [
            i for i, watch in enumerate(self._watches) if watch.in_use and watch.kind == UNKNOWN and not watch.sure
        ]
        if not doubtful or not pointing:
            self._doubt_s = self._dither_s = 0.0
            self._dither, self._dither_rw_nm = DITHER_OFF, ZERO4
            return
        self._doubt_s += dt_s
        if self._doubt_s < PATIENCE_S:
            return
        size = self._size_null(available, doubtful)
        if size == ZERO4:
            self._dither, self._dither_rw_nm = NO_NULL_SPACE, ZERO4
            return
        wave = math.sin(2.0 * math.pi * self._dither_s / config.dither_period_s)
        self._dither_s += dt_s
        if self._dither_s > config.dither_s + dt_s:
            self._dither, self._dither_rw_nm = DITHER_OFF, ZERO4
            return
        a, b, c, d = size
        self._dither, self._dither_rw_nm = DITHER_ON, (a * wave, b * wave, c * wave, d * wave)

    def _size_null(self, available: Flags4, doubtful: list[int]) -> Vec4:
        """The amplitude of each wheel, `dither_nm` for the first in doubt; zeros where no null space stirs it [N m]."""
        fitted = self._fitted
        in_use = (
            available[0] and fitted[0], available[1] and fitted[1], available[2] and fitted[2], available[3] and fitted[3],
        )  # fmt: skip
        null = self._geometry.find_null(in_use)
        part = abs(null[doubtful[0]])
        if part < LEAST_PART:
            return ZERO4
        size = self._config.dither_nm / part
        return (null[0] * size, null[1] * size, null[2] * size, null[3] * size)
