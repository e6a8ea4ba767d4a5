"""Wheel health: which wheels give what they are told, for the law and the allocator to reckon with."""

from __future__ import annotations

from fsw.families import WheelHealthMonitor
from fsw.registry import Registry
from fsw.wheel_health.none import NoWheelHealth
from fsw.wheel_health.settings import NoWheelHealthConfig, ShareLearnerConfig, TorqueMonitorConfig
from fsw.wheel_health.share_learner import ShareLearner
from fsw.wheel_health.torque_monitor import TorqueMonitor

REGISTRY: Registry[WheelHealthMonitor] = Registry(
    (NoWheelHealthConfig, NoWheelHealth),
    (ShareLearnerConfig, ShareLearner),
    (TorqueMonitorConfig, TorqueMonitor),
)
