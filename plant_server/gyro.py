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

import numpy as np
from numpy.typing import NDArray

from bus.attitude import dcm_from_quaternion, exp_map
from bus.units import DEG, Mat3, Vec3
from plant_server.config import GyroConfig
from plant_server.faults import GYRO_AXES, ActiveFault, FaultTimeline
from plant_server.noise import open_normals, open_stream

OK, OUT_OF_RANGE = 0, 2  # STATUS of the rate frame; 1, fault, is never known to the unit
BLOCK = 512  # samples of noise made at a time
Floats = NDArray[np.float64]
# of the three axes [rad/s]: error, which is bias and white noise together; bias; white noise
Errors = tuple[float, float, float, float, float, float, float, float, float]
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

    __slots__ = ("_decay", "_drive", "_instability", "_stream", "_turn_on", "_walk", "_walk_step", "_white")

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

    def make_block(self) -> tuple[Floats, Floats]:
        """Return the white noise and the bias of the next BLOCK samples [rad/s]."""
        draws = self._stream.standard_normal((3, BLOCK))
        decay, instability = self._decay, self._instability
        wander = [instability, *(instability := decay * instability + k for k in (self._drive * draws[1]).tolist())]
        walk = np.cumsum(np.concatenate(((self._walk,), self._walk_step * draws[2])))
        self._instability, self._walk = wander.pop(), float(walk[-1])
        return self._white * draws[0], self._turn_on + np.array(wander) + walk[:-1]


class TriadNoise:
    """The noise of three axes, a sample at a time."""

    __slots__ = ("_axes", "_block", "_next")

    def __init__(self, axes: tuple[AxisNoise, ...]) -> None:
        self._axes = axes
        self._block: list[Errors] = []
        self._next = BLOCK

    def draw(self) -> Errors:
        """Return the errors of the next sample."""
        i = self._next
        if i == BLOCK:
            whites, biases = zip(*(axis.make_block() for axis in self._axes), strict=True)
            columns = (*(white + bias for white, bias in zip(whites, biases, strict=True)), *biases, *whites)
            self._block = list(zip(*(column.tolist() for column in columns), strict=True))
            i = 0
        self._next = i + 1
        return self._block[i]


