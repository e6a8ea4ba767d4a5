"""Torques in the null space of the wheels: what they do among themselves, without a torque on the body.

Between allocation and drive. With n0 the unit vector with D n0 = 0, wheel torques gamma n0 move the null momentum
eta = n0 . h and nothing else: d eta/dt = -gamma, as a torque on the body is taken out of the wheel. A wheel that gives a
share e of its command is told gamma n0 / e, so that this holds for the shares that the allocator reckoned with.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from bus.errors import ConfigError
from bus.linear import ZERO4
from bus.units import Vec4
from fsw.records import ALL_WHEELS, NO_WHEEL, Allocation, Sensors, WheelHealth
from fsw.settings import NullSpaceConfig
from fsw.square_wave import SquareWave, check_wave
from fsw.vehicle import Vehicle

USED_SPEED = 0.95  # share of its largest speed that a wheel is brought to at most to keep another from zero
LEAST_PART = 1e-6  # part of a wheel in the null space below which it cannot be moved by it
Gap = tuple[float, float]


class NullSpaceInternals(NamedTuple):
    """What the wheels do among themselves."""

    momentum_nms: float  # null momentum n0 . h
    target_nms: float  # where it is being brought; where it is while nothing brings it anywhere
    gamma_nm: float  # length of the null torque added, n0 . torque on the body
    acting: (
        float  # 0 no null space or momentum not known, 1 at the target, 2 on the way to it, 3 cut to the wheels' limits
    )


class NullSpace:
    """Brings the null momentum to a reference, keeps wheels from zero speed, dithers; each only where its setting says so.

    Momentum: gamma = k (eta - reference), so that eta decays as exp(-k t). Zero speed: a wheel with momentum p + n eta is
    slower than the least speed for eta in an interval about -p/n; the null momentum is kept in the gap between these
    intervals in which it is, or brought into the nearest. Dither: a square wave. All of it is cut to what the wheels have
    left beside the torques allocated.
    """

    def __init__(self, config: NullSpaceConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: control period [s].

        Raises ConfigError where the wheels have no null space, or the settings go beyond what they can do.
        """
        self.on = config.momentum_gain_1_s > 0.0 or config.avoid_speed_rad_s > 0.0 or config.dither_nm > 0.0
        self._config = config
        self._wheels = vehicle.wheels
        # Not _null: mypyc makes __null of it, which gcc takes for a word of its own
        self._n0 = _normalise(vehicle.wheels.find_null(vehicle.fitted)) if self.on else ZERO4
        self._wave = SquareWave(config.dither_period_s)
        self._swing_nm = 0.0
        if self.on:
            _check(config, vehicle, self._n0, period_s)
            self._swing_nm = config.dither_nm / max(abs(part) for part in self._n0)
        self._least_nms = [config.avoid_speed_rad_s * inertia for inertia in vehicle.wheel_inertia_kgm2]
        self._most_nms = [
            USED_SPEED * inertia * speed
            for inertia, speed in zip(vehicle.wheel_inertia_kgm2, vehicle.wheel_max_speed_rad_s, strict=True)
        ]
        self.reset()

    def reset(self) -> None:
        """At the start of the dither, with nothing done yet."""
        self._wave.reset()
        self.internals = NullSpaceInternals(0.0, 0.0, 0.0, 0.0)

    def step(self, dt_s: float, tau_rw_nm: Vec4, allocation: Allocation, health: WheelHealth, sensors: Sensors) -> Vec4:
        """Return the wheel torques with what the wheels are to do among themselves [N m], each within its limit.

        dt_s      : since the last call
        tau_rw_nm : wheel torques allocated [N m]
        """
        config, shares = self._config, allocation.shares
        if health.available != ALL_WHEELS or health.dead != NO_WHEEL or not min(shares) > 0.0:
            self.internals = NullSpaceInternals(0.0, 0.0, 0.0, 0.0)
            return tau_rw_nm
        eta = target = wanted = 0.0
        known = sensors.wheels_valid() == ALL_WHEELS
        if known:
            h_nms = sensors.wheel_momenta()
            eta = _multiply(self._n0, h_nms)
            target, gain = self._find_target(eta, h_nms)
            wanted = gain * (eta - target)
        if config.dither_nm > 0.0:
            wanted += self._wave.step(dt_s) * self._swing_nm
        a, b, c, d = self._n0
        p, q, r, s = shares
        way = (a / p, b / q, c / r, d / s)
        gamma = self._find_room(wanted, tau_rw_nm, way)
        acting = 3.0 if gamma != wanted else 2.0 if gamma != 0.0 else 1.0 if known else 0.0
        self.internals = NullSpaceInternals(eta, target, gamma, acting)
        if gamma == 0.0:
            return tau_rw_nm
        (a, b, c, d), (p, q, r, s) = tau_rw_nm, way
        return self._wheels.limit((a + gamma * p, b + gamma * q, c + gamma * r, d + gamma * s))

    def _find_room(self, wanted_nm: float, tau_rw_nm: Vec4, way: Vec4) -> float:
        """As much of a null torque as every wheel has room for beside what was allocated to it."""
        size = abs(wanted_nm)
        for torque, part, limit in zip(tau_rw_nm, way, self._wheels.max_torque_nm, strict=True):
            push = part if wanted_nm > 0.0 else -part
            if push != 0.0:
                room = (limit - torque) / push if push > 0.0 else (limit + torque) / -push
                if room < size:
                    size = room if room > 0.0 else 0.0
        return size if wanted_nm > 0.0 else -size if size > 0.0 else 0.0

    def _find_target(self, eta_nms: float, h_nms: Vec4) -> tuple[float, float]:
        """Where the null momentum is to be [N m s], and how fast it is to get there [1/s]."""
        config = self._config
        wish = config.momentum_nms if config.momentum_gain_1_s > 0.0 else eta_nms
        if config.avoid_speed_rad_s > 0.0:
            gaps = self._find_gaps(eta_nms, h_nms)
            if gaps:
                low, high = gaps[0]
                for gap in gaps:
                    if _find_way(eta_nms, gap) < _find_way(eta_nms, (low, high)):
                        low, high = gap
                if not low <= eta_nms <= high:  # a wheel is too slow: out of there first
                    return (low if eta_nms < low else high), config.avoid_gain_1_s
                wish = low if wish < low else high if wish > high else wish
        return wish, config.momentum_gain_1_s

    def _find_gaps(self, eta_nms: float, h_nms: Vec4) -> list[Gap]:
        """The null momenta at which no wheel is too slow, nor near its largest speed; none where there are none."""
        least, most = -math.inf, math.inf
        barred: list[Gap] = []
        for i in (0, 1, 2, 3):
            part = self._n0[i]
            if abs(part) < LEAST_PART:
                continue
            middle = eta_nms - h_nms[i] / part  # at which this wheel stands still
            reach, slow = self._most_nms[i] / abs(part), self._least_nms[i] / abs(part)
            least, most = max(least, middle - reach), min(most, middle + reach)
            barred.append((middle - slow, middle + slow))
        gaps: list[Gap] = []
        for low, high in sorted(barred):
            if low > least:
                gaps.append((least, low if low < most else most))
            if high > least:
                least = high
            if least >= most:
                return gaps
        gaps.append((least, most))
        return gaps


