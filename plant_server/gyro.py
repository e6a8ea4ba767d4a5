"""Fiber-optic gyro triad: three axes with noise, bias, scale factor, quantisation, range, bandwidth and faults.

Per axis and tick (IEEE Std 952-1997 terms):

    y = (1 + s) w + b + n,   b = b_turn_on + b_instability + b_walk,   n = N x / sqrt(dt)

w is the mean rate over the tick about the sensing axis (angle increment over dt, as an integrating gyro gives it), x
standard normal. b_instability is a first-order Gauss-Markov process of correlation time tau and standard deviation
1.075 B: the flicker floor of a bias instability B is an Allan deviation of 0.664 B, and that of a Gauss-Markov process
peaks at 0.617 sigma. b_walk is a random walk K. Then faults, range, and quantisation of the integrated angle.

The preset `ideal` gives the instantaneous rate at the tick instead of the mean: the published figures need it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bus.attitude import dcm_from_quaternion, exp_map
from bus.units import DEG, Mat3, Vec3
from plant_server.config import GyroConfig
from plant_server.faults import GYRO_AXES, ActiveFault, FaultTimeline
from plant_server.noise import open_normals, open_stream

OK, OUT_OF_RANGE = 0, 2  # STATUS of the rate frame; 1, fault, is never known to the unit
BLOCK = 512  # samples of noise made at a time
SIGMA_PER_INSTABILITY = 0.664 / 0.617  # Gauss-Markov sigma over bias instability B


@dataclass(frozen=True, slots=True)
class GyroPreset:
    """Noise terms of a class of gyros."""

    arw_rad_sqrt_s: float  # angle random walk N
    bias_instability_rad_s: float  # B
    bias_time_s: float
    rrw_rad_s_sqrt_s: float  # rate random walk K
    scale_factor_sigma: float
    angle_lsb_rad: float


PRESETS: dict[str, GyroPreset] = {
    "ideal": GyroPreset(0.0, 0.0, 1000.0, 0.0, 0.0, 0.0),
    # Airbus Astrix 120 data sheet: ARW 0.002 deg/sqrt(h), bias stability 0.01 deg/h, scale factor 100 ppm;
    # correlation time, rate random walk and quantisation assumed
    "space": GyroPreset(0.002 * DEG / 60.0, 0.01 * DEG / 3600.0, 3600.0, 0.001 * DEG / 216000.0, 100e-6, 1e-7),
    # the class of HG1700 and LN-200: 0.1 deg/sqrt(h), 1 deg/h; the rest assumed
    "tactical": GyroPreset(0.1 * DEG / 60.0, 1.0 * DEG / 3600.0, 1000.0, 0.3 * DEG / 216000.0, 300e-6, 1e-6),
}


def fill_preset(config: GyroConfig) -> GyroPreset:
    """Return the noise terms in force: those given, and the preset's for the others."""
    preset = PRESETS[config.preset]

    def choose(given: float | None, default: float) -> float:
        return default if given is None else given

    return GyroPreset(
        choose(config.arw_rad_sqrt_s, preset.arw_rad_sqrt_s),
        choose(config.bias_instability_rad_s, preset.bias_instability_rad_s),
        choose(config.bias_time_s, preset.bias_time_s),
        choose(config.rrw_rad_s_sqrt_s, preset.rrw_rad_s_sqrt_s),
        preset.scale_factor_sigma,
        choose(config.angle_lsb_rad, preset.angle_lsb_rad),
    )


class AxisNoise:
    """White noise and wandering bias of one axis, made a block at a time from the axis's own stream."""

    __slots__ = ("_decay", "_drive", "_instability", "_stream", "_terms", "_turn_on", "_walk", "_walk_step", "_white")

    def __init__(self, terms: GyroPreset, turn_on_rad_s: float, dt_s: float, seed: int, unit: str) -> None:
        self._stream = open_stream(seed, unit)
        self._turn_on = turn_on_rad_s
        sigma = SIGMA_PER_INSTABILITY * terms.bias_instability_rad_s
        self._decay = math.exp(-dt_s / terms.bias_time_s)
        self._drive = sigma * math.sqrt(1.0 - self._decay * self._decay)
        self._walk_step = terms.rrw_rad_s_sqrt_s * math.sqrt(dt_s)
        self._white = terms.arw_rad_sqrt_s / math.sqrt(dt_s)
        self._instability = sigma * float(self._stream.standard_normal())  # stationary from the start
        self._walk = 0.0

    def make_block(self) -> tuple[list[float], list[float]]:
        """Return the white noise and the bias of the next BLOCK samples [rad/s]."""
        draws = self._stream.standard_normal((3, BLOCK))
        white = (self._white * draws[0]).tolist()
        instability, walk, bias = self._instability, self._walk, []
        for kick, pace in zip((self._drive * draws[1]).tolist(), (self._walk_step * draws[2]).tolist(), strict=True):
            bias.append(self._turn_on + instability + walk)
            instability = self._decay * instability + kick
            walk += pace
        self._instability, self._walk = instability, walk
        return white, bias


