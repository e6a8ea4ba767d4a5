"""The four wheels together: momentum exchange with the body, telemetry, bookkeeping of torques."""

from __future__ import annotations

from collections.abc import Sequence

from bus.units import Mat3, Vec3, Vec4
from plant_server.config import PlantConfig
from plant_server.faults import WHEELS, FaultTimeline
from plant_server.noise import open_normals
from plant_server.wheels.axes import nominal_axis, true_axis
from plant_server.wheels.reaction_wheel import ReactionWheel

ALL = (True, True, True, True)
ALL_OK = (0, 0, 0, 0)
ZERO: Vec4 = (0.0, 0.0, 0.0, 0.0)
OK, NO_COMMAND, SPEED_LIMIT = 0, 2, 3  # STATUS of the wheel telemetry frame; 1, fault, is never known to the unit


class WheelSet:
    """Four wheels; `h_nms` is each rotor's absolute spin momentum, `speed_rad_s` its speed relative to the body."""

    __slots__ = (
        "_axes", "_dirty", "_inverse_inertia", "_next_look", "_nominal_axes", "_reach", "_simple", "_step_s",
        "_tacho", "_wheels", "axes_b", "command_b_nm", "command_nm", "commanded", "h_b_nms", "h_nms", "silent",
        "speed_rad_s", "torque_b_nm", "torque_nm",
    )  # fmt: skip

    def __init__(
        self, config: PlantConfig, timeline: FaultTimeline, omega_bi_b_rad_s: Vec3, step_s: float, seed: int
    ) -> None:
        self._step_s = step_s
        self._wheels = tuple(
            ReactionWheel(wheel, timeline.chains[unit], step_s)
            for unit, wheel in zip(WHEELS, config.wheels, strict=True)
        )
        self._simple = all(wheel.simple for wheel in self._wheels)
        self.axes_b = tuple(true_axis(w.mount, w.tilt_deg, w.clock_deg) for w in config.wheels)
        self._axes = tuple(component for axis in self.axes_b for component in axis)
        self._nominal_axes = tuple(component for w in config.wheels for component in nominal_axis(w.mount))
        inertia = [wheel.inertia for wheel in self._wheels]
        self._inverse_inertia = (1.0 / inertia[0], 1.0 / inertia[1], 1.0 / inertia[2], 1.0 / inertia[3])
        noisy = any(wheel.speed_noise_rad_s > 0.0 for wheel in config.wheels)
        units = zip(WHEELS, config.wheels, strict=True)
        self._tacho = [(wheel.speed_noise_rad_s, open_normals(seed, unit)) for unit, wheel in units] if noisy else []
        h = []
        for wheel, axis, i in zip(config.wheels, self.axes_b, inertia, strict=True):
            spin = axis[0] * omega_bi_b_rad_s[0] + axis[1] * omega_bi_b_rad_s[1] + axis[2] * omega_bi_b_rad_s[2]
            h.append(i * (wheel.speed_rad_s + spin))
        self.h_nms: Vec4 = (h[0], h[1], h[2], h[3])
        self.h_b_nms = self.combine(self.h_nms)
        self.speed_rad_s: Vec4 = ZERO
        self._measure_speed(omega_bi_b_rad_s)
        self.command_nm: Vec4 = ZERO
        self.command_b_nm = self.combine_nominal(ZERO)  # what it would be on the body with nominal axes
        self.silent = (False, False, False, False)  # which wheels send no telemetry
        self.commanded = (False, False, False, False)  # nothing has come yet
        self.torque_nm: Vec4 = ZERO
        self.torque_b_nm: Vec3 = (0.0, 0.0, 0.0)
        self._reach: Vec4 = ZERO  # speeds below which the torque in hand cannot reach the limit within a step
        self._next_look = -1
        self._dirty = True

    def combine(self, per_wheel: Vec4) -> Vec3:
        """Return D per_wheel: body vector of a quantity about the true axes, in its unit."""
        a, b, c, d = per_wheel
        ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz = self._axes
        return (
            ax * a + bx * b + cx * c + dx * d,
            ay * a + by * b + cy * c + dy * d,
            az * a + bz * b + cz * c + dz * d,
        )

    def combine_nominal(self, per_wheel: Vec4) -> Vec3:
        """Return D0 per_wheel: body vector of a quantity about the nominal axes, in its unit."""
        a, b, c, d = per_wheel
        ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz = self._nominal_axes
        return (
            ax * a + bx * b + cx * c + dx * d,
            ay * a + by * b + cy * c + dy * d,
            az * a + bz * b + cz * c + dz * d,
        )

    def add_rotors(self, inertia_kgm2: Mat3) -> Mat3:
        """Return the inertia with the rotors' own about their spin axes added: that of the body with wheels locked."""
        m = [list(row) for row in inertia_kgm2]
        for wheel, axis in zip(self._wheels, self.axes_b, strict=True):
            for i in range(3):
                for j in range(3):
                    m[i][j] += wheel.inertia * axis[i] * axis[j]
        return ((m[0][0], m[0][1], m[0][2]), (m[1][0], m[1][1], m[1][2]), (m[2][0], m[2][1], m[2][2]))

    def receive(self, commands_nm: Sequence[float | None]) -> None:
        """Take the torque commands of this tick [N m]; None: the wheel has none, so its motor gives no torque."""
        a, b, c, d = commands_nm
        self.commanded = (a is not None, b is not None, c is not None, d is not None)
        command = (a or 0.0, b or 0.0, c or 0.0, d or 0.0)
        if command != self.command_nm:
            self.command_nm = command
            self.command_b_nm = self.combine_nominal(command)
            self._dirty = True

    def look_again(self) -> None:
        """Note that a fault was added to one of the chains."""
        self._next_look = -1

    def drive(self, step: int) -> None:
        """Set `torque_nm` and `torque_b_nm`, the torques on the body over the integration step `step`."""
        if step >= self._next_look:
            self.look(step)
        s1, s2, s3, s4 = self.speed_rad_s
        if not self._dirty and self._simple:
            r1, r2, r3, r4 = self._reach
            if -r1 < s1 < r1 and -r2 < s2 < r2 and -r3 < s3 < r3 and -r4 < s4 < r4:
                return
        c1, c2, c3, c4 = self.command_nm
        w1, w2, w3, w4 = self._wheels
        torque = (w1.drive(c1, s1), w2.drive(c2, s2), w3.drive(c3, s3), w4.drive(c4, s4))
        if self._dirty or torque != self.torque_nm:
            self.torque_nm = torque
            self.torque_b_nm = self.combine(torque)
            self._reach = (w1.reach, w2.reach, w3.reach, w4.reach)
            self._dirty = False

    def look(self, step: int) -> None:
        """Bring the faults up to date for the integration step `step`."""
        if step < self._next_look:
            return
        t_s = (step + 0.5) * self._step_s
        wheels = a, b, c, d = self._wheels
        rising = [wheel.update_faults(step, t_s) for wheel in wheels]
        self._next_look = step + 1 if any(rising) else min(wheel.chain.next_edge for wheel in wheels)
        self.silent = (a.silent, b.silent, c.silent, d.silent)
        self._dirty = True

    def spin(self, h_b_nms: Vec3, omega_bi_b_rad_s: Vec3) -> None:
        """Advance the rotors' momentum by one step with the torque that `drive` set.

        h_b_nms, omega_bi_b_rad_s : its sum and the body's rate by then
        """
        a, b, c, d = self.h_nms
        t1, t2, t3, t4 = self.torque_nm
        dt = self._step_s
        self.h_nms = (a - t1 * dt, b - t2 * dt, c - t3 * dt, d - t4 * dt)
        self.h_b_nms = h_b_nms
        self._measure_speed(omega_bi_b_rad_s)

    def _measure_speed(self, omega_bi_b_rad_s: Vec3) -> None:
        """Set the speeds relative to a body that turns at omega."""
        x, y, z = omega_bi_b_rad_s
        a, b, c, d = self.h_nms
        ia, ib, ic, id_ = self._inverse_inertia
        ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz = self._axes
        self.speed_rad_s = (
            a * ia - ax * x - ay * y - az * z,
            b * ib - bx * x - by * y - bz * z,
            c * ic - cx * x - cy * y - cz * z,
            d * id_ - dx * x - dy * y - dz * z,
        )

    # -- telemetry -------------------------------------------------------------------------------------------------

    def sample_speed(self) -> Vec4:
        """Return the tachometer readings [rad/s]: each noisy from its own stream."""
        if not self._tacho:
            return self.speed_rad_s
        a, b, c, d = (
            speed + sigma * draw() for speed, (sigma, draw) in zip(self.speed_rad_s, self._tacho, strict=True)
        )
        return (a, b, c, d)

    def sample_current(self) -> Vec4:
        """Return the motor currents over the last step [A]: motor torque, drag not included, over motor constant."""
        a, b, c, d = self._wheels
        return (
            a.motor_nm * a.ampere_per_nm,
            b.motor_nm * b.ampere_per_nm,
            c.motor_nm * c.ampere_per_nm,
            d.motor_nm * d.ampere_per_nm,
        )

    def sample_status(self) -> tuple[int, int, int, int]:
        """Return each wheel's status: 0 ok, 2 no command, 3 speed limit."""
        wheels = a, b, c, d = self._wheels
        if self.commanded == ALL and not (a.limited or b.limited or c.limited or d.limited):
            return ALL_OK
        states = [
            SPEED_LIMIT if wheel.limited else OK if commanded else NO_COMMAND
            for commanded, wheel in zip(self.commanded, wheels, strict=True)
        ]
        return (states[0], states[1], states[2], states[3])
