"""Wheel alarms: torque that a wheel gave, from its own speed, against torque it was told to give."""

from __future__ import annotations

from bus.units import Vec4

Flags4 = tuple[bool, bool, bool, bool]  # one per wheel
_ZERO: Vec4 = (0.0, 0.0, 0.0, 0.0)
_RELEASE = 0.5  # an alarm ends once the residual is below this part of the threshold ...
_RELEASE_S = 5.0  # ... for this long


class WheelMonitor:
    """r_W,i = low-passed (-dh_i/dt - commanded torque), one per wheel. A gyro fault cannot reach it."""

    def __init__(self, tick_s: float, threshold_nm: float, filter_s: float) -> None:
        """tick_s: period between calls [s]; threshold_nm: residual that is a fault [N m]."""
        self._tick_s = tick_s
        self._threshold = threshold_nm
        self._gain = tick_s / (filter_s + tick_s)
        self._release_ticks = round(_RELEASE_S / tick_s)
        self.reset()

    def reset(self) -> None:
        """Forget momentum and alarms."""
        self._h: Vec4 | None = None
        self.residual_nm: Vec4 = _ZERO
        self._quiet = [0, 0, 0, 0]
        self._alarm = [False, False, False, False]

    def step(self, h_rw_nms: Vec4, tau_rw_cmd_nm: Vec4, valid: Flags4) -> Flags4:
        """Return the alarm of each wheel, given momentum now and mean torque commanded over the tick that ends now.

        A wheel whose speed is not known keeps its residual.
        """
        last = self._h if self._h is not None else h_rw_nms
        self._h = h_rw_nms
        residual = list(self.residual_nm)
        for i in (0, 1, 2, 3):
            if valid[i]:
                error = (last[i] - h_rw_nms[i]) / self._tick_s - tau_rw_cmd_nm[i]
                residual[i] += self._gain * (error - residual[i])
            size = abs(residual[i])
            if size > self._threshold:
                self._alarm[i], self._quiet[i] = True, 0
            elif self._alarm[i]:
                self._quiet[i] = self._quiet[i] + 1 if size < _RELEASE * self._threshold else 0
                if self._quiet[i] > self._release_ticks:
                    self._alarm[i] = False
        self.residual_nm = (residual[0], residual[1], residual[2], residual[3])
        a, b, c, d = self._alarm
        return (a, b, c, d)