class GyroAxis:
    """One axis: from the true rate about the sensing axis to the rate that its frame carries."""

    __slots__ = (
        "_bias_block", "_carry", "_filter", "_filtered", "_frozen", "_gain", "_last", "_lsb_rate", "_next", "_noise",
        "_range", "_turn_on", "_white_block", "bias_rad_s", "chain", "fault_rad_s", "ideal", "silent", "status",
    )  # fmt: skip

    def __init__(
        self, unit: str, config: GyroConfig, axis: int, timeline: FaultTimeline, dt_s: float, seed: int
    ) -> None:
        terms = fill_preset(config)
        self.chain = timeline.chains[unit]
        if config.scale_factor is None:
            scale = terms.scale_factor_sigma * open_normals(seed, f"{unit}/scale_factor")()
        else:
            scale = config.scale_factor[axis]
        self._gain = 1.0 + scale
        self._turn_on = config.bias_rad_s[axis]
        noisy = terms.arw_rad_sqrt_s or terms.bias_instability_rad_s or terms.rrw_rad_s_sqrt_s
        self._noise = AxisNoise(terms, self._turn_on, dt_s, seed, unit) if noisy else None
        self._white_block: list[float] = []
        self._bias_block: list[float] = []
        self._next = BLOCK
        self._filter = 1.0 - math.exp(-2.0 * math.pi * config.bandwidth_hz * dt_s) if config.bandwidth_hz else 1.0
        self._filtered: float | None = None
        self._range = config.range_rad_s
        self._lsb_rate = terms.angle_lsb_rad / dt_s
        self.ideal = not noisy and self._gain == 1.0 and self._filter == 1.0 and self._turn_on == self._lsb_rate == 0.0
        self._carry = 0.0  # integrated angle not yet given out, in quanta
        self._last = 0.0
        self._frozen = False
        self.bias_rad_s = self._turn_on
        self.fault_rad_s = 0.0
        self.status = OK
        self.silent = False

    def sample(self, rate_rad_s: float, step: int, t_s: float) -> float:
        """Return the rate of this tick's frame [rad/s]; `silent` says that there is no frame."""
        rate = rate_rad_s * self._gain
        if self._filter != 1.0:
            before = self._filtered
            self._filtered = rate = rate if before is None else before + (rate - before) * self._filter
        white = 0.0
        if self._noise is not None:
            i = self._next
            if i == BLOCK:
                self._white_block, self._bias_block = self._noise.make_block()
                i = 0
            self._next = i + 1
            white = self._white_block[i]
            self.bias_rad_s = self._bias_block[i]
        rate += self.bias_rad_s + white
        chain = self.chain
        if step >= chain.next_edge:
            chain.refresh(step)
            self.silent = self._frozen = False
            self.fault_rad_s = 0.0
        if chain.active:
            disturbed = self._disturb(rate, white, t_s)
            self.fault_rad_s = 0.0 if self.silent else disturbed - rate
            rate = disturbed
        limit = self._range
        if -limit <= rate <= limit:
            self.status = OK
        else:
            self.status = OUT_OF_RANGE
            rate = limit if rate > 0.0 else -limit
        if self._lsb_rate and not self._frozen:
            angle = self._carry + rate / self._lsb_rate
            quanta = round(angle)
            self._carry = angle - quanta
            rate = quanta * self._lsb_rate
        if not self.silent:
            self._last = rate
        return rate

    def _disturb(self, rate: float, white: float, t_s: float) -> float:
        """Return the rate with the active faults, in the order of their onset; set `silent`.

        A larger angle random walk is part of the noise, so it comes before the others.
        """
        active = self.chain.active
        extra = 1.0
        for fault in active:
            if fault.kind == "noise":
                extra *= 1.0 + fault.measure_level(t_s) * ((fault.config.factor or 0.0) - 1.0)
        rate += (extra - 1.0) * white
        self.silent = self._frozen = False
        for fault in active:
            kind = fault.kind
            if kind == "dead":
                self.silent = True
            elif kind == "intermittent":
                if _strike(fault, t_s):
                    self.silent = True
            elif kind == "stuck":
                level = fault.measure_level(t_s)
                rate += level * (self._hold(fault) - rate)
                self._frozen = level == 1.0
            elif kind != "noise":
                before = rate
                rate = _shift(fault, rate, t_s)
                self._frozen = self._frozen and rate == before
        return rate

    def _hold(self, fault: ActiveFault) -> float:
        if fault.held_rad_s is None:
            given = fault.config.rate_rad_s
            fault.held_rad_s = self._last if given is None else given
        return fault.held_rad_s


