"""Health factors of the wheels: the share and the bias of each one's torque, from its speed, and dead ones probed."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from bus.errors import ConfigError
from bus.linear import ZERO3, ZERO4
from bus.units import Vec3, Vec4
from fsw.families import WheelHealthMonitor
from fsw.records import ALL_WHEELS, NO_WHEEL, ONES4, Flags4, FourReadings, WheelHealth
from fsw.square_wave import SquareWave, check_wave
from fsw.vehicle import Vehicle
from fsw.wheel_health.command_delay import CommandDelay
from fsw.wheel_health.settings import ShareKalmanConfig
from fsw.wheel_health.share_filter import ShareFilter
from fsw.wheel_health.wheel_watch import NO_COMMAND, SPEED_LIMIT

DITHER_OFF: Final = 0
DITHER_ON: Final = 1
NO_NULL_SPACE: Final = 2
LONGEST_PERIODS: Final = 20.0  # an interval of more than so many periods teaches nothing
LEAST_SHARE: Final = 0.2  # a weaker wheel is not stirred more than one of this share
SIGMAS: Final = 3.0  # an alarm wants to be so sure
RELEASE: Final = 0.5  # an alarm ends below this part of what gave it


class ShareKalmanInternals(NamedTuple):
    """What the filters hold, per wheel."""

    share: Vec4
    bias_nm: Vec4
    share_sigma: Vec4
    cusum: Vec4
    resets: Vec4  # times that the CUSUM has opened the covariance
    dead: Vec4  # 1: no torque is planned on it, and it is probed


class _Block:
    """A wheel's momentum lost and impulse told since the measurement began."""

    __slots__ = ("count", "h_nms", "impulse_nms", "known", "span_s")

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.known = False  # whether h_nms is that at the start of the block
        self.h_nms = 0.0
        self.impulse_nms = self.span_s = 0.0
        self.count = 0

    def begin(self, h_nms: float) -> None:
        self.known = True
        self.h_nms = h_nms
        self.impulse_nms = self.span_s = 0.0
        self.count = 0


