"""No fault detection: the estimate passes through, and the rate is good as long as every gyro axis is."""

from __future__ import annotations

from bus.linear import ZERO3
from bus.units import Vec4
from fsw.families import Detector
from fsw.gyro_fdi.settings import NoDetectorConfig
from fsw.records import Detection, Estimate, Sensors
from fsw.vehicle import Vehicle


class NoDetector(Detector):
    """Passes the estimate through."""

    def __init__(self, config: NoDetectorConfig, vehicle: Vehicle, tick_s: float) -> None:
        """Nothing of these is needed."""

    def reset(self) -> None:
        """Nothing is held."""

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """Return the estimate unchanged."""
        return Detection(estimate, ZERO3, (0, 0, 0), ZERO3, False, False not in sensors.gyro_valid)
