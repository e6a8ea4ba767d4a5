"""The plant: rigid body, wheels, sensors, environment and faults, advanced tick by tick. Knows no bus and no clock.

`sample` gives what the units measure at tick k, `truth` what is so, `step` goes to k + 1 in tick / step_s integration steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from bus.attitude import IDENTITY, angle_between, normalise, rotate
from bus.errors import ConfigError
from bus.units import DEG, Mat3, Vec3, Vec4
from plant_server.config import FaultConfig, PlantConfig
from plant_server.dynamics import build_stepper, invert_symmetric, multiply_matrix
from plant_server.environment import Environment
from plant_server.faults import FaultEvent, FaultTimeline, check_faults, format_path
from plant_server.gyro import Gyro, fill_preset
from plant_server.star_tracker import StarFrame, StarTracker
from plant_server.validation import validate
from plant_server.wheels.wheel_set import WheelSet

__all__ = ["TRUTH_FIELDS", "FaultEvent", "Plant", "Samples"]

Status3 = tuple[int, int, int]
Status4 = tuple[int, int, int, int]
Flags3 = tuple[bool, bool, bool]
Flags4 = tuple[bool, bool, bool, bool]

NORMALISE_MASK = 0xFF  # the attitude's norm, kept by each step but for 1e-16, is set right every 256 steps
INTERVAL = "mean over the tick that ended now"

# group -> (name, count, unit, meaning), in the order of `Plant.truth()`
TRUTH_FIELDS: dict[str, tuple[tuple[str, int, str, str], ...]] = {
    "attitude": (
        ("q_ib", 4, "", "attitude, scalar first, v_i = R(q_ib) v_b"),
        ("omega_bi_b_rad_s", 3, "rad/s", "rate of the body with respect to inertial, body axes"),
        ("error_deg", 1, "deg", "angle between the attitude and the target's"),
        ("h_total_i_nms", 3, "N m s", "total angular momentum, body and wheels, inertial axes"),
    ),
    "wheels": (
        ("speed_rad_s", 4, "rad/s", "rotor speeds relative to the body"),
        ("tau_rw_true_nm", 4, "N m", f"torque of each wheel on the body about its true axis, {INTERVAL}"),
        ("tau_rw_cmd_nm", 4, "N m", "torque command that was in effect over the tick that ended now"),
        ("h_rw_b_nms", 3, "N m s", "spin momentum of the rotors, absolute, body axes"),
        ("tau_fault_b_nm", 3, "N m", f"D tau_rw_true - D0 tau_rw_cmd, body axes, {INTERVAL}"),
        ("tau_ext_b_nm", 3, "N m", f"external torque, body axes, {INTERVAL}"),
    ),
    "gyro": (
        ("bias_b_rad_s", 3, "rad/s", "turn-on bias, bias instability and rate random walk in the present sample"),
        ("fault_b_rad_s", 3, "rad/s", "what the faults add to the present sample; 0 while an axis is silent"),
    ),
}


# attitude, rate, momentum of the stepper; of the wheels: speed, momentum, command, and what it would be on the body; means
# over the last tick; bias and fault of the gyro's axes
Snapshot = tuple[Vec4, Vec3, Vec3, Vec4, Vec3, Vec4, Vec3, tuple[Vec4, Vec3, Vec3], tuple[float, ...]]


class Samples(NamedTuple):
    """What the units report at one tick. A silent unit's values are there, but its frame must not be sent."""

    tick: int
    gyro_rate_rad_s: Vec3  # per sensing axis
    gyro_status: Status3  # 0 ok, 2 out of range
    gyro_silent: Flags3
    star: StarFrame | None  # (q_ib, age_ticks); age 15: not valid; None: no frame on this tick
    wheel_speed_rad_s: Vec4
    wheel_current_a: Vec4
    wheel_status: Status4  # 0 ok, 2 no command, 3 speed limit
    wheel_silent: Flags4
    any_silent: bool
    events: tuple[FaultEvent, ...]  # faults that took effect or ended since the last sample


