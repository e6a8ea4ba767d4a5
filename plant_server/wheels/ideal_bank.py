"""Four ideal wheels: their rotors, momentum exchange with the body, telemetry, bookkeeping of torques."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from bus.linear import ZERO3, ZERO4
from bus.units import Mat3, Vec3, Vec4
from plant_server.config import PlantConfig
from plant_server.faults import WHEELS, FaultTimeline
from plant_server.noise import open_normals
from plant_server.wheels.axes import nominal_axis, true_axis
from plant_server.wheels.bank import Flags4, Status4, WheelBank
from plant_server.wheels.ideal_wheel import IdealWheel

ALL: Flags4 = (True, True, True, True)
ALL_OK: Status4 = (0, 0, 0, 0)
OK: Final = 0  # STATUS of the wheel telemetry frame; 1, fault, is never known to the unit
NO_COMMAND: Final = 2
SPEED_LIMIT: Final = 3


class IdealBank(WheelBank):
    """A `WheelBank` of wheels whose torque is what they are told, within limits, lag, drag and faults."""

    __slots__ = (
        "_axes", "_commanded", "_h_rw_nms", "_inverse_inertia", "_is_steady", "_max_speed", "_next_look", "_nominal_axes",
        "_speed_per_nm", "_step_s", "_tacho", "_wheels", "axes_b", "command_b_nm", "command_nm", "current_a", "h_b_nms",
        "silent", "speed_rad_s", "status", "torque_b_nm", "torque_nm",
    )  # fmt: skip

    def __init__(
        self, config: PlantConfig, timeline: FaultTimeline, step_s: float, seed: int, omega_bi_b_rad_s: Vec3
    ) -> None:
        """omega_bi_b_rad_s : body rate at the start, which the rotors' absolute momentum needs."""
        self._step_s = step_s
        self._wheels = a, b, c, d = tuple(
            IdealWheel(unit, wheel, timeline, step_s) for unit, wheel in zip(WHEELS, config.wheels, strict=True)
        )
        self.axes_b = tuple(true_axis(w.mount, w.tilt_deg, w.clock_deg) for w in config.wheels)
        self._axes = tuple(component for axis in self.axes_b for component in axis)
        self._nominal_axes = tuple(component for w in config.wheels for component in nominal_axis(w.mount))
        self._inverse_inertia: Vec4 = (1.0 / a.inertia, 1.0 / b.inertia, 1.0 / c.inertia, 1.0 / d.inertia)
        self._speed_per_nm: Vec4 = (a.speed_per_nm, b.speed_per_nm, c.speed_per_nm, d.speed_per_nm)
        self._max_speed: Vec4 = (a.max_speed_rad_s, b.max_speed_rad_s, c.max_speed_rad_s, d.max_speed_rad_s)
        units = zip(WHEELS, config.wheels, strict=True)
        noisy = any(wheel.speed_noise_rad_s > 0.0 for wheel in config.wheels)
        self._tacho = [(wheel.speed_noise_rad_s, open_normals(seed, unit)) for unit, wheel in units] if noisy else []
        s1, s2, s3, s4 = (wheel.speed_rad_s for wheel in config.wheels)
        self.speed_rad_s: Vec4 = (s1, s2, s3, s4)
        self._h_rw_nms = self._find_momenta(omega_bi_b_rad_s)  # absolute spin momentum of each rotor
        self.h_b_nms = _combine(self._axes, self._h_rw_nms)
        self.command_nm: Vec4 = ZERO4
        self.command_b_nm = _combine(self._nominal_axes, ZERO4)
        self._commanded: Flags4 = (False, False, False, False)  # which have a command: nothing has come yet
        self.silent: Flags4 = (False, False, False, False)
        self.torque_nm: Vec4 = ZERO4
        self.torque_b_nm: Vec3 = ZERO3
        self.current_a: Vec4 = ZERO4
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
        self._commanded = (a is not None, b is not None, c is not None, d is not None)
        command = (a or 0.0, b or 0.0, c or 0.0, d or 0.0)
        if command != self.command_nm:
            self.command_nm = command
            self.command_b_nm = _combine(self._nominal_axes, command)
            self._is_steady = False

    def drive(self, step: int) -> None:
        """Set `torque_nm` and `torque_b_nm`, the torques on the body over the integration step `step`."""
        if step >= self._next_look:
            self._look(step)
        if self._is_steady and self._keeps_limits():
            return
        s1, s2, s3, s4 = self.speed_rad_s
        c1, c2, c3, c4 = self.command_nm
        a, b, c, d = self._wheels
        self.torque_nm = torque = (
            a.drive(step, c1, s1), b.drive(step, c2, s2), c.drive(step, c3, s3), d.drive(step, c4, s4)
        )  # fmt: skip
        self.torque_b_nm = _combine(self._axes, torque)
        self.current_a = (
            a.motor_nm * a.ampere_per_nm,
            b.motor_nm * b.ampere_per_nm,
            c.motor_nm * c.ampere_per_nm,
            d.motor_nm * d.ampere_per_nm,
        )
        self.status = self._find_status()
        self._is_steady = a.is_steady and b.is_steady and c.is_steady and d.is_steady

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
        self.silent = (a.silent, b.silent, c.silent, d.silent)
        self._is_steady = False

    # -- telemetry -----------------------------------------------------------------------------------------------------

    def sample_speed(self, step: int) -> Vec4:
        """Return the tachometer readings [rad/s], each noisy from its own stream; brings `silent` up to date."""
        if step >= self._next_look:
            self._look(step)
        if True in self.silent:
            for wheel in self._wheels:
                wheel.note_silence(step)
        if not self._tacho:
            return self.speed_rad_s
        a, b, c, d = (
            speed + sigma * draw() for speed, (sigma, draw) in zip(self.speed_rad_s, self._tacho, strict=True)
        )
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
