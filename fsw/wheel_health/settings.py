"""Settings of the wheel-health monitors. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Gt, Seconds, Unit


@dataclass(frozen=True, slots=True, kw_only=True)
class NoWheelHealthConfig:
    """Every wheel is taken to be healthy."""

    kind: Literal["none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShareLearnerConfig:
    """Shares of their commands that the wheels deliver, learnt by a normalised gradient from the observer's fault torque."""

    kind: Literal["share_learner"]
    learn_s: Annotated[Seconds, Gt(0)] = 0.28  # time constant of learning, at full torque
    observer_lag_s: Annotated[Seconds, Gt(0)] = 0.3  # time constant of the observer that reports the fault torque


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueMonitorConfig:
    """An alarm for every wheel whose torque, from its speed, is not what was commanded."""

    kind: Literal["torque_monitor"]
    threshold_nm: Annotated[float, Unit("N m"), Gt(0)] = 0.01  # residual that is a fault
    filter_s: Annotated[Seconds, Gt(0)] = 1.0  # time constant of the low pass that the residual goes through
    reaction: Literal["report", "isolate"] = (
        "isolate"  # isolate: a wheel with an alarm is switched off and not used again
    )
