"""Wheel alarms: torque that a wheel gave, from its own speed, against torque it was told to give."""

from __future__ import annotations

from typing import Final, NamedTuple

from bus.linear import ZERO3, ZERO4
from bus.units import Vec3, Vec4
from fsw.families import WheelHealthMonitor
from fsw.records import ALL_WHEELS, Flags4, FourReadings, WheelHealth
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import TorqueMonitorConfig

_RELEASE: Final = 0.5  # an alarm ends once the residual is below this part of the threshold ...
_RELEASE_S: Final = 5.0  # ... for this long


class TorqueMonitorInternals(NamedTuple):
    """What the monitor sees."""

    residual_nm: Vec4


class TorqueMonitor(WheelHealthMonitor):
    """r_i = low-passed (-dh_i/dt - commanded torque), one per wheel. A gyro fault cannot reach it."""

    def __init__(self, config: TorqueMonitorConfig, vehicle: Vehicle, period_s: float) -> None:
        """period_s: nominal time between calls of `step` [s]."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget momentum, alarms and which wheels were switched off."""
        self._h: Vec4 | None = None
        self._heard = ALL_WHEELS
        self._span_s = [0.0, 0.0, 0.0, 0.0]  # since the momentum was last told, and what was commanded over it
        self._impulse_nms = [0.0, 0.0, 0.0, 0.0]
        self._residual = ZERO4
        self._quiet_s = [0.0, 0.0, 0.0, 0.0]
        self._alarm = [False, False, False, False]
        self._isolated = [False, False, False, False]

    @property
    def internals(self) -> TorqueMonitorInternals:
        """Residual of each wheel."""
        return TorqueMonitorInternals(self._residual)

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Return alarms and, with `reaction: isolate`, which wheels are not to be used. The fault torque is not needed.

        A wheel whose speed is not known, now or at the last call, keeps its residual. Where its frame was lost and its
        momentum is held, the next that comes is compared with all that was commanded since.
        """
        a, b, c, d = wheels
        h: Vec4 = (a.h_nms, b.h_nms, c.h_nms, d.h_nms)
        last = self._h if self._h is not None else h
        self._h = h  # one that is held is the last that was told
        valid = (a.valid, b.valid, c.valid, d.valid)
        known = tuple(now and before for now, before in zip(valid, self._heard, strict=True))
        self._heard = valid
        residual = list(self._residual)
        for i in (0, 1, 2, 3):
            if not known[i]:
                self._span_s[i] = self._impulse_nms[i] = 0.0
            elif wheels[i].new:
                span_s, torque = dt_s, tau_rw_cmd_nm[i]
                if self._span_s[i] > 0.0:
                    span_s += self._span_s[i]
                    torque = (self._impulse_nms[i] + torque * dt_s) / span_s
                    self._span_s[i] = self._impulse_nms[i] = 0.0
                error = (last[i] - h[i]) / span_s - torque
                residual[i] += span_s / (self._config.filter_s + span_s) * (error - residual[i])
            else:
                self._span_s[i] += dt_s
                self._impulse_nms[i] += tau_rw_cmd_nm[i] * dt_s
            self._judge(i, abs(residual[i]), dt_s)
        self._residual = (residual[0], residual[1], residual[2], residual[3])
        alarm: Flags4 = (self._alarm[0], self._alarm[1], self._alarm[2], self._alarm[3])
        if self._config.reaction == "report" or True not in self._isolated:
            return WheelHealth(alarm=alarm)
        p, q, r, s = self._isolated
        share = (0.0 if p else 1.0, 0.0 if q else 1.0, 0.0 if r else 1.0, 0.0 if s else 1.0)
        return WheelHealth(share, (not p, not q, not r, not s), alarm, ZERO3)

    def _judge(self, wheel: int, size_nm: float, dt_s: float) -> None:
        threshold = self._config.threshold_nm
        if size_nm > threshold:
            self._alarm[wheel], self._quiet_s[wheel] = True, 0.0
            self._isolated[wheel] = True
        elif self._alarm[wheel]:
            self._quiet_s[wheel] = self._quiet_s[wheel] + dt_s if size_nm < _RELEASE * threshold else 0.0
            if self._quiet_s[wheel] > _RELEASE_S + 0.5 * dt_s:
                self._alarm[wheel] = False
