"""Four wheels of any model: their rotors, momentum exchange with the body, telemetry, bookkeeping of torques."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from bus.linear import ZERO3, ZERO4, add
from bus.units import Mat3, Vec3, Vec4
from bus.wheels import OFF, TORQUE
from plant_server.config import PlantConfig, WheelConfig
from plant_server.faults import WHEELS, FaultTimeline
from plant_server.noise import open_normals
from plant_server.wheels.axes import nominal_axis, true_axis
from plant_server.wheels.bank import NO_BITS, NO_WHEEL, Flags4, Status4, WheelBank, has_slow_telemetry
from plant_server.wheels.ideal_wheel import IdealWheel
from plant_server.wheels.ithaco_wheel import IthacoWheel
from plant_server.wheels.motor import fill_motor
from plant_server.wheels.wheel import Wheel

ALL: Flags4 = (True, True, True, True)
ALL_OK: Status4 = (0, 0, 0, 0)
ALL_TORQUE: Status4 = (TORQUE, TORQUE, TORQUE, TORQUE)
OK: Final = 0  # STATUS of the wheel telemetry frame; 1, fault, is never known to the unit
NO_COMMAND: Final = 2
SPEED_LIMIT: Final = 3


class FourWheels(WheelBank):
    """A `WheelBank` in which each wheel has a model of its own."""

    __slots__ = (
        "_axes",
        "_commanded",
        "_current_a",
        "_h_rw_nms",
        "_has_jitter",
        "_inverse_inertia",
        "_is_odd",
        "_is_steady",
        "_ithaco",
        "_max_speed",
        "_modes",
        "_next_look",
        "_noise",
        "_nominal_axes",
        "_setpoints",
        "_speed_per_nm",
        "_step_s",
        "_wheels",
        "ambient_c",
        "axes_b",
        "bus_current_a",
        "bus_v",
        "command_b_nm",
        "command_nm",
        "counter_frozen",
        "current_a",
        "h_b_nms",
        "has_slow_telemetry",
        "latch",
        "late_ticks",
        "silent",
        "speed_rad_s",
        "status",
        "temperature_c",
        "torque_b_nm",
        "torque_nm",
    )  # fmt: skip

    def __init__(
        self, config: PlantConfig, timeline: FaultTimeline, step_s: float, seed: int, omega_bi_b_rad_s: Vec3
    ) -> None:
        """omega_bi_b_rad_s : body rate at the start, which the rotors' absolute momentum needs."""
        self._step_s = step_s
        self.axes_b = tuple(true_axis(w.mount, w.tilt_deg, w.clock_deg) for w in config.wheels)
        self._wheels = a, b, c, d = tuple(
            _make_wheel(unit, wheel, timeline, step_s, axis)
            for unit, wheel, axis in zip(WHEELS, config.wheels, self.axes_b, strict=True)
        )
        self._ithaco = [(i, wheel) for i, wheel in enumerate(self._wheels) if isinstance(wheel, IthacoWheel)]
        self._axes = tuple(component for axis in self.axes_b for component in axis)
        self._nominal_axes = tuple(component for w in config.wheels for component in nominal_axis(w.mount))
        self._inverse_inertia: Vec4 = (1.0 / a.inertia, 1.0 / b.inertia, 1.0 / c.inertia, 1.0 / d.inertia)
        self._speed_per_nm: Vec4 = (a.speed_per_nm, b.speed_per_nm, c.speed_per_nm, d.speed_per_nm)
        self._max_speed: Vec4 = (a.max_speed_rad_s, b.max_speed_rad_s, c.max_speed_rad_s, d.max_speed_rad_s)
        self._noise = _open_noise(config, seed)
        s1, s2, s3, s4 = (wheel.speed_rad_s for wheel in config.wheels)
        self.speed_rad_s: Vec4 = (s1, s2, s3, s4)
        self._h_rw_nms = self._find_momenta(omega_bi_b_rad_s)  # absolute spin momentum of each rotor
        for wheel, h_nms, speed in zip(self._wheels, self._h_rw_nms, self.speed_rad_s, strict=True):
            wheel.start(h_nms, speed)
        self.h_b_nms = _combine(self._axes, self._h_rw_nms)
        self._modes: Status4 = ALL_TORQUE
        self._setpoints: Vec4 = ZERO4  # of each mode, in its unit
        self.command_nm: Vec4 = ZERO4
        self.command_b_nm = _combine(self._nominal_axes, ZERO4)
        self._commanded: Flags4 = (False, False, False, False)  # which have a command: nothing has come yet
        self.silent: Flags4 = (False, False, False, False)
        self.torque_nm: Vec4 = ZERO4
        self.torque_b_nm: Vec3 = ZERO3
        self._current_a: Vec4 = ZERO4  # of the motors,
        self.current_a: Vec4 = ZERO4  # and as the telemetry has it
        self._is_odd = False  # a fault is in the telemetry
        self.late_ticks: Status4 = NO_BITS
        self.counter_frozen: Flags4 = NO_WHEEL
        self.has_slow_telemetry = _four([has_slow_telemetry(wheel.model) for wheel in config.wheels])
        motors = [fill_motor(wheel).settings for wheel in config.wheels if wheel.model == "ithaco"]
        self._has_jitter = any(motor.jitter for motor in motors)
        self.temperature_c: Vec4 = ZERO4
        self.ambient_c = motors[0].ambient_c if motors else 20.0
        self.bus_v = 0.0
        self.bus_current_a: Vec4 = ZERO4
        self.latch: Status4 = NO_BITS
        self._report_slowly()
        self.status: Status4 = self._find_status()
        self._is_steady = False  # only a speed limit can make the next step's torque another than the last one's
        self._next_look = -1  # step on which the faults must be looked at

    def _find_momenta(self, omega_bi_b_rad_s: Vec3) -> Vec4:
        """Return the absolute spin momentum of each rotor in a body that turns at omega."""
        x, y, z = omega_bi_b_rad_s
        wheels = zip(self.speed_rad_s, self.axes_b, self._wheels, strict=True)
        h = [wheel.inertia * (speed + (a * x + b * y + c * z)) for speed, (a, b, c), wheel in wheels]
        return (h[0], h[1], h[2], h[3])

    def add_rotors(self, inertia_kgm2: Mat3) -> Mat3:
        """Return the inertia with the rotors' own about their spin axes added: that of the body with wheels locked."""
        m = [list(row) for row in inertia_kgm2]
        for wheel, axis in zip(self._wheels, self.axes_b, strict=True):
            for i in range(3):
                for j in range(3):
                    m[i][j] += wheel.inertia * axis[i] * axis[j]
        return ((m[0][0], m[0][1], m[0][2]), (m[1][0], m[1][1], m[1][2]), (m[2][0], m[2][1], m[2][2]))

    # -- moving --------------------------------------------------------------------------------------------------------

    def receive(self, commands_nm: Sequence[float | None]) -> None:
        """Take the torque commands of this tick [N m]; None: the wheel has none, so its motor gives no torque."""
        a, b, c, d = commands_nm
        commanded = (a is not None, b is not None, c is not None, d is not None)
        command = (a or 0.0, b or 0.0, c or 0.0, d or 0.0)
        if command != self.command_nm or commanded != self._commanded or self._modes != ALL_TORQUE:
            self._commanded = commanded
            self._modes = ALL_TORQUE
            self._setpoints = self.command_nm = command
            self.command_b_nm = _combine(self._nominal_axes, command)
            self._is_steady = False

    def receive_modes(self, modes: Status4, setpoints: Sequence[float | None]) -> None:
        """Take the commands of a tick on which not all wheels are told a torque; stands for `receive`.

        An ideal wheel knows torque alone. What follows a current or a speed has no torque command in the truth.
        """
        known = [
            mode in (OFF, TORQUE) or isinstance(wheel, IthacoWheel)
            for mode, wheel in zip(modes, self._wheels, strict=True)
        ]
        given = [point if know else None for point, know in zip(setpoints, known, strict=True)]
        torques = [(point or 0.0) if mode == TORQUE else 0.0 for mode, point in zip(modes, given, strict=True)]
        self.receive([None if point is None else torque for point, torque in zip(given, torques, strict=True)])
        p, q, r, s = (mode if point is not None else OFF for mode, point in zip(modes, given, strict=True))
        self._modes = (p, q, r, s)
        e, f, g, h = given
        self._setpoints = (e or 0.0, f or 0.0, g or 0.0, h or 0.0)
        self._is_steady = False

    def drive(self, step: int) -> None:
        """Set `torque_nm` and `torque_b_nm`, the torques on the body over the integration step `step`."""
        if step >= self._next_look:
            self._look(step)
        if self._is_steady and self._keeps_limits():
            return
        s1, s2, s3, s4 = self.speed_rad_s
        c1, c2, c3, c4 = self._setpoints
        m1, m2, m3, m4 = self._modes
        a, b, c, d = self._wheels
        self.torque_nm = torque = (
            a.drive(step, c1, m1, s1), b.drive(step, c2, m2, s2), c.drive(step, c3, m3, s3), d.drive(step, c4, m4, s4)
        )  # fmt: skip
        self.torque_b_nm = _combine(self._axes, torque)
        self.current_a = self._current_a = (a.current_a, b.current_a, c.current_a, d.current_a)
        self.status = self._find_status()
        self._is_steady = a.is_steady and b.is_steady and c.is_steady and d.is_steady
        if self._has_jitter:
            for i, wheel in self._ithaco:
                self.torque_b_nm = add(self.torque_b_nm, wheel.find_jitter(self.speed_rad_s[i]))

    def _find_status(self) -> Status4:
        """Return STATUS of each wheel's frame."""
        a, b, c, d = self._wheels
        if self._commanded == ALL and not (a.limited or b.limited or c.limited or d.limited):
            return ALL_OK
        s1, s2, s3, s4 = (
            SPEED_LIMIT if wheel.limited else OK if commanded else NO_COMMAND
            for commanded, wheel in zip(self._commanded, self._wheels, strict=True)
        )
        return (s1, s2, s3, s4)

    def _keeps_limits(self) -> bool:
        """Return whether another step with the same torque leaves every rotor within its speed limit."""
        s1, s2, s3, s4 = self.speed_rad_s
        t1, t2, t3, t4 = self.torque_nm
        k1, k2, k3, k4 = self._speed_per_nm
        m1, m2, m3, m4 = self._max_speed
        return (
            -m1 <= s1 - t1 * k1 <= m1
            and -m2 <= s2 - t2 * k2 <= m2
            and -m3 <= s3 - t3 * k3 <= m3
            and -m4 <= s4 - t4 * k4 <= m4
        )

    def advance(self, omega_bi_b_rad_s: Vec3, h_b_nms: Vec3) -> None:
        """Move the rotors to the end of the step: body rate there, and the sum of their momentum [N m s], body axes."""
        self.h_b_nms = h_b_nms
        x, y, z = omega_bi_b_rad_s
        dt_s = self._step_s
        ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz = self._axes
        h1, h2, h3, h4 = self._h_rw_nms
        t1, t2, t3, t4 = self.torque_nm
        i1, i2, i3, i4 = self._inverse_inertia
        h1 -= t1 * dt_s
        h2 -= t2 * dt_s
        h3 -= t3 * dt_s
        h4 -= t4 * dt_s
        self._h_rw_nms = (h1, h2, h3, h4)
        self.speed_rad_s = (
            h1 * i1 - ax * x - ay * y - az * z,
            h2 * i2 - bx * x - by * y - bz * z,
            h3 * i3 - cx * x - cy * y - cz * z,
            h4 * i4 - dx * x - dy * y - dz * z,
        )

    # -- faults --------------------------------------------------------------------------------------------------------

    def look_again(self) -> None:
        """Note that the faults have changed."""
        self._next_look = -1

    def _look(self, step: int) -> None:
        """Bring the faults up to date for the integration step `step`: due once that reaches `_next_look`."""
        t_s = (step + 0.5) * self._step_s
        a, b, c, d = self._wheels
        s1, s2, s3, s4 = self.speed_rad_s
        self._next_look = min(
            a.look(step, t_s, s1), b.look(step, t_s, s2), c.look(step, t_s, s3), d.look(step, t_s, s4)
        )
        p, q, r, s = a.state, b.state, c.state, d.state
        self.silent = (p.silent, q.silent, r.silent, s.silent)
        self.late_ticks = (p.late_ticks, q.late_ticks, r.late_ticks, s.late_ticks)
        self.counter_frozen = (p.counter_frozen, q.counter_frozen, r.counter_frozen, s.counter_frozen)
        self._is_odd = a.is_odd or b.is_odd or c.is_odd or d.is_odd
        self._is_steady = False

    # -- electronics ---------------------------------------------------------------------------------------------------

    def _report_slowly(self) -> None:
        """Bring what the slow telemetry says up to date."""
        temperature, current, latch = [0.0] * 4, [0.0] * 4, [0] * 4
        for i, wheel in self._ithaco:
            temperature[i], current[i], latch[i] = wheel.rotor.temperature_c, wheel.rotor.bus_current_a, wheel.latch
            self.bus_v = wheel.bus_v
        self.temperature_c = (temperature[0], temperature[1], temperature[2], temperature[3])
        self.bus_current_a = (current[0], current[1], current[2], current[3])
        self.latch = (latch[0], latch[1], latch[2], latch[3])

    def clear_latch(self, wheel: int, mask: int) -> None:
        """Clear these bits of a wheel's latch; one whose cause is still there is set again."""
        for i, each in self._ithaco:
            if i == wheel:
                each.latch &= ~mask
        self._report_slowly()

    def set_power(self, wheel: int, on: bool) -> None:
        """Switch a wheel's power; without, its motor gives no torque and the rotor coasts."""
        for i, each in self._ithaco:
            if i == wheel:
                each.set_power(on)

    def power_cycle(self, wheel: int) -> None:
        """Switch a wheel's power off, and on again after OFF_S."""
        for i, each in self._ithaco:
            if i == wheel:
                each.power_cycle()

    # -- telemetry -----------------------------------------------------------------------------------------------------

    def sample_speed(self, step: int) -> Vec4:
        """Return the tachometer readings [rad/s], noisy from a stream each; brings `silent` and `current_a` up to date."""
        if step >= self._next_look:
            self._look(step)
        if self._ithaco:
            self._report_slowly()
        if not (self._noise or self._is_odd or True in self.silent or self._has_odd_nodes()):
            return self.speed_rad_s
        speeds, currents = list(self.speed_rad_s), list(self._current_a)
        for i, speed_sigma, current_sigma, draw in self._noise:
            if speed_sigma > 0.0:
                speeds[i] += speed_sigma * draw()
            if current_sigma > 0.0:
                currents[i] += current_sigma * draw()
        for i, wheel in enumerate(self._wheels):
            if wheel.has_pending:
                wheel.note_output(step, speeds[i], currents[i])
            speeds[i], currents[i] = wheel.report(speeds[i], currents[i])
        self.current_a = (currents[0], currents[1], currents[2], currents[3])
        return (speeds[0], speeds[1], speeds[2], speeds[3])

    def _has_odd_nodes(self) -> bool:
        return self.late_ticks != NO_BITS or self.counter_frozen != NO_WHEEL


