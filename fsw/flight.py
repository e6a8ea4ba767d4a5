"""One cycle of the flight software, in order: receive, validate, estimate, detect, observe, judge the wheels, guide,
control, allocate, drive, send. Telemetry is read off afterwards, see fsw/telemetry.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from bus.attitude import IDENTITY
from bus.commands import Command
from bus.errors import ConfigError
from bus.icd.heartbeat import count_heartbeat_ticks
from bus.linear import ZERO3, ZERO4, add, cross, subtract, times
from bus.units import Vec3, Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers, tuning, wheel_health
from fsw.config import FswConfig
from fsw.drive import REST, Drive
from fsw.executive import ExecutiveCounters
from fsw.families import NO_INTERNALS, Algorithm
from fsw.guidance import Guidance, timeline
from fsw.guidance.guidance import feed_forward
from fsw.inputs import Inputs
from fsw.modes import DEGRADED, DETUMBLE, MODE_VERBS, POINT, STANDBY, Mode, ModeManager
from fsw.null_space import NullSpace
from fsw.outputs import Outputs
from fsw.rate_mean import RateMean
from fsw.records import (
    ALL_WHEELS,
    HEALTHY,
    NO_WHEEL,
    ONES4,
    Allocation,
    Detection,
    Estimate,
    Flags4,
    PointingError,
    Sensors,
    WheelCommands,
    WheelHealth,
    WheelPower,
    without,
)
from fsw.schedule import flight_schedule
from fsw.vehicle import Vehicle

DEG_PER_RAD: Final = 180.0 / math.pi


class WheelPowerInternals(NamedTuple):
    """Slow telemetry of the four wheels as last heard."""

    motor_c: Vec4  # [degC]
    driver_c: Vec4
    bus_v: Vec4
    bus_current_a: Vec4
    latch: tuple[int, int, int, int]  # bits of bus/wheels.py
    uptime_s: Vec4
    age_s: Vec4  # of the older half; -1: not heard yet
    valid: Flags4


def _age(power: WheelPower, tick: int, tick_s: float) -> float:
    return -1.0 if min(power.temp_tick, power.power_tick) < 0 else power.count_age_ticks(tick) * tick_s


def _points(mode: Mode) -> bool:
    return mode is POINT or mode is DEGRADED


class Flight:
    """The flight software between its bus and its telemetry. Holds no socket and reads no clock."""

    def __init__(self, config: FswConfig, tick_s: float, run_hash: int) -> None:
        """Raises ConfigError or one of its kind where the settings cannot be flown with."""
        self.vehicle = vehicle = Vehicle(config.model)
        self.run_hash = run_hash
        self._tick_s = tick_s
        control_s = tick_s * config.executive.control_divider
        self.inputs = Inputs(config.modes, vehicle, tick_s, run_hash)
        self.outputs = Outputs(run_hash, count_heartbeat_ticks(tick_s))
        self.modes = ModeManager(config.modes, tick_s)
        self.executive = ExecutiveCounters()
        self.estimator = estimation.REGISTRY.make(config.estimator, vehicle, tick_s)
        self.detector = gyro_fdi.REGISTRY.make(config.detector, vehicle, tick_s)
        self.observer = observers.REGISTRY.make(config.observer, vehicle, control_s)
        self.wheel_health = wheel_health.REGISTRY.make(config.wheel_health, vehicle, control_s)
        self.controller = controllers.REGISTRY.make(config.controller, vehicle, control_s)
        self.law_settings: Any = config.controller
        self.allocator = allocators.REGISTRY.make(config.allocator, vehicle, control_s)
        self.null_space = NullSpace(config.null_space, vehicle, control_s)
        self.drive = Drive(config.drive, vehicle, config.wheel_health.kind)
        self.guidance = Guidance(config.target_q)
        self.control_slot, self.diagnostics_slot = flight_schedule(config.executive.control_divider).open_slots()
        self._control_s = control_s
        self.control_ticks = config.executive.control_divider
        self._rate_mean = RateMean()
        self.damping_nm_s = config.modes.damping_nm_s
        self.feed_forward = config.guidance.feed_forward
        self.slew_rate_deg_s = tuning.SLEW_RATE_DEG_S  # with which the ground's attitudes are turned to; 0: a step
        self.slew_acceleration_deg_s2 = tuning.SLEW_ACCELERATION_DEG_S2
        self._reset_outputs()

    def _reset_outputs(self) -> None:
        self.detection = Detection(Estimate(IDENTITY, ZERO3, ZERO3, False), ZERO3, (0, 0, 0), ZERO3, False, False)
        self.tau_fault_hat_b_nm: Vec3 = ZERO3
        self.health: WheelHealth = HEALTHY
        self.error = PointingError(IDENTITY, ZERO3)
        self.error_deg = 0.0
        self.allocation = Allocation()
        self.tau_cmd_b_nm: Vec3 = ZERO3  # what the wheel torques sent add up to
        self.wheel_commands: WheelCommands = REST
        self.torques_saturated = 0  # wheel torques so far that no frame could carry
        self.control_ran = False  # in the last cycle
        self.out_of_reach = ""  # why the wheels that can be used do not reach all three axes; empty where they do
        self._available = ALL_WHEELS
        self._mode_of_control = STANDBY

    def cycle(self, tick: int, batch: bytes, commands: Sequence[Command] = (), safe_requested: bool = False) -> bytes:
        """Run the cycle of this tick on the frames received since the last; return the frames to send.

        commands       : of the ground, due on this tick; one that `check` objects to must not be among them
        safe_requested : the executive asks for safe mode
        """
        for command in commands:
            self._obey(command, tick)
        inputs = self.inputs
        sensors = inputs.receive(tick, batch)
        estimate = self.estimator.step(sensors)
        self.detection = detection = self.detector.step(sensors, estimate, self.wheel_commands.meant_nm)
        estimate = detection.estimate
        mode = self.modes.step(
            estimate.valid and sensors.star_valid,
            detection.rate_good,
            estimate.omega_bi_b_rad_s,
            safe_requested or detection.request_safe,
            self._explain_reach(),
        )
        if detection.rate_step_b_rad_s != ZERO3:
            self.observer.shift_rate(detection.rate_step_b_rad_s)
            self._rate_mean.shift(detection.rate_step_b_rad_s)
        self._rate_mean.add(estimate.omega_bi_b_rad_s)
        if self.guidance.follows:
            self.guidance.advance(sensors.t_s)
        self.control_ran = tick >= self.control_slot.next_tick
        if self.control_ran:
            ticks = self.control_slot.take(tick)
            self._control(
                self._control_s if ticks == self.control_ticks else ticks * self._tick_s, mode, sensors, estimate
            )
        return self.outputs.commands(tick, inputs.plant_tick & 0xFF, self.wheel_commands, mode, self.executive.slips)

    @property
    def cautions(self) -> list[str]:
        """What the settings of the algorithms leave in doubt, in words."""
        chosen: tuple[Algorithm, ...] = (
            self.estimator, self.detector, self.observer, self.wheel_health, self.controller, self.allocator
        )  # fmt: skip
        return [algorithm.caution for algorithm in chosen if algorithm.caution != ""]

    @property
    def wheel_power(self) -> tuple[Any, ...]:
        """What the wheels report of their supply and themselves, for telemetry; nothing where none has a motor."""
        if not self.vehicle.has_motors:
            return NO_INTERNALS
        sensors = self.inputs.sensors
        a, b, c, d = sensors.powers
        tick_s, tick = self._tick_s, sensors.tick
        return WheelPowerInternals(
            (a.motor_c, b.motor_c, c.motor_c, d.motor_c),
            (a.driver_c, b.driver_c, c.driver_c, d.driver_c),
            (a.bus_v, b.bus_v, c.bus_v, d.bus_v),
            (a.bus_current_a, b.bus_current_a, c.bus_current_a, d.bus_current_a),
            (a.latch, b.latch, c.latch, d.latch),
            (a.uptime_s, b.uptime_s, c.uptime_s, d.uptime_s),
            (_age(a, tick, tick_s), _age(b, tick, tick_s), _age(c, tick, tick_s), _age(d, tick, tick_s)),
            (a.valid, b.valid, c.valid, d.valid),
        )

    def check(self, command: Command, tick: int) -> str:
        """Why a command cannot be obeyed, in words; empty where it can."""
        verb = command.verb
        if verb in MODE_VERBS:
            return self._check_mode(MODE_VERBS[verb], command)
        if verb == tuning.VERB:
            return tuning.check(self, command.arguments)
        if not timeline.is_known(verb):
            verbs = [*[timeline.PREFIX + word for word in timeline.GUIDES], *MODE_VERBS, tuning.VERB]
            return f"{verb} is not known; there are: {', '.join(verbs)}"
        try:
            guide = timeline.make_guide(command, self.guidance.target, tick * self._tick_s)
        except ConfigError as error:
            return str(error)
        highest = self.modes.detumble_above_rad_s
        if guide.top_rate_rad_s > highest:
            return (
                f"{guide.top_rate_rad_s * DEG_PER_RAD:.3g} deg/s is above modes.detumble_above_deg_s = "
                f"{highest * DEG_PER_RAD:.3g} deg/s, at which pointing is given up for damping"
            )
        return ""

    def _check_mode(self, mode: Mode, command: Command) -> str:
        """Why a mode cannot be had; empty where it can."""
        if command.arguments:
            return f"{command.verb} takes no arguments"
        if mode is POINT and not (self.detection.estimate.valid and self.inputs.sensors.star_valid):
            return "there is no attitude to point with"
        if (mode is POINT or mode is DETUMBLE) and not self.detection.rate_good:
            return "there is no rate to damp with"
        return ""

    def _obey(self, command: Command, tick: int) -> None:
        """Do what a command says that `check` did not object to."""
        if command.verb in MODE_VERBS:
            self.modes.command(MODE_VERBS[command.verb])
        elif command.verb == tuning.VERB:
            tuning.apply(self, command.arguments)
        else:
            self.guidance.follow(command, tick * self._tick_s)

    def check_law(self, settings: Any) -> None:
        """Raise ConfigError or DesignError where a law of these settings cannot be made."""
        controllers.REGISTRY.make(settings, self.vehicle, self._control_s)

    def change_law(self, settings: Any) -> None:
        """Take up the law with other settings of its kind: a new one, whose integral begins at zero.

        Raises ConfigError or DesignError, and keeps the old one, where that cannot be made.
        """
        self.controller = controllers.REGISTRY.make(settings, self.vehicle, self._control_s)
        self.law_settings = settings

    def _control(self, dt_s: float, mode: Mode, sensors: Sensors, estimate: Estimate) -> None:
        """Observe, judge the wheels, guide, control, allocate, drive: everything that runs at the control rate.

        dt_s : since control last ran: the control period, or more where ticks were lost
        """
        if mode is not self._mode_of_control:
            if not (_points(mode) and _points(self._mode_of_control)):  # what is known of the body stays known
                self.observer.reset()
                self.controller.reset()
            self._mode_of_control = mode
        rate, wheels = estimate.omega_bi_b_rad_s, sensors.wheels
        momentum = self.vehicle.wheels.combine(sensors.wheel_momenta()) if self.vehicle.wheel_momentum else ZERO3
        tau_rw_nm, mean_rate, follow = self.wheel_commands.meant_nm, self._rate_mean.take(), ZERO3
        if self.drive.compensates:
            self.wheel_health.note_sent(self.wheel_commands.tau_rw_nm)
        if _points(mode):
            tau_fault = self.observer.step(dt_s, mean_rate, self.tau_cmd_b_nm, momentum)
            health = self._judge(self.wheel_health.step(dt_s, wheels, tau_rw_nm, tau_fault))
            error = self.guidance.find_error(estimate.q_ib, rate)
            torque = self.controller.step(dt_s, error, subtract(tau_fault, health.explained_b_nm), health)
            if self.feed_forward and not self.guidance.target.at_rest:
                follow = self._follow_target(error, rate, momentum)
                torque = add(torque, follow)
        else:
            tau_fault = ZERO3
            health = self._judge(self.wheel_health.step(dt_s, wheels, tau_rw_nm, None))
            error = self.guidance.find_error(estimate.q_ib, rate)
            torque = self._damp(mode, rate)
        self.tau_fault_hat_b_nm, self.health, self.error = tau_fault, health, error
        self.error_deg = 2.0 * math.acos(min(1.0, abs(error.q_tb[0]))) * DEG_PER_RAD
        self._drive(dt_s, mode, torque, health)
        if _points(mode):
            self.controller.note_sent(subtract(self._expect(), follow) if follow != ZERO3 else self._expect())

    def _judge(self, health: WheelHealth) -> WheelHealth:
        """The health to reckon with: a wheel that is not fitted is not available, and gains that the drive makes up for are
        nobody else's. Notes what the wheels that are left cannot reach."""
        fitted = self.vehicle.fitted
        if fitted != ALL_WHEELS:
            health = without(health, fitted)
        if self.drive.compensates:
            health = self.drive.see(health)
        available = health.find_usable()
        if available != self._available:
            self._available = available
            axes = self.vehicle.wheels.count_axes(available)
            out = ", ".join([f"wheel.{i + 1}" for i in (0, 1, 2, 3) if fitted[i] and not available[i]])
            self.out_of_reach = "" if axes == 3 else f"the wheels in use span {axes} of three axes; out: {out}"
        return health

    def _explain_reach(self) -> str:
        """Why the wheels do not reach all three axes, by their health or by what the allocator could reckon with."""
        if self.out_of_reach != "" or self.allocation.axes == 3:
            return self.out_of_reach
        return f"the shares of the wheels leave torque about {self.allocation.axes} of three axes"

    def _drive(self, dt_s: float, mode: Mode, torque_b_nm: Vec3, health: WheelHealth) -> None:
        """Allocate a body torque and make the wheels' commands of it."""
        if mode is STANDBY:
            self.null_space.reset()
            self.allocation, self.wheel_commands, self.tau_cmd_b_nm = Allocation(), REST, ZERO3
            return
        self.allocation = self.allocator.allocate(torque_b_nm, health)
        tau_rw_nm = self.allocation.tau_rw_nm
        if self.null_space.on:
            tau_rw_nm = self.null_space.step(dt_s, tau_rw_nm, self.allocation, health, self.inputs.sensors)
        if health.dither == 1:
            tau_rw_nm = self.vehicle.wheels.add_within(tau_rw_nm, health.dither_rw_nm)
        if health.dead != NO_WHEEL:
            tau_rw_nm = self._probe(tau_rw_nm, health)
        self.wheel_commands = commands = self.drive.command(tau_rw_nm, health, self.inputs.sensors.wheels)
        self.torques_saturated += commands.saturated
        self.tau_cmd_b_nm = self.vehicle.wheels.combine(commands.meant_nm)

    def _probe(self, tau_rw_nm: Vec4, health: WheelHealth) -> Vec4:
        """The torques of the wheels, with what dead ones are told to see whether they have come back [N m]."""
        (a, b, c, d), (p, q, r, s), (t, u, v, w) = tau_rw_nm, health.probe_rw_nm, health.dead
        return (p if t else a, q if u else b, r if v else c, s if w else d)

    def _expect(self) -> Vec3:
        """The body torque that the commands sent will give, by the health that they were allocated with [N m]."""
        allocation = self.allocation
        if allocation.shares == ONES4 and allocation.bias_nm == ZERO4:
            return self.tau_cmd_b_nm
        (a, b, c, d), (e, f, g, h), (p, q, r, s) = self.wheel_commands.meant_nm, allocation.shares, allocation.bias_nm
        return self.vehicle.wheels.combine((a * e + p, b * f + q, c * g + r, d * h + s))

    def _follow_target(self, error: PointingError, rate_b_rad_s: Vec3, momentum_b_nms: Vec3) -> Vec3:
        """The torque that a body needs which moves as the target does, body axes [N m]."""
        inertia, omega_ti = self.vehicle.inertia_kgm2, error.omega_ti_b_rad_s
        spin = add(times(inertia, omega_ti), momentum_b_nms)
        return add(times(inertia, feed_forward(error, rate_b_rad_s)), cross(omega_ti, spin))

    def _damp(self, mode: Mode, omega_bi_b_rad_s: Vec3) -> Vec3:
        if mode is STANDBY or not self.detection.rate_good:
            return ZERO3
        k = -self.damping_nm_s
        x, y, z = omega_bi_b_rad_s
        return (k * x, k * y, k * z)
