"""The detector that flies: gyro faults told from everything else, the lying axis replaced, and given back when it heals.

Built from the parts beside it: gyro-less rate (momentum_filter), kinematic parity (parity), physical bounds
(plausibility), the torque observer for when the star tracker is away (observers, isolation), state of each axis
(recovery), kind and size of a fault (classification). See docs/gyro-fdi.md.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

from bus.attitude import conjugate, log_map, multiply, normalise
from bus.linear import ZERO3
from bus.units import Vec3, Vec4
from fsw.families import Detector
from fsw.gyro_fdi.classification import Classifier, FaultKind, Verdict
from fsw.gyro_fdi.cycle_inputs import CycleCollector, CycleInputs
from fsw.gyro_fdi.fog import choose_fog
from fsw.gyro_fdi.gyro_stellar import GyroStellarFilter
from fsw.gyro_fdi.isolation import ModelErrorBound
from fsw.gyro_fdi.momentum_filter import MomentumFilter
from fsw.gyro_fdi.observers import GyroObserver
from fsw.gyro_fdi.parity import Frame, Healthy, Mark, Parity, interpolate
from fsw.gyro_fdi.plausibility import Plausibility, bound_acceleration
from fsw.gyro_fdi.recovery import AxisRecovery, AxisState
from fsw.gyro_fdi.settings import PracticalDetectorConfig
from fsw.records import Detection, Estimate, Sensors
from fsw.rotation import turn
from fsw.vehicle import Vehicle

_ARCSEC: Final = math.pi / 648000.0
_ACCELERATION_MARGIN: Final = 1.35
_HISTORY_S: Final = 1.5  # longest star-tracker latency that is bridged
_SUSPECT_ALARM_RAD_S: Final = 3e-3  # without star tracker: fault estimate that turns a suspect axis into an alarm ...
_SUSPECT_ALARM_AFTER_S: Final = 1.0  # ... after this long
_AGREED_BIAS_RAD_S: Final = 3e-5  # estimator and the detector's own filter tell the same
_AGREED_ATTITUDE_RAD: Final = 1e-3
_AGREE_FOR_S: Final = 10.0
_BLIND_FACTOR: Final = 10.0  # past this many times safe_after_s without gyro and stars not even damping is safe


class PracticalInternals(NamedTuple):
    """What the detector sees, for telemetry. Three values are per axis."""

    fault_kind: Vec3  # FaultKind
    fault_magnitude_rad_s: Vec3  # constant: signed value; periodic: amplitude
    fault_frequency_rad_s: Vec3
    fault_confidence: Vec3  # 0 .. 1
    onset_t_s: Vec3  # estimate; -1: never
    alarm_t_s: Vec3
    residual_kinetic_b_rad_s: Vec3  # gyro - bias - gyro-less rate
    residual_observer_b_rad_s: Vec3  # gyro - bias - torque observer
    omega_gyroless_b_rad_s: Vec3
    bias_b_rad_s: Vec3
    parity_worst_sigma: float
    star_glitches: int
    premise_out_of_range: int
    estimator_used: int  # 1: the estimate handed on is the estimator's, 0: the detector's own


class PracticalDetector(Detector):
    """Detector of gyro faults with recovery. Implements `fsw.families.Detector`."""

    def __init__(self, config: PracticalDetectorConfig, vehicle: Vehicle, tick_s: float) -> None:
        """tick_s: period between calls of `step` [s]. Raises DesignError where the observer has no stable design."""
        ticks = max(1, round(config.cycle_s / tick_s))
        self._tick_s, self._cycle_s = tick_s, ticks * tick_s
        self._config = config
        self._wheels = vehicle.wheels
        self._recover = config.recovery == "on"
        self._wheel_momentum = vehicle.wheel_momentum
        inertia, cycle_s = vehicle.inertia_kgm2, self._cycle_s
        fog = choose_fog(config)
        arw = fog.arw_rad_sqrt_s
        a, b, c = config.star_noise_arcsec
        healthy = Healthy(arw, fog.bias_max_rad_s, fog.scale_max, (a * _ARCSEC, b * _ARCSEC, c * _ARCSEC))
        acceleration = config.acceleration_max_rad_s2
        if acceleration is None:
            acceleration = _ACCELERATION_MARGIN * bound_acceleration(vehicle)
        self._collector = CycleCollector(tick_s, ticks)
        self._gyroless = MomentumFilter(inertia, config.filter_rate_rad_s, vehicle.wheel_momentum)
        self._stellar = GyroStellarFilter()
        self._parity = Parity(healthy, config.parity_windows_s, tick_s, config.parity_sigma, config.suspect_sigma)
        self._plausibility = Plausibility(cycle_s, acceleration, arw, fog.lsb_rad, config.suspect_s)
        self._observer = GyroObserver(config.observer, inertia, cycle_s, config.static_gain_rad_s)
        self._bound = ModelErrorBound(inertia, cycle_s, config.static_gain_rad_s, config.observer_threshold_rad_s)
        self._axes = tuple(
            AxisRecovery(cycle_s, arw, config.clear_threshold_rad_s, config.clear_filter_s, config.clear_after_s)
            for _ in range(3)
        )
        self._classifiers = tuple(Classifier(cycle_s, config.classify_after_s, fog.bias_max_rad_s) for _ in range(3))
        self._marks: deque[Mark] = deque(maxlen=max(2, round(_HISTORY_S / cycle_s)))
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next star-tracker frame starts the detector again."""
        self._collector.reset()
        self._gyroless.reset()
        self._stellar.reset()
        self._parity.reset()
        self._plausibility.reset()
        self._bound.reset()
        for axis in self._axes:
            axis.reset()
        for classifier in self._classifiers:
            classifier.start()
        self._observer.reset(ZERO3)
        self._marks.clear()
        self._h_b = ZERO3
        self._star_tick = 0
        self._r1 = self._r2 = self._y = ZERO3
        self._replaced = (False, False, False)
        self._agreed_cycles = 0
        self._trusts_estimator = False
        self._estimate: Estimate | None = None
        self._fresh_frame: Frame | None = None
        self._coasting_s = 0.0

    @property
    def internals(self) -> PracticalInternals:
        """Findings and residuals of the last cycle."""
        a, b, c = self._axes
        verdicts = [self._read_verdict(axis) for axis in (0, 1, 2)]
        p, q, r = verdicts
        return PracticalInternals(
            (float(p.kind), float(q.kind), float(r.kind)),
            (p.magnitude_rad_s, q.magnitude_rad_s, r.magnitude_rad_s),
            (p.frequency_rad_s, q.frequency_rad_s, r.frequency_rad_s),
            (p.confidence, q.confidence, r.confidence),
            (a.onset_t_s, b.onset_t_s, c.onset_t_s),
            (a.alarm_t_s, b.alarm_t_s, c.alarm_t_s),
            self._r2,
            self._r1,
            self._gyroless.omega_bi_b_rad_s,
            self._stellar.bias_b_rad_s,
            self._parity.worst,
            self._gyroless.glitches,
            int(self._observer.premise_out_of_range),
            int(self._trusts_estimator),
        )

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """Return the estimate to fly with [rad/s] and what was found, at this tick.

        Detection runs once a cycle (`cycle_s`); on ticks between, the estimate is carried forward.
        """
        cycle = self._collector.add(sensors, tau_rw_cmd_nm)
        if not self._gyroless.started:
            if sensors.star_new:
                self._start(sensors)
            return self._pass_through(sensors, estimate, ZERO3)
        self._y = sensors.omega_meas_b_rad_s
        step = ZERO3
        if cycle is not None:
            step = self._run(cycle, estimate)
        if not self._recover:
            return self._pass_through(sensors, estimate, ZERO3)
        return self._hand_on(cycle is not None, estimate, step)

    # -- one detection cycle -------------------------------------------------------------------------------------

    def _run(self, cycle: CycleInputs, estimate: Estimate) -> Vec3:
        """Filters, residuals, decisions; return the step of the rate source [rad/s]."""
        dt_s, y = cycle.dt_s, cycle.rate_b_rad_s
        h_b = self._wheels.combine(cycle.h_rw_nms)
        gyroless, b = self._gyroless, self._stellar.bias_b_rad_s
        gyroless.propagate(h_b, dt_s)
        x, yy, z = y[0] - b[0], y[1] - b[1], y[2] - b[2]
        self._stellar.propagate((x * dt_s, yy * dt_s, z * dt_s))
        suspect = self._plausibility.step(y)
        wx, wy, wz = w = gyroless.omega_bi_b_rad_s
        i, j, k = self._axes
        tested = (wx if i.in_alarm else x, wy if j.in_alarm else yy, wz if k.in_alarm else z)
        self._parity.integrate(tested, w, dt_s)
        self._marks.append(self._parity.mark(cycle.tick))
        self._predict_observer(h_b, dt_s, y)
        alarm, window_s = (False, False, False), 0.0
        if cycle.star_q is not None:
            alarm, window_s = self._use_star(cycle.star_q, cycle.star_tick, suspect)
        w, b = gyroless.omega_bi_b_rad_s, self._stellar.bias_b_rad_s
        self._r2 = r2 = (y[0] - b[0] - w[0], y[1] - b[1] - w[1], y[2] - b[2] - w[2])
        i.observe(r2[0])
        j.observe(r2[1])
        k.observe(r2[2])
        bound = self._bound.bound(cycle.h_rw_nms, w)
        if gyroless.since_frame_s > self._config.star_lost_after_s:
            self._coasting_s = self._coasting_s + dt_s if i.in_alarm or j.in_alarm or k.in_alarm else 0.0
            alarm = self._judge_without_star(bound, suspect)
            self._lean_on_gyro(r2, suspect, cycle.gyro_valid, dt_s)
        else:
            self._coasting_s = 0.0
            r1 = self._r1
            self._bound.learn((r1[0] - r2[0], r1[1] - r2[1], r1[2] - r2[2]), bound)
        return self._decide(cycle, suspect, alarm, window_s, estimate)

    def _use_star(
        self, q_st: Vec4, tick: int, suspect: tuple[bool, bool, bool]
    ) -> tuple[tuple[bool, bool, bool], float]:
        """Correct both filters with a frame, test parity; return alarms and the length of the window that gave them."""
        mark = self._find_mark(tick)
        if mark is None:
            return (False, False, False), 0.0
        q_st = normalise(q_st)
        now = self._marks[-1]
        i, j, k = self._axes
        excluded = (i.in_alarm, j.in_alarm, k.in_alarm)
        p, q = mark.coast_rad, now.coast_rad
        accepted = self._gyroless.correct(turn(q_st, q[0] - p[0], q[1] - p[1], q[2] - p[2]))
        if accepted and not (excluded[0] or excluded[1] or excluded[2]):
            by_gyro = multiply(conjugate(mark.q_g), now.q_g) if mark is not now else (1.0, 0.0, 0.0, 0.0)
            self._stellar.correct(multiply(q_st, by_gyro), (tick - self._star_tick) * self._tick_s)
        self._star_tick = tick
        frame = Frame(q_st, mark)
        hits = self._parity.test(frame, suspect, excluded)
        if not hits:
            return (False, False, False), 0.0
        self._fresh_frame = frame if mark is now else None
        axes = {hit.axis for hit in hits}
        return (0 in axes, 1 in axes, 2 in axes), hits[0].window_s

    def _find_mark(self, tick: int) -> Mark | None:
        """Gyro integration at a tick, between the marks around it; None where it is older than the history."""
        marks = self._marks
        if tick >= marks[-1].tick:
            return marks[-1]
        after = marks[-1]
        for index in range(len(marks) - 2, -1, -1):
            before = marks[index]
            if before.tick <= tick:
                return interpolate(before, after, tick)
            after = before
        return None

    def _predict_observer(self, h_b: Vec3, dt_s: float, y: Vec3) -> None:
        """Residual of the torque observer, with the torque that the wheels really gave, from their speeds."""
        h0, self._h_b = self._h_b, h_b
        tau = ((h0[0] - h_b[0]) / dt_s, (h0[1] - h_b[1]) / dt_s, (h0[2] - h_b[2]) / dt_s)
        b = self._stellar.bias_b_rad_s
        x = self._observer.predict(tau, h_b if self._wheel_momentum else ZERO3)
        self._r1 = r1 = (y[0] - b[0] - x[0], y[1] - b[1] - x[1], y[2] - b[2] - x[2])
        replaced = self._replaced
        if replaced[0] or replaced[1] or replaced[2]:
            w = self._gyroless.omega_bi_b_rad_s
            stars = self._gyroless.since_frame_s <= self._config.star_lost_after_s
            away = (w[0] - x[0], w[1] - x[1], w[2] - x[2]) if stars else ZERO3
            r1 = (
                away[0] if replaced[0] else r1[0],
                away[1] if replaced[1] else r1[1],
                away[2] if replaced[2] else r1[2],
            )
        self._observer.correct(r1)

    def _judge_without_star(self, bound: Vec3, suspect: tuple[bool, bool, bool]) -> tuple[bool, bool, bool]:
        beyond = self._bound.count(self._r1, bound)
        confirm = _SUSPECT_ALARM_AFTER_S / self._cycle_s
        out = []
        for axis, recovery in enumerate(self._axes):
            stays = suspect[axis] and recovery.suspect_cycles >= confirm
            out.append(beyond[axis] or (stays and abs(recovery.quick_mean_rad_s) > _SUSPECT_ALARM_RAD_S))
        return (out[0], out[1], out[2])

    def _lean_on_gyro(
        self, r2: Vec3, suspect: tuple[bool, bool, bool], valid: tuple[bool, bool, bool], dt_s: float
    ) -> None:
        """Without a star tracker the good gyro axes hold the gyro-less rate; the others coast on the wheels."""
        i, j, k = self._axes
        self._gyroless.follow_gyro(
            (
                r2[0] if valid[0] and not suspect[0] and not i.in_alarm else 0.0,
                r2[1] if valid[1] and not suspect[1] and not j.in_alarm else 0.0,
                r2[2] if valid[2] and not suspect[2] and not k.in_alarm else 0.0,
            ),
            dt_s,
        )

    # -- decisions -------------------------------------------------------------------------------------------------

    def _decide(
        self,
        cycle: CycleInputs,
        suspect: tuple[bool, bool, bool],
        alarm: tuple[bool, bool, bool],
        window_s: float,
        estimate: Estimate,
    ) -> Vec3:
        """Move every axis to its state, look at faults, choose the estimate; return the step of the rate source."""
        t_s = cycle.tick * self._tick_s
        step, was = [0.0, 0.0, 0.0], self._replaced
        raised = False
        for axis, recovery in enumerate(self._axes):
            classifier = self._classifiers[axis]
            dead = not cycle.gyro_valid[axis]
            classified = dead or (recovery.in_alarm and classifier.verdict.kind != FaultKind.NONE)
            if recovery.decide(t_s, suspect[axis], alarm[axis], dead, classified, window_s):
                raised = True
                classifier.start()
            elif recovery.in_alarm and not dead:
                classifier.add(self._r2[axis])
            now = recovery.state != AxisState.NOMINAL
            if now != was[axis]:
                step[axis] = -recovery.step_rad_s if now else recovery.step_rad_s
        i, j, k = self._axes
        self._replaced = now3 = (i.state > 0, j.state > 0, k.state > 0)
        if raised:
            self._parity.flush(self._fresh_frame)
        self._fresh_frame = None
        if (was[0] or was[1] or was[2]) and not (now3[0] or now3[1] or now3[2]):
            self._stellar.q_ib = self._gyroless.q_ib
        self._judge_estimator(estimate)
        return (step[0], step[1], step[2])

    def _judge_estimator(self, estimate: Estimate) -> None:
        """The estimator's estimate is used while it agrees with the detector's own filter and no axis is replaced.

        An estimator that follows the gyro learns a fault as bias; it must unlearn it before it is used again.
        """
        q = log_map(multiply(conjugate(self._stellar.q_ib), estimate.q_ib))
        b, c = estimate.bias_b_rad_s, self._stellar.bias_b_rad_s
        agrees = (
            estimate.valid
            and not (self._replaced[0] or self._replaced[1] or self._replaced[2])
            and max(abs(q[0]), abs(q[1]), abs(q[2])) < _AGREED_ATTITUDE_RAD
            and max(abs(b[0] - c[0]), abs(b[1] - c[1]), abs(b[2] - c[2])) < _AGREED_BIAS_RAD_S
        )
        self._agreed_cycles = self._agreed_cycles + 1 if agrees else 0
        self._trusts_estimator = self._agreed_cycles * self._cycle_s >= _AGREE_FOR_S

    def _read_verdict(self, axis: int) -> Verdict:
        recovery = self._axes[axis]
        verdict = self._classifiers[axis].verdict
        if recovery.in_alarm and recovery.state == AxisState.CLASSIFIED and verdict.kind == FaultKind.NONE:
            return Verdict(FaultKind.DEAD, 0.0, 0.0, 1.0)
        return verdict

    # -- what is handed on -----------------------------------------------------------------------------------------

    def _start(self, sensors: Sensors) -> None:
        """Begin with the first star-tracker frame and the gyro's rate, brought to this tick."""
        y, late_s = sensors.omega_meas_b_rad_s, sensors.star_age_s
        q = turn(normalise(sensors.q_ib_meas), y[0] * late_s, y[1] * late_s, y[2] * late_s)
        self._h_b = self._wheels.combine(self._collector.h_rw_nms or sensors.wheel_momenta())
        self._gyroless.start(q, y, self._h_b)
        self._stellar.q_ib = q
        self._observer.reset(y)
        self._star_tick = sensors.tick

    def _hand_on(self, fresh: bool, estimate: Estimate, step: Vec3) -> Detection:
        """The estimate to fly with: the gyro where it is good, the gyro-less rate where it is not."""
        replaced = self._replaced
        any_replaced = replaced[0] or replaced[1] or replaced[2]
        if self._trusts_estimator and not any_replaced and estimate.valid:
            self._estimate = estimate
            return self._report(estimate, step)
        b, y = self._stellar.bias_b_rad_s, self._y
        w = (y[0] - b[0], y[1] - b[1], y[2] - b[2])
        if any_replaced:
            g = self._gyroless.omega_bi_b_rad_s
            if not fresh and self._collector.h_rw_nms is not None:
                g = self._gyroless.read_rate(self._wheels.combine(self._collector.h_rw_nms))
            w = (g[0] if replaced[0] else w[0], g[1] if replaced[1] else w[1], g[2] if replaced[2] else w[2])
        if fresh or self._estimate is None:
            q = self._gyroless.q_ib if any_replaced else self._stellar.q_ib
        else:
            q = turn(self._estimate.q_ib, w[0] * self._tick_s, w[1] * self._tick_s, w[2] * self._tick_s)
        self._estimate = Estimate(q, w, b, not self._is_blind())
        return self._report(self._estimate, step)

    def _is_blind(self) -> bool:
        """Whether an axis has had neither a gyro nor star-tracker frames for too long to point."""
        return self._coasting_s > self._config.safe_after_s

    def _report(self, estimate: Estimate, step: Vec3) -> Detection:
        i, j, k = self._axes
        r2 = self._r2
        fault = (
            r2[0] if i.state else 0.0,
            r2[1] if j.state else 0.0,
            r2[2] if k.state else 0.0,
        )
        blind = self._is_blind()
        far_gone = self._coasting_s > _BLIND_FACTOR * self._config.safe_after_s
        states = (int(i.state), int(j.state), int(k.state))
        return Detection(estimate, step, states, fault, blind, not far_gone)

    def _pass_through(self, sensors: Sensors, estimate: Estimate, step: Vec3) -> Detection:
        """Before the start, or with recovery off: the estimator's estimate, and the findings beside it."""
        report = self._report(estimate, step)
        report.rate_good = False not in sensors.gyro_valid
        return report
