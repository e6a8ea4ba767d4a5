"""Settings of the wheel-health monitors. Data only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Gt, Le, Lt, RadS, Seconds, Unit


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
class ShareKalmanConfig:
    """Share and bias of each wheel's torque by a random-walk Kalman filter; dead wheels are probed: docs/wheel-health.md."""

    kind: Literal["share_kalman"]
    average: Annotated[int, Ge(1), Le(100)] = 2  # control periods whose mean makes one measurement
    command_latency_s: Annotated[Seconds, Ge(0), Le(1)] = 0.0  # that passes until a wheel has its command
    speed_quantum_rad_s: Annotated[RadS, Ge(0)] = 1e-3  # step of the speed telemetry
    torque_noise_nm: Annotated[float, Unit("N m"), Ge(0)] = 5e-4  # of a measured torque, beside those steps; 1 sigma
    share_walk_sqrt_s: Annotated[float, Gt(0)] = 3.16e-3  # how fast a share may wander [1/sqrt(s)]
    bias_walk_sqrt_s: Annotated[float, Gt(0)] = 1e-3  # likewise a bias, in shares of the largest torque
    share_sigma_max: Annotated[float, Gt(0)] = 0.5  # cap of a share's 1 sigma [1], and what the CUSUM opens it to
    bias_sigma_max: Annotated[float, Gt(0)] = 0.2  # likewise of a bias, in shares of the largest torque
    share_sigma_start: Annotated[float, Gt(0)] = 0.0316  # 1 sigma of a share at the start [1]
    bias_sigma_start: Annotated[float, Gt(0)] = 0.01  # likewise of a bias
    share_max: Annotated[float, Ge(1)] = 1.05  # largest share that is believed [1]
    cusum_drift: Annotated[float, Gt(0)] = 3.0  # taken off r^2/S at every measurement; a sound wheel's mean is 1
    cusum_jump: Annotated[float, Gt(0)] = 12.0  # a sum of this opens the covariance
    share_dead_band: Annotated[float, Ge(0), Le(0.5)] = 0.01  # a share this close to 1 is taken for 1
    bias_dead_band: Annotated[float, Ge(0), Le(0.5)] = 0.002  # a bias below it for 0, in shares of the largest torque
    alarm_share: Annotated[float, Gt(0), Le(1)] = 0.1  # a share further below 1 than this (and 3 sigma) is an alarm
    alarm_bias: Annotated[float, Gt(0), Le(1)] = 0.05  # likewise a bias, in shares of the largest torque
    dead_below: Annotated[float, Ge(0), Lt(1)] = 0.1  # a wheel with a smaller share is dead, 0: none ever is ...
    dead_sigma: Annotated[float, Gt(0)] = 0.1  # ... once the share's 1 sigma is below this
    dead_after_s: Annotated[Seconds, Gt(0)] = 1.0  # ... or once it has been so small for this long
    alive_above: Annotated[float, Gt(0), Lt(1)] = 0.3  # and until its share is above this
    probe_nm: Annotated[float, Unit("N m"), Ge(0)] = 0.004  # square wave that dead wheels are told; 0: none
    dither: Literal["off", "alarm", "always"] = "alarm"  # square wave in the null space; alarm: while a wheel has one
    dither_nm: Annotated[float, Unit("N m"), Ge(0)] = 0.004  # of the wheel that gets most of it
    wave_period_s: Annotated[Seconds, Gt(0)] = 1.6  # of both waves
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
