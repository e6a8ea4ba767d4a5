"""Noise terms of classes of gyros, and those in force for a gyro's settings."""

from __future__ import annotations

from dataclasses import dataclass

from bus.units import DEG
from plant_server.config import GyroConfig


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
