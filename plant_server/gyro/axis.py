"""One gyro axis: from the true rate about the sensing axis to the rate that its frame carries."""

from __future__ import annotations

import math
from typing import Final, cast

from plant_server.config import GyroConfig
from plant_server.faults.effects import GyroEffect, GyroSample
from plant_server.faults.timeline import ActiveFault, FaultChain, FaultTimeline
from plant_server.gyro.noise import open_errors
from plant_server.gyro.presets import fill_preset
from plant_server.noise import open_normals

OK: Final = 0  # STATUS of the rate frame; 1, fault, is never known to the unit
OUT_OF_RANGE: Final = 2
RESOLUTION_RAD_S: Final = 1e-9  # of the rate frame: what is less does not leave the unit
GyroFault = ActiveFault[GyroEffect]


class GyroAxis:
    """Scale factor, bandwidth, noise, faults, range and quantisation of one axis."""

    __slots__ = (
        "_carry", "_chain", "_filter", "_filtered", "_frozen", "_gain", "_last_rad_s", "_lsb_rate", "_noise",
        "_range", "_timeline", "bias_rad_s", "fault_rad_s", "silent", "status",
    )  # fmt: skip

    def __init__(
        self, unit: str, config: GyroConfig, axis: int, timeline: FaultTimeline, dt_s: float, seed: int
    ) -> None:
        terms = fill_preset(config)
        self._timeline = timeline
        self._chain = cast(FaultChain[GyroEffect], timeline.chains[unit])
        if config.scale_factor is None:
            scale = terms.scale_factor_sigma * open_normals(seed, f"{unit}/scale_factor")()
        else:
            scale = config.scale_factor[axis]
        self._gain = 1.0 + scale
        self._noise = open_errors(terms, config.bias_rad_s[axis], dt_s, seed, unit)
        self._filter = 1.0 - math.exp(-2.0 * math.pi * config.bandwidth_hz * dt_s) if config.bandwidth_hz else 1.0
        self._filtered: float | None = None
        self._range = config.range_rad_s
        self._lsb_rate = terms.angle_lsb_rad / dt_s
        self._carry = 0.0  # integrated angle not yet given out, in quanta
        self._last_rad_s = 0.0  # what it gave out last
        self._frozen = False  # the output stands still
        self.bias_rad_s = config.bias_rad_s[axis]  # in the last sample,
        self.fault_rad_s = 0.0  # and what the faults added to it
        self.status = OK
        self.silent = False  # the last sample has no frame

    def sample(self, rate_rad_s: float, step: int, t_s: float) -> float:
        """Return the rate of this tick's frame [rad/s]; set `status` and `silent`.

        rate_rad_s : true rate about the sensing axis
        """
        error, self.bias_rad_s, white = self._noise.draw()
        rate = rate_rad_s * self._gain
        if self._filter != 1.0:
            before = self._filtered
            self._filtered = rate = rate if before is None else before + (rate - before) * self._filter
        rate += error
        chain = self._chain
        if step >= chain.next_edge:
            chain.refresh(step)
            self._frozen = self.silent = False
            self.fault_rad_s = 0.0
        if chain.active:
            rate = self._pass_faults(rate, white, step, t_s)
        limit = self._range
        if -limit <= rate <= limit:
            self.status = OK
        else:
            self.status = OUT_OF_RANGE
            rate = limit if rate > 0.0 else -limit
        lsb = self._lsb_rate
        if lsb and not self._frozen:
            angle = self._carry + rate / lsb
            quanta = round(angle)
            self._carry = angle - quanta
            rate = quanta * lsb
        if not self.silent:
            self._last_rad_s = rate
        return rate

    # -- faults --------------------------------------------------------------------------------------------------------

    def _pass_faults(self, rate: float, white: float, step: int, t_s: float) -> float:
        """Return the rate with the active faults; note which of them first change what is sent."""
        chain = self._chain
        for fault in chain.active:
            fault.bring_to(t_s)
        sample = self._disturb(rate, white, None)
        self.silent, self._frozen = sample.silent, sample.frozen
        self.fault_rad_s = 0.0 if sample.silent else sample.rate_rad_s - rate
        for fault in chain.without_effect_yet():
            if self._find_output(sample) != self._find_output(self._disturb(rate, white, fault)):
                self._timeline.note_effect(fault, step)
        return sample.rate_rad_s

    def _disturb(self, rate: float, white: float, left_out: GyroFault | None) -> GyroSample:
        """Return the sample after all active faults but one."""
        sample = GyroSample(rate, white, self._last_rad_s)
        for fault in self._chain.active:
            if fault is not left_out:
                fault.effect.disturb(sample, fault.now)
        return sample

    def _find_output(self, sample: GyroSample) -> int | None:
        """Return the rate that would be sent for a sample, in steps of its frame; None: no frame."""
        if sample.silent:
            return None
        limit = self._range
        rate = min(max(sample.rate_rad_s, -limit), limit)
        if self._lsb_rate and not sample.frozen:
            rate = round(self._carry + rate / self._lsb_rate) * self._lsb_rate
        return round(rate / RESOLUTION_RAD_S)
