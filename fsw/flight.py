"""One cycle of the flight software, in order: receive, validate, estimate, detect, observe, guide, control, allocate,
send, publish.
"""

from __future__ import annotations

import math

from bus.telemetry.link import Row
from bus.units import Vec3, Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers
from fsw.config import FswConfig
from fsw.executive import ExecutiveCounters
from fsw.guidance import Guidance
from fsw.inputs import Inputs
from fsw.modes import POINT, STANDBY, Mode, ModeManager
from fsw.outputs import Outputs
from fsw.records import Demand, Estimate, Sensors
from fsw.schedule import RateGroup, flight_schedule
from fsw.wheel_axes import combine_wheels

NO_TORQUE: Vec4 = (0.0, 0.0, 0.0, 0.0)
ZERO: Vec3 = (0.0, 0.0, 0.0)
DEG_PER_RAD = 180.0 / math.pi
HEARTBEAT_S = 1.0


class Flight:
    """The flight software between its bus and its telemetry. Holds no socket and reads no clock."""

    def __init__(self, config: FswConfig, tick_s: float, run_hash: int) -> None:
        model = config.model
        self.inputs = Inputs(config, tick_s)
        self.outputs = Outputs(run_hash, max(1, round(HEARTBEAT_S / tick_s)))
        self.modes = ModeManager(config.modes)
        self.executive = ExecutiveCounters()
        self.estimator = estimation.REGISTRY[config.estimator.kind](config.estimator, model, tick_s)
        self.detector = gyro_fdi.REGISTRY[config.detector.kind](config.detector, model, tick_s)
        self.observer = observers.REGISTRY[config.observer.kind](config.observer, model)
        self.controller = controllers.REGISTRY[config.controller.kind](config.controller, model)
        self.allocator = allocators.REGISTRY[config.allocator.kind](config.allocator, model)
        self.guidance = Guidance(config.target_q)
        self._control: RateGroup = flight_schedule(config.executive.control_divider).group("control")
        self._control_s = tick_s * config.executive.control_divider
        self._damping_nm_s = config.modes.damping_nm_s
        self._wheel_momentum = model.wheel_momentum
        self.safe_requested = False
        self._reset_outputs()

    def _reset_outputs(self) -> None:
        self.tau_rw_cmd_nm: Vec4 = NO_TORQUE
        self.tau_cmd_b_nm: Vec3 = ZERO
        self.tau_fault_hat_b_nm: Vec3 = ZERO
        self.q_err: Vec4 = (1.0, 0.0, 0.0, 0.0)
        self._error_deg = 0.0
        self._control_ran = False  # in the last cycle
        self._mode_of_control = STANDBY

    def cycle(self, tick: int, batch: bytes) -> bytes:
        """Run the cycle of this tick on the frames received since the last; return the frames to send."""
        inputs = self.inputs
        sensors = inputs.receive(tick, batch)
        estimate = self.estimator.step(sensors)
        self.detection = detection = self.detector.step(sensors, estimate, self.tau_rw_cmd_nm)
        estimate, rate_step_b_rad_s, _, _, _, request_safe, rate_good = detection
        _, omega_bi_b_rad_s, _, valid = estimate
        mode = self.modes.step(
            valid and sensors.star_valid, rate_good, omega_bi_b_rad_s, self.safe_requested or request_safe
        )
        if rate_step_b_rad_s != ZERO:
            self.observer.shift_rate(rate_step_b_rad_s)
        self._control_ran = self._control.due(tick)
        if self._control_ran:
            self._command(mode, sensors, estimate)
        return self.outputs.commands(
            tick, inputs.plant_tick & 0xFF, self.tau_rw_cmd_nm, mode is not STANDBY, mode, self.executive.slips
        )

    def _command(self, mode: Mode, sensors: Sensors, estimate: Estimate) -> None:
        """Observe, guide, control, allocate: everything that runs at the control rate."""
        if mode is not self._mode_of_control:
            self._mode_of_control = mode
            self.observer.reset()
            self.controller.reset()
        rate = estimate.omega_bi_b_rad_s
        if mode is POINT:
            self.tau_fault_hat_b_nm = self.observer.step(
                self._control_s, rate, self.tau_cmd_b_nm, self._wheel_momentum_b(sensors)
            )
            self.q_err = self.guidance.find_error(estimate.q_ib)
            demand = self.controller.step(self._control_s, self.q_err, rate, self.tau_fault_hat_b_nm)
        else:
            self.tau_fault_hat_b_nm = ZERO
            self.q_err = self.guidance.find_error(estimate.q_ib)
            demand = self._damp(mode, rate)
        if demand.tau_rw_nm is None:
            self.tau_rw_cmd_nm = self.allocator.allocate(demand.tau_cmd_b_nm)
        else:
            self.tau_rw_cmd_nm = self.allocator.limit(demand.tau_rw_nm)
        self.tau_cmd_b_nm = combine_wheels(self.tau_rw_cmd_nm)
        self._error_deg = 2.0 * math.acos(min(1.0, abs(self.q_err[0]))) * DEG_PER_RAD

    def _damp(self, mode: Mode, omega_bi_b_rad_s: Vec3) -> Demand:
        if mode is STANDBY or not self.detection.rate_good:
            return Demand(ZERO, NO_TORQUE)
        k = -self._damping_nm_s
        x, y, z = omega_bi_b_rad_s
        return Demand((k * x, k * y, k * z), None)

    def _wheel_momentum_b(self, sensors: Sensors) -> Vec3:
        return combine_wheels(sensors.h_rw_nms) if self._wheel_momentum else ZERO

    def publish(self, tick: int, t_ns: int, dropped: int) -> Row:
        """The telemetry of this cycle as a row: every cycle's part, and that of control on the ticks on which it ran.

        dropped : ticks so far for whose telemetry the recorder had no room
        """
        counters = self.executive
        control = None
        if self._control_ran:
            inputs = self.inputs.counters
            control = (
                self.tau_cmd_b_nm, self.tau_rw_cmd_nm, self.tau_fault_hat_b_nm, self.modes.mode, counters.slips,
                inputs.refused, inputs.foreign, inputs.implausible, self.controller.internals, self.detector.internals,
            )  # fmt: skip
        return (
            tick, t_ns, self.q_err, self._error_deg, self.detection,
            counters.last_cycle_ns, counters.max_cycle_ns, counters.last_lateness_ns, dropped, control,
        )  # fmt: skip
