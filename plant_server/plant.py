"""The plant: rigid body, wheels, sensors, environment and faults, advanced tick by tick. Knows no bus and no clock.

`sample` gives what the units measure at tick k, `truth` what is so, `step` goes to k + 1 in tick / step_s integration steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from bus.attitude import rotate
from bus.errors import ConfigError
from bus.linear import ZERO3, ZERO4, scale
from bus.record import Record
from bus.units import DEG, Mat3, Vec3, Vec4
from bus.wheels import ALL_BITS
from plant_server.config import PlantConfig
from plant_server.dynamics import RigidBody
from plant_server.environment import Environment
from plant_server.faults import WHEELS, Fault, FaultEvent, FaultTimeline, ListedFault, check_faults
from plant_server.faults.timeline import format_path
from plant_server.gyro.triad import Gyro
from plant_server.star_tracker import StarFrame, StarTracker
from plant_server.truth import Truth
from plant_server.validation import validate
from plant_server.wheels.bank import Flags4, Status4, WheelBank
from plant_server.wheels.four_wheels import FourWheels

__all__ = ["FaultEvent", "Plant", "Samples", "Snapshot"]

Status3 = tuple[int, int, int]
Flags3 = tuple[bool, bool, bool]


class Samples(Record):
    """What the units report at one tick. A silent unit's values are there, but its frame must not be sent."""

    __slots__ = (
        "events",
        "gyro_rate_rad_s",
        "gyro_silent",
        "gyro_status",
        "star",
        "wheel_current_a",
        "wheel_silent",
        "wheel_speed_rad_s",
        "wheel_status",
    )

    def __init__(
        self,
        gyro_rate_rad_s: Vec3,
        gyro_status: Status3,
        gyro_silent: Flags3,
        star: StarFrame | None,
        wheel_speed_rad_s: Vec4,
        wheel_current_a: Vec4,
        wheel_status: Status4,
        wheel_silent: Flags4,
        events: tuple[FaultEvent, ...],
    ) -> None:
        self.gyro_rate_rad_s = gyro_rate_rad_s  # per sensing axis
        self.gyro_status = gyro_status  # 0 ok, 2 out of range
        self.gyro_silent = gyro_silent
        self.star = star  # (q_ib, age_ticks); age 15: not valid; None: no frame on this tick
        self.wheel_speed_rad_s = wheel_speed_rad_s
        self.wheel_current_a = wheel_current_a
        self.wheel_status = wheel_status  # 0 ok, 2 no command, 3 speed limit
        self.wheel_silent = wheel_silent
        self.events = events  # what has become of faults since the last samples


class Snapshot(Record):
    """What is so at a tick, as it stands in the models; `Plant.flatten` makes the truth of it, at any later time."""

    __slots__ = (
        "command_b_nm",
        "command_nm",
        "external_b_nm",
        "gyro_bias_rad_s",
        "gyro_fault_rad_s",
        "h_b_nms",
        "momentum_b_nms",
        "omega_bi_b_rad_s",
        "q_ib",
        "speed_rad_s",
        "tau_b_nm",
        "tau_rw_nm",
    )

    def __init__(
        self,
        q_ib: Vec4,
        omega_bi_b_rad_s: Vec3,
        momentum_b_nms: Vec3,
        speed_rad_s: Vec4,
        tau_rw_nm: Vec4,
        tau_b_nm: Vec3,
        external_b_nm: Vec3,
        command_nm: Vec4,
        command_b_nm: Vec3,
        h_b_nms: Vec3,
        gyro_bias_rad_s: Vec3,
        gyro_fault_rad_s: Vec3,
    ) -> None:
        self.q_ib = q_ib
        self.omega_bi_b_rad_s = omega_bi_b_rad_s
        self.momentum_b_nms = momentum_b_nms  # total
        self.speed_rad_s = speed_rad_s
        self.tau_rw_nm = tau_rw_nm  # means over the last tick: of each wheel on the body,
        self.tau_b_nm = tau_b_nm  # their sum,
        self.external_b_nm = external_b_nm  # and the external torque
        self.command_nm = command_nm
        self.command_b_nm = command_b_nm
        self.h_b_nms = h_b_nms
        self.gyro_bias_rad_s = gyro_bias_rad_s
        self.gyro_fault_rad_s = gyro_fault_rad_s