def _make_wheel(unit: str, config: WheelConfig, timeline: FaultTimeline, step_s: float, axis_b: Vec3) -> Wheel:
    """Return the wheel that the settings describe."""
    if config.model == "ithaco":
        return IthacoWheel(unit, config, timeline, step_s, axis_b)
    return IdealWheel(unit, config, timeline, step_s)


def _open_noise(config: PlantConfig, seed: int) -> list[tuple[int, float, float, Callable[[], float]]]:
    """Return wheel, noise of speed and of current, and where each draws from, of the wheels that have any."""
    wheels = enumerate(zip(WHEELS, config.wheels, strict=True))
    return [
        (i, wheel.speed_noise_rad_s, wheel.current_noise_a, open_normals(seed, unit))
        for i, (unit, wheel) in wheels
        if wheel.speed_noise_rad_s > 0.0 or wheel.current_noise_a > 0.0
    ]


def _four(flags: list[bool]) -> Flags4:
    a, b, c, d = flags
    return (a, b, c, d)


def _combine(axes: tuple[float, ...], per_wheel: Vec4) -> Vec3:
    """Return the body vector of a quantity about each wheel's axis, in its unit; axes: 3 numbers for each wheel."""
    a, b, c, d = per_wheel
    ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz = axes
    return (
        ax * a + bx * b + cx * c + dx * d,
        ay * a + by * b + cy * c + dy * d,
        az * a + bz * b + cz * c + dz * d,
    )
