"""State of one gyro axis: nominal, suspect, in alarm, classified, and back when it has healed."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

_QUICK_S: Final = 0.3  # low pass of the fault estimate that rate steps are taken from
_POWER_CAP: Final = 10.0  # times the healthy limit: a large fault is not remembered longer than a small one
_HEALTHY_EXCESS: Final = 1.3  # a healed axis may show this much of the gyro's white noise power


class AxisState(IntEnum):
    """As `Detection.gyro_state` carries it."""

    NOMINAL = 0
    SUSPECT = 1
    ALARM = 2
    CLASSIFIED = 3


class AxisRecovery:
    """Decides when an axis is replaced and when it may return."""

    def __init__(
        self, cycle_s: float, arw_rad_sqrt_s: float, clear_rad_s: float, clear_filter_s: float, clear_after_s: float
    ) -> None:
        """clear_rad_s: fault estimate, root mean square, below which an axis counts as healed [rad/s]."""
        self._quick = min(1.0, cycle_s / _QUICK_S)
        self._slow = min(1.0, cycle_s / clear_filter_s)
        self._clear_power = clear_rad_s**2 + _HEALTHY_EXCESS * arw_rad_sqrt_s**2 / cycle_s
        self._clear_cycles = max(1, round(clear_after_s / cycle_s))
        self.reset()

    def reset(self) -> None:
        """Nominal, nothing remembered."""
        self.state = AxisState.NOMINAL
        self.alarm_t_s = self.onset_t_s = -1.0  # -1: never
        self.step_rad_s = 0.0  # low-passed fault estimate up to the previous cycle
        self.suspect_cycles = 0
        self._suspect_t_s = -1.0
        self._power = 0.0
        self._healthy_cycles = 0
        self._next_step = 0.0

    @property
    def in_alarm(self) -> bool:
        """Whether the gyro of this axis is out of use until it heals."""
        return self.state >= AxisState.ALARM

    def observe(self, fault_hat_rad_s: float) -> None:
        """Take in the fault estimate of this cycle [rad/s]."""
        self.step_rad_s = self._next_step
        self._next_step += self._quick * (fault_hat_rad_s - self._next_step)
        power = self._power + self._slow * (fault_hat_rad_s * fault_hat_rad_s - self._power)
        self._power = min(power, _POWER_CAP * self._clear_power)

    @property
    def quick_mean_rad_s(self) -> float:
        """Fault estimate low-passed over 0.3 s, this cycle included [rad/s]."""
        return self._next_step

    def decide(self, t_s: float, suspect: bool, alarm: bool, dead: bool, classified: bool, window_s: float) -> bool:
        """Move to the state of this cycle; return whether an alarm was raised at it.

        window_s: how far the evidence reaches back [s], for the onset where the axis was not suspect before
        """
        self.suspect_cycles = self.suspect_cycles + 1 if suspect else 0
        if self.suspect_cycles == 1:
            self._suspect_t_s = t_s
        if not self.in_alarm:
            if alarm or dead:
                self.state = AxisState.ALARM
                self.alarm_t_s = t_s
                self.onset_t_s = self._suspect_t_s if suspect else max(0.0, t_s - window_s)
                self._healthy_cycles = 0
                self._power = max(self._power, self._clear_power)
                return True
            self.state = AxisState.SUSPECT if suspect else AxisState.NOMINAL
            return False
        healthy = not dead and not alarm and self._power < self._clear_power
        self._healthy_cycles = self._healthy_cycles + 1 if healthy else 0
        if self._healthy_cycles >= self._clear_cycles:
            self.state = AxisState.NOMINAL
        elif classified:
            self.state = AxisState.CLASSIFIED
        return False
