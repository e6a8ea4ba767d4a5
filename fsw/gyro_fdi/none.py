"""No fault detection: the estimate passes through, and the rate is good as long as every gyro axis is."""

from __future__ import annotations

from typing import NamedTuple

from bus.units import Vec3, Vec4
from fsw.config import ModelConfig, NoDetectorConfig
from fsw.records import Detection, Estimate, Sensors

ZERO: Vec3 = (0.0, 0.0, 0.0)
NO_WHEEL_ALARM = (False, False, False, False)


class NoInternals(NamedTuple):
    """Nothing to show."""


class NoDetector:
    """Passes the estimate through."""

    internals = NoInternals()

    def __init__(self, config: NoDetectorConfig, model: ModelConfig, tick_s: float) -> None:
        pass

    def reset(self) -> None:
        """Nothing is held."""

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """Return the estimate unchanged."""
        rate_good = False not in sensors.gyro_valid
        return tuple.__new__(Detection, (estimate, ZERO, (0, 0, 0), NO_WHEEL_ALARM, ZERO, False, rate_good))
