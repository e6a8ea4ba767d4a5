"""Settings of the wheel-health monitors. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, RadS, Seconds, Unit


@dataclass(frozen=True, slots=True, kw_only=True)
class NoWheelHealthConfig:
    """Every wheel is taken to be healthy."""

    kind: Literal["none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShareLearnerConfig:
    """Shares of their commands that the wheels deliver, learnt by a normalised gradient from the observer's fault torque."""

    kind: Literal["share_learner"]
    learn_s: Annotated[Seconds, Gt(0)] = 0.2  # time constant of learning, at full torque
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


TorqueSetting = Annotated[float, Unit("N m"), Gt(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelKalmanConfig:
    """Driver, torque deficit and rotor of each wheel by Kalman filters, from its telemetry: docs/wheel-health.md."""

    kind: Literal["wheel_kalman"]
    current_noise_a: Annotated[float, Unit("A"), Gt(0)] = 1e-3  # of the telemetry, 1 sigma
    speed_noise_rad_s: Annotated[RadS, Gt(0)] = 0.05
    command_latency_s: Annotated[Seconds, Ge(0)] = 0.0  # that passes until a wheel has its command
    deficit_walk_nm_sqrt_s: Annotated[float, Gt(0)] = 2e-4  # how fast a torque deficit may wander [N m/sqrt(s)]
    deficit_threshold_nm: TorqueSetting = 6e-4  # a deficit beyond it ...
    deficit_alarm_s: Annotated[Seconds, Gt(0)] = 0.5  # ... for this long is an alarm
    driver_threshold: Annotated[float, Gt(0), Le(1)] = 0.03  # a driver gain further from 1 than this (and 5 sigma) ...
    driver_alarm_s: Annotated[Seconds, Gt(0)] = 0.2  # ... for this long is an alarm
    release_s: Annotated[Seconds, Gt(0)] = 5.0  # an alarm ends after so long without half of what gave it
    gain_sigma: Annotated[float, Gt(0)] = 0.05  # gain and friction are told apart once sigma of the gain is below it
    odds: Annotated[float, Gt(1)] = 20.0  # and once one is this much likelier than the other
    # report: nobody acts; compensate: shares for the allocator; isolate: and what is seized, runaway or dead is switched off
    reaction: Literal["report", "compensate", "isolate"] = "isolate"
    observer_lag_s: Annotated[Seconds, Gt(0)] = 0.3  # time constant of the observer that reports the fault torque
    silent_s: Annotated[Seconds, Gt(0)] = (
        5.0  # a wheel without telemetry for this long is switched off until it is heard
    )
    retry_s: Annotated[Seconds, Gt(0)] = 60.0  # a wheel that was switched off is tried again after this long ...
    retries: Annotated[int, Ge(0)] = 3  # ... so many times in a row
    dither: bool = False  # ask for a torque in the wheels' null space when a fault cannot be told apart
    dither_nm: TorqueSetting = 0.005  # of the wheel in doubt
    dither_period_s: Annotated[Seconds, Gt(0)] = 60.0
    dither_s: Annotated[Seconds, Gt(0)] = 60.0  # for how long at most


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelKalmanPaperConfig:
    """The paper's filter of current and speed; its residual gives an alarm and no cause."""

    kind: Literal["wheel_kalman_paper"]
    model: Literal["current", "voltage"] = (
        "current"  # what drives the motor: a current driver, or a voltage on its winding
    )
    resistance_ohm: Annotated[float, Unit("ohm"), Gt(0)] = 2.0  # of the winding, R_A; for `voltage`
    inductance_h: Annotated[float, Unit("H"), Gt(0)] = 0.02  # L_A
    current_noise_a: Annotated[float, Unit("A"), Gt(0)] = 1e-3
    speed_noise_rad_s: Annotated[RadS, Gt(0)] = 0.05
    filter_s: Annotated[Seconds, Gt(0)] = 2.0  # time constant of the low pass that the residuals go through
    threshold_sigma: Annotated[float, Gt(0)] = 6.0  # residual that is a fault, in sigmas of a sound wheel's
    alarm_s: Annotated[Seconds, Gt(0)] = 0.5  # for this long
    release_s: Annotated[Seconds, Gt(0)] = 5.0
