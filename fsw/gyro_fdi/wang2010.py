"""The detector of Wang, Li & Ma 2010: one observer, its residual against a threshold. Selectable, for comparison.

Differs from the paper: `ts_a` takes its known premise from the star tracker and wheel speeds, as no flight software
knows the true rate; wheel momentum is counted where the model says so; threshold and isolation rule are ours.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from bus.attitude import normalise
from bus.linear import ZERO3, subtract
from bus.units import Vec3, Vec4
from fsw.families import Detector
from fsw.gyro_fdi.momentum_filter import MomentumFilter
from fsw.gyro_fdi.observers import GyroObserver
from fsw.gyro_fdi.settings import Wang2010DetectorConfig
from fsw.records import Detection, Estimate, Sensors
from fsw.rotation import turn
from fsw.vehicle import Vehicle

_PREMISE_BANDWIDTH_RAD_S: Final = 0.6


class Wang2010Internals(NamedTuple):
    """Residual and flags of the last tick, three values per axis."""

    residual_b_rad_s: Vec3
    omega_hat_b_rad_s: Vec3
    premise_out_of_range: int
    alarm_t_s: Vec3  # -1: never


class Wang2010Detector(Detector):
    """Residual of one gyro observer driven by the torque commanded. Implements `fsw.families.Detector`."""

    def __init__(self, config: Wang2010DetectorConfig, vehicle: Vehicle, tick_s: float) -> None:
        """tick_s: period between calls of `step` [s]. Raises DesignError where there is no stable design for it."""
        self._config = config
        self._tick_s = tick_s
        self._wheel_momentum = vehicle.wheel_momentum
        self._wheels = vehicle.wheels
        self._observer = GyroObserver(config.observer, vehicle.inertia_kgm2, tick_s, config.static_gain_rad_s)
        self._premise = MomentumFilter(vehicle.inertia_kgm2, _PREMISE_BANDWIDTH_RAD_S, vehicle.wheel_momentum)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next valid gyro sample starts the observer again."""
        self._started = False
        self._observer.reset(ZERO3)
        self._premise.reset()
        self._residual = ZERO3
        self._counts = [0, 0, 0]
        self._alarm_t_s = [-1.0, -1.0, -1.0]

    @property
    def internals(self) -> Wang2010Internals:
        """Residual and flags of the last tick."""
        a, b, c = self._alarm_t_s
        observer = self._observer
        return Wang2010Internals(
            self._residual, observer.omega_hat_b_rad_s, int(observer.premise_out_of_range), (a, b, c)
        )

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """Return the estimate, corrected where recovery is on [rad/s], and the axes beyond the threshold."""
        y, h_b = sensors.omega_meas_b_rad_s, self._wheels.combine(sensors.wheel_momenta())
        if not self._started:
            if estimate.valid:
                self._started = True
                self._observer.reset(y)
            return Detection(estimate, ZERO3, (0, 0, 0), ZERO3, False, False not in sensors.gyro_valid)
        premise = self._follow_premise(sensors, h_b) if self._config.observer == "ts_a" else None
        momentum = h_b if self._wheel_momentum else ZERO3
        self._residual = r = self._observer.step(y, self._wheels.combine(tau_rw_cmd_nm), momentum, premise)
        state = self._judge(sensors.t_s)
        fault = (r[0] if state[0] else 0.0, r[1] if state[1] else 0.0, r[2] if state[2] else 0.0)
        if self._config.recovery == "on":
            rate = subtract(estimate.omega_bi_b_rad_s, fault)
            estimate = Estimate(estimate.q_ib, rate, estimate.bias_b_rad_s, estimate.valid)
        # Taking the fault off leaves the rate where it was before: no step for the observers behind.
        return Detection(estimate, ZERO3, state, fault, False, False not in sensors.gyro_valid)

    def _judge(self, t_s: float) -> tuple[int, int, int]:
        """State of each axis: 0 nominal, 2 alarm."""
        states = []
        for axis, residual in enumerate(self._residual):
            beyond = abs(residual) > self._config.threshold_rad_s
            self._counts[axis] = self._counts[axis] + 1 if beyond else 0
            alarm = self._counts[axis] >= self._config.debounce_ticks
            if alarm and self._alarm_t_s[axis] < 0.0:
                self._alarm_t_s[axis] = t_s
            states.append(2 if alarm else 0)
        return (states[0], states[1], states[2])

    def _follow_premise(self, sensors: Sensors, h_b: Vec3) -> Vec3 | None:
        """Rate known without the gyro; None (the observer's own) before the first star-tracker frame."""
        premise, late_s = self._premise, sensors.star_age_s
        if not premise.started:
            if not sensors.star_new:
                return None
            premise.start(normalise(sensors.q_ib_meas), self._observer.omega_hat_b_rad_s, h_b)
            return premise.omega_bi_b_rad_s
        premise.propagate(h_b, self._tick_s)
        if sensors.star_new:
            x, y, z = premise.omega_bi_b_rad_s
            premise.correct(turn(normalise(sensors.q_ib_meas), x * late_s, y * late_s, z * late_s))
        return premise.omega_bi_b_rad_s