def _strike(fault: ActiveFault, t_s: float) -> bool:
    draw = fault.draw
    return draw is not None and draw() < fault.measure_level(t_s) * (fault.config.probability or 0.0)


def _shift(fault: ActiveFault, rate: float, t_s: float) -> float:
    """Return the rate after a fault that changes its value [rad/s]."""
    config = fault.config
    size = config.rate_rad_s or 0.0
    if fault.kind == "ramp":
        return rate + (config.slope_rad_s2 or 0.0) * (t_s - fault.start_s)
    if fault.kind == "scale":
        return rate * (1.0 + fault.measure_level(t_s) * (config.factor or 0.0))
    if fault.kind == "spikes":
        hit = _strike(fault, t_s)
        sign = 1.0 if fault.draw is not None and fault.draw() < 0.5 else -1.0
        return rate + sign * size if hit else rate
    if fault.kind == "periodic":
        origin_s = fault.start_s if config.phase == "onset" else 0.0
        size *= math.sin((config.frequency_rad_s or 0.0) * (t_s - origin_s))
    return rate + fault.measure_level(t_s) * size


class Gyro:
    """The triad."""

    __slots__ = (
        "_ideal",
        "_quiet_until",
        "_range",
        "_sensing",
        "axes",
        "instantaneous",
        "silent",
        "status",
        "truth_rad_s",
    )

    def __init__(self, config: GyroConfig, timeline: FaultTimeline, dt_s: float, seed: int) -> None:
        self.instantaneous = config.preset == "ideal"
        x, y, z = (angle * DEG for angle in config.misalignment_deg)
        # rows: sensing axes in body axes, the triad turned by the rotation vector `misalignment`
        (a, b, c), (d, e, f), (g, h, i) = dcm_from_quaternion(exp_map((x, y, z)))
        self._sensing: Mat3 | None = ((a, d, g), (b, e, h), (c, f, i)) if x or y or z else None
        self.axes = tuple(GyroAxis(unit, config, axis, timeline, dt_s, seed) for axis, unit in enumerate(GYRO_AXES))
        self.status = (OK, OK, OK)
        self.silent = (False, False, False)
        self.truth_rad_s: tuple[float, ...] = ()  # bias of each axis, then what the faults add, in the last sample
        self._look_at_axes()
        self._range = config.range_rad_s
        self._ideal = self._sensing is None and all(axis.ideal for axis in self.axes)
        self._quiet_until = -1  # step before which no fault acts, for the short way of ideal axes

    def sample(self, rate_b_rad_s: Vec3, step: int, t_s: float) -> Vec3:
        """Return the rates of this tick's frames [rad/s], one per axis; set `status` and `silent` of each.

        rate_b_rad_s : true rate, body axes: mean over the tick, instantaneous for the ideal preset
        step, t_s    : integration step and time of the tick
        """
        x, y, z = rate_b_rad_s
        limit = self._range
        if step < self._quiet_until and -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit:
            return rate_b_rad_s
        if self._sensing is not None:
            (a, b, c), (d, e, f), (g, h, i) = self._sensing
            x, y, z = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        ax, ay, az = self.axes
        rate = (ax.sample(x, step, t_s), ay.sample(y, step, t_s), az.sample(z, step, t_s))
        self.status = (ax.status, ay.status, az.status)
        self.silent = (ax.silent, ay.silent, az.silent)
        self._look_at_axes()
        if self._ideal:
            clean = self.status == (OK, OK, OK) and not (ax.chain.active or ay.chain.active or az.chain.active)
            self._quiet_until = min(axis.chain.next_edge for axis in self.axes) if clean else -1
        return rate

    def look_again(self) -> None:
        """Note that a fault was added to one of the chains."""
        self._quiet_until = -1

    def _look_at_axes(self) -> None:
        x, y, z = self.axes
        self.truth_rad_s = (x.bias_rad_s, y.bias_rad_s, z.bias_rad_s, x.fault_rad_s, y.fault_rad_s, z.fault_rad_s)
