"""Wheel health: which wheels give what they are told, for the law and the allocator to reckon with."""

from __future__ import annotations

from fsw.families import WheelHealthMonitor
from fsw.registry import Registry
from fsw.wheel_health.none import NoWheelHealth
from fsw.wheel_health.settings import (
    NoWheelHealthConfig,
    ShareKalmanConfig,
    ShareLearnerConfig,
    TorqueMonitorConfig,
    WheelKalmanConfig,
    WheelKalmanPaperConfig,
)
from fsw.wheel_health.share_kalman import ShareKalman
from fsw.wheel_health.share_learner import ShareLearner
from fsw.wheel_health.torque_monitor import TorqueMonitor
from fsw.wheel_health.wheel_kalman import WheelKalman
from fsw.wheel_health.wheel_kalman_paper import WheelKalmanPaper

REGISTRY: Registry[WheelHealthMonitor] = Registry(
    (NoWheelHealthConfig, NoWheelHealth),
    (ShareKalmanConfig, ShareKalman),
    (ShareLearnerConfig, ShareLearner),
    (TorqueMonitorConfig, TorqueMonitor),
    (WheelKalmanConfig, WheelKalman),
    (WheelKalmanPaperConfig, WheelKalmanPaper),
)