class ShareKalman(WheelHealthMonitor):
    """Per wheel tau = e u + b, by a filter of two random walks on tau = -dh/dt over `average` periods.

    After the health factors of CN103699131B, which says what they are for and not how they are found; the filter, its
    cap and its CUSUM are this project's, see docs/wheel-health.md. A wheel below `dead_below` is `dead`: the allocator plans
    nothing on it. Told nothing it would show nothing, so it gets a square wave, and a recovery is seen.
    """

    def __init__(self, config: ShareKalmanConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: nominal time between calls of `step` [s].

        Raises ConfigError for a measurement without noise, thresholds in the wrong order and a wave beyond a wheel's torque.
        """
        _check(config, vehicle, period_s)
        self._config = config
        self._geometry = vehicle.wheels
        self._fitted = vehicle.fitted
        self._max_nm = vehicle.wheels.max_torque_nm
        self._longest_s = LONGEST_PERIODS * period_s
        a, b, c, d = (
            ShareFilter(config, inertia, torque)
            for inertia, torque in zip(vehicle.wheel_inertia_kgm2, vehicle.wheels.max_torque_nm, strict=True)
        )
        self._filters = (a, b, c, d)
        self._blocks = (_Block(), _Block(), _Block(), _Block())
        self._wave = SquareWave(config.wave_period_s)
        self._delay = CommandDelay(config.command_latency_s, period_s)
        self.reset()

    def reset(self) -> None:
        """Trust every wheel again."""
        for wheel in self._filters:
            wheel.reset()
        for block in self._blocks:
            block.reset()
        self._delay.reset()
        self._alarm: Flags4 = NO_WHEEL
        self._dead: Flags4 = NO_WHEEL
        self._seen = ZERO4  # what the wheels give beside what they are told, through the observer's lag
        self._wave.reset()
        self._low_s = [0.0, 0.0, 0.0, 0.0]  # for how long each share has been below dead_below

    @property
    def internals(self) -> ShareKalmanInternals:
        """Shares, biases, their certainty, and the CUSUMs."""
        p, q, r, s = self._filters
        la, lb, lc, ld = self._max_nm
        t, u, v, w = self._dead
        return ShareKalmanInternals(
            (p.share, q.share, r.share, s.share),
            (p.bias * la, q.bias * lb, r.bias * lc, s.bias * ld),
            (math.sqrt(p.p_ee), math.sqrt(q.p_ee), math.sqrt(r.p_ee), math.sqrt(s.p_ee)),
            (p.cusum, q.cusum, r.cusum, s.cusum),
            (float(p.resets), float(q.resets), float(r.resets), float(s.resets)),
            (1.0 if t else 0.0, 1.0 if u else 0.0, 1.0 if v else 0.0, 1.0 if w else 0.0),
        )

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Return shares, biases and which wheels are dead. The fault torque says only whether an observer runs.

        A wheel that is not heard, or says that it does not follow its command, is not judged by what it does meanwhile.
        """
        told = self._delay.take(dt_s, tau_rw_cmd_nm) if dt_s > 0.0 else ZERO4
        for i in (0, 1, 2, 3):
            reading = wheels[i]
            heard = reading.valid and reading.status != NO_COMMAND and reading.status != SPEED_LIMIT
            if self._fitted[i]:
                self._learn(i, dt_s, told[i], reading.h_nms, heard, reading.new)
        self._judge(dt_s)
        p, q, r, s = self._filters
        shares = (self._say_share(p), self._say_share(q), self._say_share(r), self._say_share(s))
        bias_nm = (self._say_bias(0), self._say_bias(1), self._say_bias(2), self._say_bias(3))
        explained = self._explain(dt_s, shares, bias_nm, tau_rw_cmd_nm, tau_fault_hat_b_nm)
        wave = self._wave.step(dt_s)  # of probes and dither
        dither, dither_rw_nm = DITHER_OFF, ZERO4
        if tau_fault_hat_b_nm is not None:
            dither, dither_rw_nm = self._stir(shares, wave)
        return WheelHealth(
            shares, ALL_WHEELS, self._alarm, explained, dither=dither, dither_rw_nm=dither_rw_nm, bias_nm=bias_nm,
            dead=self._dead, probe_rw_nm=self._probe(wave),
        )  # fmt: skip

    def _learn(self, wheel: int, dt_s: float, told_nm: float, h_nms: float, heard: bool, new: bool) -> None:
        """Add an interval to the wheel's block, and give the block to its filter once it is full.

        A momentum that is held from an earlier tick ends no interval: it would look like a wheel that gave nothing.
        """
        block = self._blocks[wheel]
        if not heard or not 0.0 < dt_s <= self._longest_s:
            if dt_s != 0.0:
                block.reset()
            return
        if not block.known:
            if new:
                block.begin(h_nms)
            return
        block.impulse_nms += told_nm * dt_s
        block.span_s += dt_s
        if not new:
            return
        block.count += 1
        if block.count >= self._config.average:
            scale = 1.0 / (block.span_s * self._max_nm[wheel])
            self._filters[wheel].update(block.span_s, block.impulse_nms * scale, (block.h_nms - h_nms) * scale)
            block.begin(h_nms)

    def _judge(self, dt_s: float) -> None:
        """Which wheels have an alarm, and which are dead.

        A share below dead_below is that of a dead wheel once it is sure, or has stood for dead_after_s: a wheel that is told
        nothing teaches nothing, and would otherwise be neither used nor probed for ever.
        """
        config = self._config
        alarm: list[bool] = [False, False, False, False]
        dead: list[bool] = [False, False, False, False]
        for i in (0, 1, 2, 3):
            wheel = self._filters[i]
            lost, bias, sigma = 1.0 - wheel.share, abs(wheel.bias), math.sqrt(wheel.p_ee)
            if self._alarm[i]:
                alarm[i] = lost > RELEASE * config.alarm_share or bias > RELEASE * config.alarm_bias
            else:
                sure_lost = lost > config.alarm_share and lost > SIGMAS * sigma
                alarm[i] = sure_lost or (bias > config.alarm_bias and bias > SIGMAS * math.sqrt(wheel.p_bb))
            if self._dead[i]:
                dead[i] = wheel.share < config.alive_above
            else:
                low = wheel.share < config.dead_below
                self._low_s[i] = self._low_s[i] + dt_s if low else 0.0
                dead[i] = low and (sigma < config.dead_sigma or self._low_s[i] > config.dead_after_s)
        self._alarm = (alarm[0], alarm[1], alarm[2], alarm[3])
        self._dead = (dead[0], dead[1], dead[2], dead[3])

    def _say_share(self, wheel: ShareFilter) -> float:
        """The share to reckon with: one that is as good as whole is whole."""
        return 1.0 if wheel.share > 1.0 - self._config.share_dead_band else wheel.share

    def _say_bias(self, wheel: int) -> float:
        bias = self._filters[wheel].bias
        return 0.0 if abs(bias) < self._config.bias_dead_band else bias * self._max_nm[wheel]

    def _explain(
        self, dt_s: float, shares: Vec4, bias_nm: Vec4, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> Vec3:
        """The part of the observer's fault torque that shares and biases account for, seen through its lag [N m].

        None of it where there is no observer: one that never sees a torque says exactly zero.
        """
        (e, f, g, h), (p, q, r, s), (t, u, v, w) = shares, tau_rw_cmd_nm, bias_nm
        more = (t - (1.0 - e) * p, u - (1.0 - f) * q, v - (1.0 - g) * r, w - (1.0 - h) * s)
        lag = 1.0 - math.exp(-dt_s / self._config.observer_lag_s) if dt_s > 0.0 else 0.0
        (a, b, c, d), (p, q, r, s) = self._seen, more
        self._seen = a, b, c, d = (a + lag * (p - a), b + lag * (q - b), c + lag * (r - c), d + lag * (s - d))
        if tau_fault_hat_b_nm is None or tau_fault_hat_b_nm == ZERO3:
            return ZERO3
        return self._geometry.combine((a, b, c, d))

    def _probe(self, wave: float) -> Vec4:
        """What dead wheels are told [N m]."""
        torque = self._config.probe_nm * wave
        if torque == 0.0 or self._dead == NO_WHEEL:
            return ZERO4
        t, u, v, w = self._dead
        return (torque if t else 0.0, torque if u else 0.0, torque if v else 0.0, torque if w else 0.0)

    def _stir(self, shares: Vec4, wave: float) -> tuple[int, Vec4]:
        """Whether the wheels are to be stirred in their null space, and by what [N m]; the largest has `dither_nm`."""
        config = self._config
        if config.dither == "off" or config.dither_nm == 0.0 or (config.dither == "alarm" and self._alarm == NO_WHEEL):
            return DITHER_OFF, ZERO4
        t, u, v, w = self._dead
        k, m, n, o = self._fitted
        a, b, c, d = self._geometry.find_null((k and not t, m and not u, n and not v, o and not w))
        if shares != ONES4:  # a wheel that gives half is told twice as much, so that the body feels nothing
            e, f, g, h = shares
            a, b, c, d = a / _bound(e), b / _bound(f), c / _bound(g), d / _bound(h)
        largest = max(abs(a), abs(b), abs(c), abs(d))
        if largest == 0.0:
            return NO_NULL_SPACE, ZERO4
        size = config.dither_nm * wave / largest
        return DITHER_ON, (a * size, b * size, c * size, d * size)


def _bound(share: float) -> float:
    return LEAST_SHARE if share < LEAST_SHARE else share


def _check(config: ShareKalmanConfig, vehicle: Vehicle, period_s: float) -> None:
    waves = config.probe_nm > 0.0 or (config.dither != "off" and config.dither_nm > 0.0)
    if waves:
        check_wave("fsw.wheel_health.wave_period_s", config.wave_period_s, period_s)
    if config.speed_quantum_rad_s == 0.0 and config.torque_noise_nm == 0.0:
        raise ConfigError(
            "fsw.wheel_health: speed_quantum_rad_s and torque_noise_nm are both 0, so that a measurement would have no "
            "noise at all; at least one must be above 0 (1e-3 rad/s is what the frames carry)"
        )
    if config.alive_above < config.dead_below:
        raise ConfigError(
            f"fsw.wheel_health.alive_above = {config.alive_above:g} must be at least dead_below = {config.dead_below:g}: "
            "a wheel in between would be dead and alive in turn; raise alive_above"
        )
    for key, torque in (("probe_nm", config.probe_nm), ("dither_nm", config.dither_nm)):
        least = min(limit for limit, fitted in zip(vehicle.wheels.max_torque_nm, vehicle.fitted, strict=True) if fitted)
        if torque > least:
            raise ConfigError(
                f"fsw.wheel_health.{key} = {torque:g} N m is more than the weakest wheel has, {least:g} N m; "
                "take a tenth of that, or 0 for none"
            )