class Plant:
    """Truth model of one spacecraft."""

    __slots__ = (
        "_body", "_environment", "_ext_b_nm", "_gyro", "_has_no_power", "_seconds", "_star", "_step", "_steps_per_tick",
        "_tau_b_nm", "_tau_rw_nm", "_tick_s", "_timeline", "_turn_b_rad", "_wheels", "config", "tick",
    )  # fmt: skip

    def __init__(self, config: PlantConfig, faults: tuple[Fault, ...], tick_s: float, seed: int) -> None:
        """Put the plant at tick 0.

        tick_s : period of the loop [s], a whole multiple of config.step_s
        Raises ConfigError with everything that is wrong with the settings and the faults.
        """
        problems = [f"plant{format_path(p.path)}: {p.message}" for p in validate(config, tick_s)]
        problems += [f"faults{format_path(p.path)}: {p.message}" for p in check_faults(faults, config)]
        if problems:
            raise ConfigError(*problems)
        self.config = config
        self.tick = 0
        self._step = 0
        self._tick_s = tick_s
        self._steps_per_tick = count = round(tick_s / config.step_s)
        self._seconds = tick_s / count  # of an integration step
        self._timeline = timeline = FaultTimeline(
            faults, step_s=self._seconds, steps_per_tick=count, seed=seed, plant=config
        )
        omega = scale(config.body.rate_deg_s, DEG)
        self._wheels: WheelBank = FourWheels(config, timeline, self._seconds, seed, omega)
        inertia = _symmetrise(config.body.inertia_kgm2)
        self._body = RigidBody(
            inertia, config.body.attitude_q, omega, self._wheels.h_b_nms, self._seconds, config.body.wheel_gyroscopic
        )
        self._has_no_power = [False, False, False, False]  # which wheels have been switched off
        self._environment = Environment(config.torques, self._wheels.add_rotors(inertia))
        self._gyro = Gyro(config.gyro, timeline, tick_s, seed)
        self._star = StarTracker(config.star_tracker, timeline, tick_s, seed)
        self._turn_b_rad = scale(omega, tick_s)  # angle about each body axis over the last tick
        # means over the last tick: torque of each wheel, their sum on the body, external torque
        self._tau_rw_nm: Vec4 = ZERO4
        self._tau_b_nm: Vec3 = ZERO3
        self._ext_b_nm: Vec3 = ZERO3

    # -- measuring -------------------------------------------------------------------------------------------------

    def sample(self) -> Samples:
        """Return what the units measure now. Once per tick: sensors draw their noise here."""
        step, tick, body = self._step, self.tick, self._body
        t_s = tick * self._tick_s
        wheels, gyro, star, timeline = self._wheels, self._gyro, self._star, self._timeline
        speed = wheels.sample_speed(step)
        turn = body.omega_bi_b_rad_s if gyro.instantaneous else scale(self._turn_b_rad, 1.0 / self._tick_s)
        rate = gyro.sample(turn, step, t_s)
        frame = None
        if tick >= star.next_tick:
            frame = star.sample(tick, body.q_ib, body.omega_bi_b_rad_s, step, t_s)
        events = timeline.take_events(step) if step >= timeline.next_event else ()
        return Samples(
            rate, gyro.status, gyro.silent, frame, speed, wheels.current_a, wheels.status, wheels.silent, events
        )

    def snapshot(self) -> Snapshot:
        """Return what is so now as it stands."""
        body, wheels, gyro = self._body, self._wheels, self._gyro
        return Snapshot(
            body.q_ib, body.omega_bi_b_rad_s, body.find_total_momentum(wheels.h_b_nms), wheels.speed_rad_s,
            self._tau_rw_nm, self._tau_b_nm, self._ext_b_nm, wheels.command_nm, wheels.command_b_nm, wheels.h_b_nms,
            gyro.bias_rad_s, gyro.fault_rad_s,
        )  # fmt: skip

    @staticmethod
    def flatten(now: Snapshot) -> tuple[float, ...]:
        """Return what was so at a snapshot, flat, in the order of TRUTH_FIELDS."""
        q0, q1, q2, q3 = now.q_ib
        wx, wy, wz = now.omega_bi_b_rad_s
        hx, hy, hz = rotate(now.q_ib, now.momentum_b_nms)
        s1, s2, s3, s4 = now.speed_rad_s
        t1, t2, t3, t4 = now.tau_rw_nm
        c1, c2, c3, c4 = now.command_nm
        rx, ry, rz = now.h_b_nms
        tx, ty, tz = now.tau_b_nm
        cx, cy, cz = now.command_b_nm
        ex, ey, ez = now.external_b_nm
        bx, by, bz = now.gyro_bias_rad_s
        fx, fy, fz = now.gyro_fault_rad_s
        return (
            q0, q1, q2, q3, wx, wy, wz, math.nan, hx, hy, hz,
            s1, s2, s3, s4, t1, t2, t3, t4, c1, c2, c3, c4, rx, ry, rz, tx - cx, ty - cy, tz - cz, ex, ey, ez,
            bx, by, bz, fx, fy, fz,
        )  # fmt: skip

    def truth(self) -> Truth:
        """Return what is so now."""
        return Truth.from_flat(self.flatten(self.snapshot()))

    # -- moving ----------------------------------------------------------------------------------------------------

    def step(self, tau_rw_cmd_nm: Sequence[float | None], modes: Status4 | None = None) -> None:
        """Advance one tick with these torque commands in effect.

        tau_rw_cmd_nm : torque each wheel is to put on the body about its axis [N m], shape (4,); None: it has no
                        command, gives no motor torque and reports so
        modes         : where some wheel is told a current or a speed in place of it: see `WheelBank.receive_modes`
        """
        wheels = self._wheels
        if modes is None:
            wheels.receive(tau_rw_cmd_nm)
        else:
            wheels.receive_modes(modes, tau_rw_cmd_nm)
        if self._steps_per_tick == 1:
            self._ext_b_nm = self._advance()
            self._turn_b_rad = self._body.turn_b_rad
            self._tau_rw_nm, self._tau_b_nm = wheels.torque_nm, wheels.torque_b_nm
        else:
            self._advance_many()
        self.tick += 1

    def _advance(self) -> Vec3:
        """Advance one integration step; return the external torque over it, body axes [N m]."""
        wheels, body, environment, step = self._wheels, self._body, self._environment, self._step
        wheels.drive(step)
        external = environment.constant_b_nm
        if not environment.is_constant:
            # at mid-step, which is second order in the step for torques that change slowly
            q = _half_step(body.q_ib, body.omega_bi_b_rad_s, self._seconds)
            external = environment.sum_torques((step + 0.5) * self._seconds, q)
        h_b_nms = body.advance(wheels.h_b_nms, wheels.torque_b_nm, external)
        wheels.advance(body.omega_bi_b_rad_s, h_b_nms)
        self._step = step + 1
        return external

    def _advance_many(self) -> None:
        """Advance all integration steps of a tick; keep the angle about each body axis and the means."""
        wheels, body, count = self._wheels, self._body, self._steps_per_tick
        ax = ay = az = ex = ey = ez = bx = by = bz = t1 = t2 = t3 = t4 = 0.0
        for _ in range(count):
            x, y, z = self._advance()
            ex, ey, ez = ex + x, ey + y, ez + z
            x, y, z = body.turn_b_rad
            ax, ay, az = ax + x, ay + y, az + z
            x, y, z = wheels.torque_b_nm
            bx, by, bz = bx + x, by + y, bz + z
            a, b, c, d = wheels.torque_nm
            t1, t2, t3, t4 = t1 + a, t2 + b, t3 + c, t4 + d
        self._turn_b_rad = (ax, ay, az)
        self._tau_rw_nm = (t1 / count, t2 / count, t3 / count, t4 / count)
        self._tau_b_nm = (bx / count, by / count, bz / count)
        self._ext_b_nm = (ex / count, ey / count, ez / count)

    # -- what is asked of a wheel beside its commands --------------------------------------------------------------

    @property
    def wheels(self) -> WheelBank:
        """The wheels, for what they report beside the samples."""
        return self._wheels

    def clear_latch(self, wheel: int, mask: int) -> None:
        """Clear these bits of what a wheel has latched."""
        self._wheels.clear_latch(wheel, mask)

    def reset_wheel(self, wheel: int) -> None:
        """Reset a wheel's electronics: nothing stays latched, and faults that last until a reset end."""
        self._wheels.clear_latch(wheel, ALL_BITS)
        self._recover_wheel(wheel, "reset_unit")

    def set_wheel_power(self, wheel: int, on: bool) -> None:
        """Switch a wheel's power; faults that last until a power cycle end when it comes back."""
        self._wheels.set_power(wheel, on)
        if on and self._has_no_power[wheel]:
            self._recover_wheel(wheel, "power_cycle_unit")
        self._has_no_power[wheel] = not on

    def power_cycle_wheel(self, wheel: int) -> None:
        """Switch a wheel's power off and on again."""
        self._has_no_power[wheel] = False
        self._wheels.power_cycle(wheel)
        self._recover_wheel(wheel, "power_cycle_unit")

    def _recover_wheel(self, wheel: int, way: str) -> None:
        """End what ends in this way, a method of the timeline that takes the unit and the step."""
        recover = getattr(self._timeline, way, None)
        if recover is not None:
            recover(WHEELS[wheel], self._step)
            self._wheels.look_again()

    @property
    def timeline(self) -> FaultTimeline:
        """When which fault acts, for what stands between the units and whoever hears them."""
        return self._timeline

    @property
    def next_step(self) -> int:
        """The integration step that comes next."""
        return self._step

    # -- faults ----------------------------------------------------------------------------------------------------

    def add_fault(self, fault: Fault) -> str:
        """Return the id of a fault commanded during the run; it takes effect at its at_s, at once if that is past.

        Raises ConfigError when it is wrong, over already, or can have no effect on this plant.
        """
        name = self._timeline.add(fault, self._step)
        self._wheels.look_again()
        return name

    def check_fault(self, fault: Fault) -> None:
        """Raise ConfigError, as `add_fault` would, when a fault cannot be added now."""
        self._timeline.check(fault, self._step)

    def clear_faults(self, *, id: str | None = None, unit: str | None = None) -> tuple[str, ...]:
        """End faults now: that of an id, those of a unit, all when neither is given; return their ids.

        Raises ConfigError when the id or the unit names no fault that waits or acts.
        """
        names = self._timeline.clear(self._step, id=id, unit=unit)
        self._wheels.look_again()
        return names

    def list_faults(self) -> tuple[ListedFault, ...]:
        """Return every fault of the run and how it stands now."""
        return self._timeline.list(self._step)


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
