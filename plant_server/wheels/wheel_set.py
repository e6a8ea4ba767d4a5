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
    """Four wheels: what torque they give, what they report. Their momentum is the business of dynamics.py."""

    __slots__ = (
        "_axes", "_commanded", "_nominal_axes", "_simple", "_step_s", "_tacho", "_wheels", "axes_b", "command_b_nm",
        "command_nm", "commanded", "current_a", "inertia_kgm2", "next_look", "noisy", "reach_rad_s", "silent", "status",
        "torque_b_nm", "torque_nm",
    )  # fmt: skip

    def __init__(self, config: PlantConfig, timeline: FaultTimeline, step_s: float, seed: int) -> None:
        self._step_s = step_s
        self._wheels = a, b, c, d = tuple(
            ReactionWheel(wheel, timeline.chains[unit], step_s)
            for unit, wheel in zip(WHEELS, config.wheels, strict=True)
        )
        self._simple = all(wheel.simple for wheel in self._wheels)
        self.axes_b = tuple(true_axis(w.mount, w.tilt_deg, w.clock_deg) for w in config.wheels)
        self._axes = tuple(component for axis in self.axes_b for component in axis)
        self._nominal_axes = tuple(component for w in config.wheels for component in nominal_axis(w.mount))
        self.inertia_kgm2: Vec4 = (a.inertia, b.inertia, c.inertia, d.inertia)
        self.noisy = any(wheel.speed_noise_rad_s > 0.0 for wheel in config.wheels)
        units = zip(WHEELS, config.wheels, strict=True)
        self._tacho = [(wheel.speed_noise_rad_s, open_normals(seed, unit)) for unit, wheel in units]
        self.command_nm: Vec4 = ZERO
        self.command_b_nm = self.combine_nominal(ZERO)  # what it would be on the body with nominal axes
        self._commanded = (False, False, False, False)  # which have a command: nothing has come yet
        self.commanded = False  # all have
        self.silent = (False, False, False, False)  # which wheels send no telemetry
        self.current_a: Vec4 = ZERO  # of the motors over the last step: their torque over the motor constant
        self.status = self._find_status()  # of each wheel: 0 ok, 2 no command, 3 speed limit
        self.torque_nm: Vec4 = ZERO
        self.torque_b_nm: Vec3 = (0.0, 0.0, 0.0)
        self.next_look = -1  # step on which the faults must be looked at
        # While every speed is below this, the torque of the next step is that of the last; negative: it may be another.
        self.reach_rad_s = -1.0

    def find_momenta(self, speed_rad_s: Vec4, omega_bi_b_rad_s: Vec3) -> Vec4:
        """Return the absolute spin momentum of each rotor at these speeds relative to a body that turns at omega."""
        x, y, z = omega_bi_b_rad_s
        wheels = zip(speed_rad_s, self.axes_b, self.inertia_kgm2, strict=True)
        h = [inertia * (speed + (a * x + b * y + c * z)) for speed, (a, b, c), inertia in wheels]
        return (h[0], h[1], h[2], h[3])

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
        self._commanded = (a is not None, b is not None, c is not None, d is not None)
        self.commanded = self._commanded == ALL
        self.status = self._find_status()
        command = (a or 0.0, b or 0.0, c or 0.0, d or 0.0)
        if command != self.command_nm:
            self.command_nm = command
            self.command_b_nm = self.combine_nominal(command)
            self.reach_rad_s = -1.0

    def look_again(self) -> None:
        """Note that a fault was added to one of the chains."""
        self.next_look = -1

    def drive(self, step: int, speed_rad_s: Vec4) -> None:
        """Set `torque_nm` and `torque_b_nm`, the torques on the body over the integration step `step`."""
        if step >= self.next_look:
            self.look(step)
        s1, s2, s3, s4 = speed_rad_s
        c1, c2, c3, c4 = self.command_nm
        w1, w2, w3, w4 = self._wheels
        torque = (w1.drive(c1, s1), w2.drive(c2, s2), w3.drive(c3, s3), w4.drive(c4, s4))
        if torque != self.torque_nm:
            self.torque_nm = torque
            self.torque_b_nm = self.combine(torque)
        self.current_a = (
            w1.motor_nm * w1.ampere_per_nm,
            w2.motor_nm * w2.ampere_per_nm,
            w3.motor_nm * w3.ampere_per_nm,
            w4.motor_nm * w4.ampere_per_nm,
        )
        self.status = self._find_status()
        self.reach_rad_s = min(w1.reach, w2.reach, w3.reach, w4.reach) if self._simple else -1.0

    def look(self, step: int) -> None:
        """Bring the faults up to date for the integration step `step`: due once that reaches `next_look`."""
        t_s = (step + 0.5) * self._step_s
        wheels = a, b, c, d = self._wheels
        rising = [wheel.update_faults(step, t_s) for wheel in wheels]
        self.next_look = step + 1 if any(rising) else min(wheel.chain.next_edge for wheel in wheels)
        self.silent = (a.silent, b.silent, c.silent, d.silent)
        self.reach_rad_s = -1.0

    # -- telemetry -------------------------------------------------------------------------------------------------

    def sample_speed(self, speed_rad_s: Vec4) -> Vec4:
        """Return the tachometer readings [rad/s], each noisy from its own stream: for `noisy` wheels."""
        a, b, c, d = (speed + sigma * draw() for speed, (sigma, draw) in zip(speed_rad_s, self._tacho, strict=True))
        return (a, b, c, d)

    def _find_status(self) -> tuple[int, int, int, int]:
        wheels = a, b, c, d = self._wheels
        if self.commanded and not (a.limited or b.limited or c.limited or d.limited):
            return ALL_OK
        states = [
            SPEED_LIMIT if wheel.limited else OK if commanded else NO_COMMAND
            for commanded, wheel in zip(self._commanded, wheels, strict=True)
        ]
        return (states[0], states[1], states[2], states[3])