def _find_way(eta_nms: float, gap: Gap) -> float:
    """How far a null momentum is from a gap."""
    low, high = gap
    return low - eta_nms if eta_nms < low else eta_nms - high if eta_nms > high else 0.0


def _multiply(a: Vec4, b: Vec4) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


def _normalise(null: Vec4) -> Vec4:
    length = math.sqrt(_multiply(null, null))
    if length == 0.0:
        return ZERO4
    a, b, c, d = null
    return (a / length, b / length, c / length, d / length)


def _check(config: NullSpaceConfig, vehicle: Vehicle, null: Vec4, period_s: float) -> None:
    """Raises ConfigError where what is asked for cannot be done."""
    if null == ZERO4:
        raise ConfigError(
            f"null_space: wheels fitted {vehicle.fitted} have no null space, four are needed; fit them, or leave "
            "momentum_gain_1_s, avoid_speed_rad_s and dither_nm at 0"
        )
    if config.dither_nm > 0.0 and not config.dither_period_s > 0.0:
        raise ConfigError(
            f"null_space.dither_nm = {config.dither_nm:g} N m needs null_space.dither_period_s > 0 s; give a period, or "
            "take dither_nm: 0"
        )
    if config.dither_nm > 0.0:
        check_wave("null_space.dither_period_s", config.dither_period_s, period_s)
    most = [i * w for i, w in zip(vehicle.wheel_inertia_kgm2, vehicle.wheel_max_speed_rad_s, strict=True)]
    room = min(USED_SPEED * m / abs(part) for m, part in zip(most, null, strict=True) if part != 0.0)
    if abs(config.momentum_nms) > room:
        raise ConfigError(
            f"null_space.momentum_nms = {config.momentum_nms:g} N m s is more than the wheels can hold: {room:.3g} N m s "
            f"brings one of them to {USED_SPEED:g} of its largest speed; take less"
        )
    limit = min(vehicle.wheels.max_torque_nm)
    if config.dither_nm > limit:
        raise ConfigError(
            f"null_space.dither_nm = {config.dither_nm:g} N m is more than a wheel has, {limit:g} N m; take less"
        )
    fastest = USED_SPEED * min(vehicle.wheel_max_speed_rad_s)
    if config.avoid_speed_rad_s >= 0.5 * fastest:
        raise ConfigError(
            f"null_space.avoid_speed_rad_s = {config.avoid_speed_rad_s:g} rad/s leaves the wheels too little below their "
            f"largest speed; it must be below {0.5 * fastest:g} rad/s"
        )
