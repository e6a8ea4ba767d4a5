"""What the detector works on: the sensors of the ticks of one detection cycle, put together."""

from __future__ import annotations

from typing import Final, NamedTuple

from bus.linear import ZERO3, ZERO4
from bus.units import Vec3, Vec4
from fsw.records import Sensors

_MAX_GAP_TICKS: Final = 100  # a longer silence than this is not bridged


class CycleInputs(NamedTuple):
    """Sensors over one detection cycle that ends at this tick."""

    tick: int
    dt_s: float  # length of the cycle, ticks that were skipped included
    rate_b_rad_s: Vec3  # gyro, mean over the cycle
    gyro_valid: tuple[bool, bool, bool]
    h_rw_nms: Vec4  # where a wheel's speed is not known, carried on with the torque commanded
    tau_rw_cmd_nm: Vec4  # commanded, mean over the cycle
    star_q: Vec4 | None  # newest star-tracker attitude that arrived in the cycle
    star_tick: int  # when that was measured


class CycleCollector:
    """Adds ticks up until a cycle is complete."""

    def __init__(self, tick_s: float, ticks_per_cycle: int) -> None:
        self._tick_s = tick_s
        self._ticks_per_cycle = ticks_per_cycle
        self.reset()

    def reset(self) -> None:
        """Begin a new cycle with nothing known before it."""
        self._last_tick: int | None = None
        self.h_rw_nms: Vec4 | None = None
        self._clear()

    def _clear(self) -> None:
        self._ticks = 0
        self._rate = ZERO3
        self._tau = ZERO4
        self._star_q: Vec4 | None = None
        self._star_tick = 0

    def add(self, sensors: Sensors, tau_rw_cmd_nm: Vec4) -> CycleInputs | None:
        """Return the cycle that this tick completes, None in the middle of one. Skipped ticks count as held."""
        gap = 1 if self._last_tick is None else min(max(1, sensors.tick - self._last_tick), _MAX_GAP_TICKS)
        self._last_tick = sensors.tick
        self._ticks += gap
        r, y, t, u = self._rate, sensors.omega_meas_b_rad_s, self._tau, tau_rw_cmd_nm
        self._rate = (r[0] + gap * y[0], r[1] + gap * y[1], r[2] + gap * y[2])
        self._tau = (t[0] + gap * u[0], t[1] + gap * u[1], t[2] + gap * u[2], t[3] + gap * u[3])
        self._follow_wheels(sensors, u, gap * self._tick_s)
        if sensors.star_new:
            self._star_q = sensors.q_ib_meas
            self._star_tick = sensors.tick - round(sensors.star_age_s / self._tick_s)
        if self._ticks < self._ticks_per_cycle:
            return None
        k, r, t = 1.0 / self._ticks, self._rate, self._tau
        assert self.h_rw_nms is not None
        cycle = CycleInputs(
            sensors.tick,
            self._ticks * self._tick_s,
            (r[0] * k, r[1] * k, r[2] * k) if self._ticks > 1 else y,
            sensors.gyro_valid,
            self.h_rw_nms,
            (t[0] * k, t[1] * k, t[2] * k, t[3] * k) if self._ticks > 1 else tau_rw_cmd_nm,
            self._star_q,
            self._star_tick,
        )
        self._clear()
        return cycle

    def _follow_wheels(self, sensors: Sensors, tau_rw_cmd_nm: Vec4, dt_s: float) -> None:
        h, new, last = sensors.wheel_momenta(), sensors.wheels_new(), self.h_rw_nms
        if last is None or False not in new:
            self.h_rw_nms = h
            return
        held = [h[i] if new[i] else last[i] - tau_rw_cmd_nm[i] * dt_s for i in (0, 1, 2, 3)]
        self.h_rw_nms = (held[0], held[1], held[2], held[3])