class Plant:
    """Truth model of one spacecraft."""

    __slots__ = (
        "_environment", "_ext_b_nm", "_gyro", "_gyroscopic", "_h_b", "_h_rw", "_means", "_momentum", "_omega",
        "_per_tick_s", "_q_ib", "_seconds", "_speed", "_star", "_step", "_stepper", "_steps_per_tick", "_target_q",
        "_tick_s", "_timeline", "_turn", "_wheels", "config", "tick",
    )  # fmt: skip

    def __init__(
        self,
        config: PlantConfig,
        faults: tuple[FaultConfig, ...],
        tick_s: float,
        seed: int,
        target_q: Vec4 = IDENTITY,
    ) -> None:
        """Put the plant at tick 0.

        tick_s   : period of the loop [s], a whole multiple of config.step_s
        target_q : attitude that truth's error angle is counted from, scalar first
        Raises ConfigError with everything that is wrong with the settings and the faults.
        """
        problems = [f"plant{format_path(p.path)}: {p.message}" for p in validate(config, tick_s)]
        problems += [f"faults{format_path(p.path)}: {p.message}" for p in check_faults(faults)]
        problems += [
            f"faults[{i}].kind: {word}" for i, fault in enumerate(faults) if (word := _find_futile(fault, config))
        ]
        if problems:
            raise ConfigError(*problems)
        self.config = config
        self.tick = 0
        self._step = 0
        self._tick_s = tick_s
        self._per_tick_s = 1.0 / tick_s
        self._steps_per_tick = round(tick_s / config.step_s)
        self._seconds = tick_s / self._steps_per_tick
        self._target_q = normalise(target_q)
        self._timeline = FaultTimeline(faults, step_s=self._seconds, steps_per_tick=self._steps_per_tick, seed=seed)
        x, y, z = config.body.rate_deg_s
        self._omega: Vec3 = (x * DEG, y * DEG, z * DEG)
        self._q_ib = normalise(config.body.attitude_q)
        self._wheels = wheels = WheelSet(config, self._timeline, self._seconds, seed)
        a, b, c, d = (wheel.speed_rad_s for wheel in config.wheels)
        self._speed: Vec4 = (a, b, c, d)  # of the rotors, relative to the body
        self._h_rw = wheels.find_momenta(self._speed, self._omega)
        self._h_b = wheels.combine(self._h_rw)
        inertia = _symmetrise(config.body.inertia_kgm2)
        self._gyroscopic = config.body.wheel_gyroscopic
        self._stepper = build_stepper(invert_symmetric(inertia), self._seconds, wheels.axes_b, wheels.inertia_kgm2)
        self._momentum = multiply_matrix(inertia, self._omega)  # what the stepper integrates, see dynamics.py
        if self._gyroscopic:
            self._momentum = _add(self._momentum, self._h_b)
        self._environment = Environment(config.torques, wheels.add_rotors(inertia))
        self._ext_b_nm: Vec3 = self._environment.constant_b_nm  # external torque over the last step
        self._gyro = Gyro(config.gyro, self._timeline, tick_s, seed)
        self._star = StarTracker(config.star_tracker, self._timeline, tick_s, seed)
        self._turn = _scale(self._omega, tick_s)  # angle about each body axis over the last tick
        # means over the last tick: torque of each wheel, their sum on the body, external torque
        self._means: tuple[Vec4, Vec3, Vec3] = ((0.0, 0.0, 0.0, 0.0), NOTHING, NOTHING)

    # -- measuring -------------------------------------------------------------------------------------------------

    def sample(self) -> Samples:
        """Return what the units measure now. Once per tick: sensors draw their noise here."""
        return Samples._make(self.measure())

    def measure(self) -> tuple[Any, ...]:
        """The same as a plain tuple, in the order of `Samples`, for whom a tick must not cost more than it does."""
        step, tick = self._step, self.tick
        t_s = tick * self._tick_s
        wheels, gyro, star, timeline = self._wheels, self._gyro, self._star, self._timeline
        if step >= wheels.next_look:
            wheels.look(step)
        rate = gyro.sample(self._omega if gyro.instantaneous else _scale(self._turn, self._per_tick_s), step, t_s)
        silent, wheel_silent = gyro.silent, wheels.silent
        return (
            tick, rate, gyro.status, silent,
            star.sample(tick, self._q_ib, self._omega, step, t_s) if tick >= star.next_tick else None,
            wheels.sample_speed(self._speed) if wheels.noisy else self._speed, wheels.current_a, wheels.status,
            wheel_silent, True in silent or True in wheel_silent,
            timeline.take_events(step) if step >= timeline.next_edge else (),
        )  # fmt: skip

    def snapshot(self) -> Snapshot:
        """Return what is so now as it stands; `expand` makes the truth of it, at any later time."""
        wheels = self._wheels
        return (
            self._q_ib, self._omega, self._momentum, self._speed, self._h_b, wheels.command_nm, wheels.command_b_nm,
            self._means, self._gyro.truth_rad_s,
        )  # fmt: skip

    def expand(self, snapshot: Snapshot) -> tuple[float, ...]:
        """Return what was so at a snapshot, flat, in the order of TRUTH_FIELDS."""
        q, omega, momentum, speed, h, command, (fx, fy, fz), (tau, (tx, ty, tz), external), gyro = snapshot
        if not self._gyroscopic:
            momentum = _add(momentum, h)
        error_deg = angle_between(self._target_q, q) / DEG
        return (
            *q, *omega, error_deg, *rotate(q, momentum),
            *speed, *tau, *command, *h, tx - fx, ty - fy, tz - fz, *external,
            *gyro,
        )  # fmt: skip

    def truth(self) -> tuple[float, ...]:
        """Return what is so now, flat, in the order of TRUTH_FIELDS."""
        return self.expand(self.snapshot())

    # -- moving ----------------------------------------------------------------------------------------------------

    def step(self, tau_rw_cmd_nm: Sequence[float | None]) -> None:
        """Advance one tick with these torque commands in effect.

        tau_rw_cmd_nm : torque each wheel is to put on the body about its axis [N m], shape (4,); None: it has no
                        command, gives no motor torque and reports so
        """
        wheels = self._wheels
        if tau_rw_cmd_nm != wheels.command_nm or not wheels.commanded:
            wheels.receive(tau_rw_cmd_nm)
        if self._steps_per_tick == 1:
            self._turn = self._advance()
            self._means = (wheels.torque_nm, wheels.torque_b_nm, self._ext_b_nm)
        else:
            self._advance_many()
        self.tick += 1

    def _advance(self) -> Vec3:
        """Advance one integration step; return the angle turned through about each body axis [rad]."""
        wheels, step, speed = self._wheels, self._step, self._speed
        a, b, c, d = speed
        r = wheels.reach_rad_s
        if step >= wheels.next_look or not (-r < a < r and -r < b < r and -r < c < r and -r < d < r):
            wheels.drive(step, speed)
        external = self._environment.constant_b_nm if self._environment.is_constant else self._find_external()
        self._ext_b_nm = external
        tau = wheels.torque_nm
        tx, ty, tz = wheels.torque_b_nm
        if self._gyroscopic:
            self._q_ib, self._momentum, self._h_b, self._omega, angle, self._h_rw, self._speed = self._stepper(
                self._q_ib, self._momentum, self._h_b, self._omega, (-tx, -ty, -tz), external, self._h_rw, tau
            )
        else:
            x, y, z = external
            self._q_ib, self._momentum, _, self._omega, angle, self._h_rw, self._speed = self._stepper(
                self._q_ib, self._momentum, NOTHING, self._omega, NOTHING, (x + tx, y + ty, z + tz), self._h_rw, tau
            )
            x, y, z = self._h_b
            dt = self._seconds
            self._h_b = (x - tx * dt, y - ty * dt, z - tz * dt)
        self._step = step + 1
        if not step & NORMALISE_MASK:
            self._q_ib = normalise(self._q_ib)
        return angle

    def _find_external(self) -> Vec3:
        """Return the external torque at mid-step, which is second order in the step for torques that change slowly."""
        q = _half_step(self._q_ib, self._omega, self._seconds)
        return self._environment.sum_torques((self._step + 0.5) * self._seconds, q)

    def _advance_many(self) -> None:
        """Advance all integration steps of a tick; keep the angle about each body axis and the means."""
        wheels = self._wheels
        count = self._steps_per_tick
        ax = ay = az = ex = ey = ez = bx = by = bz = t1 = t2 = t3 = t4 = 0.0
        for _ in range(count):
            x, y, z = self._advance()
            ax, ay, az = ax + x, ay + y, az + z
            x, y, z = self._ext_b_nm
            ex, ey, ez = ex + x, ey + y, ez + z
            x, y, z = wheels.torque_b_nm
            bx, by, bz = bx + x, by + y, bz + z
            a, b, c, d = wheels.torque_nm
            t1, t2, t3, t4 = t1 + a, t2 + b, t3 + c, t4 + d
        self._turn = (ax, ay, az)
        self._means = (
            (t1 / count, t2 / count, t3 / count, t4 / count),
            (bx / count, by / count, bz / count),
            (ex / count, ey / count, ez / count),
        )

    # -- faults ----------------------------------------------------------------------------------------------------

    def add_fault(self, fault: FaultConfig) -> int:
        """Return the index of a fault commanded during the run; it takes effect at its at_s, at once if that is past.

        Raises ConfigError when it is wrong, over already, or can have no effect on this plant.
        """
        if word := _find_futile(fault, self.config):
            raise ConfigError(f"fault.kind: {word}")
        index = self._timeline.add(fault, self._step)
        self._wheels.look_again()
        self._gyro.look_again()
        return index


