"""Classes of fiber-optic gyros, as the detector knows them: what a healthy one may do."""

from __future__ import annotations

from typing import NamedTuple

from fsw.gyro_fdi.settings import PracticalDetectorConfig


class Fog(NamedTuple):
    """Bounds of a healthy gyro."""

    arw_rad_sqrt_s: float
    lsb_rad: float
    bias_max_rad_s: float
    scale_max: float


# Noise terms are those of the plant's presets of the same names; drift and scale bounds are three of their sigmas.
FOGS = {"tactical": Fog(2.91e-5, 1e-6, 1.5e-5, 1e-3), "space": Fog(5.82e-7, 1e-7, 5e-7, 3e-4)}


def choose_fog(config: PracticalDetectorConfig) -> Fog:
    """Return the class named in the settings, with the terms given beside it instead of its own."""
    preset = FOGS[config.fog]

    def choose(given: float | None, default: float) -> float:
        return default if given is None else given

    return Fog(
        choose(config.gyro_arw_rad_sqrt_s, preset.arw_rad_sqrt_s),
        choose(config.angle_lsb_rad, preset.lsb_rad),
        choose(config.bias_max_rad_s, preset.bias_max_rad_s),
        choose(config.scale_max, preset.scale_max),
    )
