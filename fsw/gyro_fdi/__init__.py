"""Fault detection: which unit lies, how much, since when, and the rate to fly with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fsw.config import ModelConfig
from fsw.gyro_fdi.none import NoDetector
from fsw.gyro_fdi.practical import PracticalDetector
from fsw.gyro_fdi.wang2010 import Wang2010Detector
from fsw.records import Detector

# kind in the settings -> factory(config, model, tick_s)
REGISTRY: dict[str, Callable[[Any, ModelConfig, float], Detector]] = {
    "none": NoDetector,
    "practical": PracticalDetector,
    "wang2010": Wang2010Detector,
}
