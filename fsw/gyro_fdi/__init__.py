"""Gyro fault detection: which axis lies, how much, since when, and the rate to fly with."""

from __future__ import annotations

from fsw.families import Detector
from fsw.gyro_fdi.none import NoDetector
from fsw.gyro_fdi.practical import PracticalDetector
from fsw.gyro_fdi.settings import NoDetectorConfig, PracticalDetectorConfig, Wang2010DetectorConfig
from fsw.gyro_fdi.wang2010 import Wang2010Detector
from fsw.registry import Registry

REGISTRY: Registry[Detector] = Registry(
    (NoDetectorConfig, NoDetector),
    (Wang2010DetectorConfig, Wang2010Detector),
    (PracticalDetectorConfig, PracticalDetector),
)