NOTHING: Vec3 = (0.0, 0.0, 0.0)


def _add(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _scale(a: Vec3, k: float) -> Vec3:
    return (a[0] * k, a[1] * k, a[2] * k)


def _symmetrise(m: Mat3) -> Mat3:
    b, c, e = 0.5 * (m[0][1] + m[1][0]), 0.5 * (m[0][2] + m[2][0]), 0.5 * (m[1][2] + m[2][1])
    return ((m[0][0], b, c), (b, m[1][1], e), (c, e, m[2][2]))


def _half_step(q: Vec4, omega: Vec3, dt_s: float) -> Vec4:
    """Return the attitude half a step on, first order; for torques only."""
    q0, q1, q2, q3 = q
    k = 0.25 * dt_s
    x, y, z = omega[0] * k, omega[1] * k, omega[2] * k
    return (
        q0 - q1 * x - q2 * y - q3 * z,
        q1 + q0 * x + q2 * z - q3 * y,
        q2 + q0 * y + q3 * x - q1 * z,
        q3 + q0 * z + q1 * y - q2 * x,
    )


def _find_futile(fault: FaultConfig, config: PlantConfig) -> str | None:
    """Return why a fault can have no effect on this plant, whatever happens; None when it can."""
    if fault.kind == "noise" and fault.unit.startswith("gyro") and not fill_preset(config.gyro).arw_rad_sqrt_s > 0.0:
        preset = config.gyro.preset
        return f"more noise has no effect: the gyro ({preset}) has no angle random walk; give gyro.arw_rad_sqrt_s"
    if math.isclose(fault.effectiveness or 0.0, 1.0, abs_tol=1e-12):
        return "a loss to effectiveness 1 has no effect; give less than 1"
    return None