class GyroAxis:
    """One axis: from the true rate about the sensing axis to the rate that its frame carries."""

    __slots__ = (
        "_filter", "_filtered", "_frozen", "_range", "bias_rad_s", "carry", "chain", "fault_rad_s", "gain", "last_rad_s",
        "lsb_rate", "noise", "silent", "status",
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
        self.gain = 1.0 + scale
        noisy = terms.arw_rad_sqrt_s or terms.bias_instability_rad_s or terms.rrw_rad_s_sqrt_s
        self.noise = AxisNoise(terms, config.bias_rad_s[axis], dt_s, seed, unit) if noisy else None
        self._filter = 1.0 - math.exp(-2.0 * math.pi * config.bandwidth_hz * dt_s) if config.bandwidth_hz else 1.0
        self._filtered: float | None = None
        self._range = config.range_rad_s
        self.lsb_rate = terms.angle_lsb_rad / dt_s
        self.carry = 0.0  # integrated angle not yet given out, in quanta
        self.last_rad_s = 0.0
        self._frozen = False
        self.bias_rad_s = config.bias_rad_s[axis]
        self.fault_rad_s = 0.0
        self.status = OK
        self.silent = False

    def sample(self, rate_rad_s: float, error: float, bias: float, white: float, step: int, t_s: float) -> float:
        """Return the rate of this tick's frame [rad/s]; `silent` says that there is no frame.

        rate_rad_s         : true rate about the sensing axis
        error, bias, white : of this sample, error = bias + white [rad/s]
        """
        rate = rate_rad_s * self.gain
        if self._filter != 1.0:
            before = self._filtered
            self._filtered = rate = rate if before is None else before + (rate - before) * self._filter
        self.bias_rad_s = bias
        rate += error
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
        if self.lsb_rate and not self._frozen:
            angle = self.carry + rate / self.lsb_rate
            quanta = round(angle)
            self.carry = angle - quanta
            rate = quanta * self.lsb_rate
        if not self.silent:
            self.last_rad_s = rate
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
            fault.held_rad_s = self.last_rad_s if given is None else given
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
    """The triad.

    Two ways lead to the same rates. While no fault acts and nothing is out of range, the three axes are sampled together;
    else, and with a filter, each by itself. What an axis hands on from sample to sample lies here for both.
    """

    __slots__ = (
        "_carry", "_gains", "_ideal", "_last", "_lsb_rate", "_noise", "_quiet_until", "_range", "_sensing", "_still",
        "_together", "axes", "instantaneous", "silent", "status", "truth_rad_s",
    )  # fmt: skip

    def __init__(self, config: GyroConfig, timeline: FaultTimeline, dt_s: float, seed: int) -> None:
        self.instantaneous = config.preset == "ideal"
        x, y, z = (angle * DEG for angle in config.misalignment_deg)
        # rows: sensing axes in body axes, the triad turned by the rotation vector `misalignment`
        (a, b, c), (d, e, f), (g, h, i) = dcm_from_quaternion(exp_map((x, y, z)))
        self._sensing: Mat3 | None = ((a, d, g), (b, e, h), (c, f, i)) if x or y or z else None
        self.axes = ax, ay, az = tuple(
            GyroAxis(unit, config, axis, timeline, dt_s, seed) for axis, unit in enumerate(GYRO_AXES)
        )
        self.status = (OK, OK, OK)
        self.silent = (False, False, False)
        bx, by, bz = config.bias_rad_s
        self._still: Errors = (bx, by, bz, bx, by, bz, 0.0, 0.0, 0.0)  # of axes without noise
        noises = tuple(axis.noise for axis in self.axes if axis.noise is not None)
        self._noise = TriadNoise(noises) if noises else None
        self._gains: Vec3 = (ax.gain, ay.gain, az.gain)
        self._lsb_rate = ax.lsb_rate
        self._carry: Vec3 = (0.0, 0.0, 0.0)
        self._last: Vec3 = (0.0, 0.0, 0.0)
        self.truth_rad_s: tuple[float, ...] = (bx, by, bz, 0.0, 0.0, 0.0)  # bias and fault of each axis, last sample
        self._range = config.range_rad_s
        self._together = not config.bandwidth_hz
        exact = self._sensing is None and self._together and self._lsb_rate == 0.0 and self._gains == (1.0, 1.0, 1.0)
        self._ideal = exact and self._noise is None and not (bx or by or bz)
        self._quiet_until = -1  # step before which no fault acts

    def sample(self, rate_b_rad_s: Vec3, step: int, t_s: float) -> Vec3:
        """Return the rates of this tick's frames [rad/s], one per axis; set `status` and `silent` of each.

        rate_b_rad_s : true rate, body axes: mean over the tick, instantaneous for the ideal preset
        step, t_s    : integration step and time of the tick
        """
        x, y, z = rate_b_rad_s
        limit = self._range
        quiet = step < self._quiet_until
        if quiet and self._ideal and -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit:
            self._last = rate_b_rad_s  # what a fault `stuck` will hold
            return rate_b_rad_s
        if self._sensing is not None:
            (a, b, c), (d, e, f), (g, h, i) = self._sensing
            x, y, z = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        errors = self._still if self._noise is None else self._noise.draw()
        if quiet and self._together:
            gx, gy, gz = self._gains
            ex, ey, ez, bx, by, bz, _, _, _ = errors
            u = x * gx + ex
            v = y * gy + ey
            w = z * gz + ez
            if -limit <= u <= limit and -limit <= v <= limit and -limit <= w <= limit:
                self.truth_rad_s = (bx, by, bz, 0.0, 0.0, 0.0)
                self._last = rate = self._quantise(u, v, w) if self._lsb_rate else (u, v, w)
                return rate
        return self._sample_each(x, y, z, errors, step, t_s)

    def _quantise(self, x: float, y: float, z: float) -> Vec3:
        """Return the rates as whole quanta of the integrated angle [rad/s]; the rest is carried to the next sample."""
        lsb = self._lsb_rate
        a, b, c = self._carry
        a += x / lsb
        b += y / lsb
        c += z / lsb
        i, j, k = round(a), round(b), round(c)
        self._carry = (a - i, b - j, c - k)
        return (i * lsb, j * lsb, k * lsb)

    def _sample_each(self, x: float, y: float, z: float, errors: Errors, step: int, t_s: float) -> Vec3:
        """Sample the axes one by one, whatever happens to them."""
        ax, ay, az = self.axes
        for axis, carry, last in zip(self.axes, self._carry, self._last, strict=True):
            axis.carry, axis.last_rad_s = carry, last
        ex, ey, ez, bx, by, bz, wx, wy, wz = errors
        rate = (
            ax.sample(x, ex, bx, wx, step, t_s),
            ay.sample(y, ey, by, wy, step, t_s),
            az.sample(z, ez, bz, wz, step, t_s),
        )
        self._carry = (ax.carry, ay.carry, az.carry)
        self._last = (ax.last_rad_s, ay.last_rad_s, az.last_rad_s)
        self.status = (ax.status, ay.status, az.status)
        self.silent = (ax.silent, ay.silent, az.silent)
        self.truth_rad_s = (bx, by, bz, ax.fault_rad_s, ay.fault_rad_s, az.fault_rad_s)
        clean = self.status == (OK, OK, OK) and not (ax.chain.active or ay.chain.active or az.chain.active)
        self._quiet_until = min(axis.chain.next_edge for axis in self.axes) if clean else -1
        return rate

    def look_again(self) -> None:
        """Note that a fault was added to one of the chains."""
        self._quiet_until = -1
