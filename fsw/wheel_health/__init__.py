"""Wheel health: which wheels give what they are told, for the law and the allocator to reckon with."""

from __future__ import annotations

from fsw.families import Registry, WheelHealthMonitor
from fsw.wheel_health.none import NoWheelHealth, NoWheelHealthConfig
from fsw.wheel_health.share_learner import ShareLearner, ShareLearnerConfig
from fsw.wheel_health.torque_monitor import TorqueMonitor, TorqueMonitorConfig

REGISTRY: Registry[WheelHealthMonitor] = Registry(
    (NoWheelHealthConfig, NoWheelHealth),
    (ShareLearnerConfig, ShareLearner),
    (TorqueMonitorConfig, TorqueMonitor),
)
