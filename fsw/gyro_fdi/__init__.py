"""Gyro fault detection: which axis lies, how much, since when, and the rate to fly with."""

from __future__ import annotations

from fsw.families import Detector, Registry
from fsw.gyro_fdi.none import NoDetector, NoDetectorConfig
from fsw.gyro_fdi.practical import PracticalDetector
from fsw.gyro_fdi.practical_settings import PracticalDetectorConfig
from fsw.gyro_fdi.wang2010 import Wang2010Detector, Wang2010DetectorConfig

REGISTRY: Registry[Detector] = Registry(
    (NoDetectorConfig, NoDetector),
    (Wang2010DetectorConfig, Wang2010Detector),
    (PracticalDetectorConfig, PracticalDetector),
)
