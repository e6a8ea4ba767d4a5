"""What one stage of the flight cycle hands to the next.

Vectors are plain tuples of floats in body axes unless named otherwise. A record that a cycle makes is not changed any more
once it is handed on, but for `Sensors` with its `WheelReading`s and `WheelPower`s: there is one of each, brought up to date
every cycle, so that whoever needs a value of an earlier cycle keeps the value and not the record.
"""

from __future__ import annotations

from bus.attitude import IDENTITY
from bus.linear import ZERO3, ZERO4
from bus.record import Record
from bus.units import Vec3, Vec4

Flags3 = tuple[bool, bool, bool]  # one per gyro axis
Flags4 = tuple[bool, bool, bool, bool]  # one per wheel
ALL_AXES: Flags3 = (True, True, True)
ONES4: Vec4 = (1.0, 1.0, 1.0, 1.0)
Ints4 = tuple[int, int, int, int]
NO_KIND: Ints4 = (0, 0, 0, 0)
ALL_WHEELS: Flags4 = (True, True, True, True)
NO_WHEEL: Flags4 = (False, False, False, False)


class WheelReading(Record):
    """What one wheel reports. A value that has not come for a while is held and marked not valid."""

    __slots__ = ("current_a", "h_nms", "new", "speed_rad_s", "status", "valid")

    def __init__(
        self,
        speed_rad_s: float = 0.0,
        current_a: float = 0.0,
        status: int = 0,
        valid: bool = True,
        h_nms: float = 0.0,
        new: bool = True,
    ) -> None:
        self.speed_rad_s = speed_rad_s  # of the rotor, relative to the body, about the nominal axis
        self.current_a = current_a  # of the motor
        self.status = status  # as its frame says: 0 ok, 1 fault, 2 no command, 3 speed limit
        self.valid = valid  # False once its last frame is older than the staleness limit
        self.h_nms = h_nms  # momentum relative to the body: speed times rotor inertia
        self.new = new  # its frame came on this tick; False: the values are those of an earlier one, held


FourReadings = tuple[WheelReading, WheelReading, WheelReading, WheelReading]


def four_readings() -> FourReadings:
    """Four wheels at rest that have been heard."""
    return (WheelReading(), WheelReading(), WheelReading(), WheelReading())


NOT_HEARD = -(10**9)  # tick of a frame that has not come yet


class WheelPower(Record):
    """What one wheel reports once a second of its supply and itself, where it does; the last good values."""

    __slots__ = (
        "bus_current_a", "bus_v", "driver_c", "latch", "motor_c", "power_tick", "temp_tick", "uptime_s", "valid",
    )  # fmt: skip

    def __init__(self) -> None:
        self.motor_c = 0.0  # temperature of the motor [degC]
        self.driver_c = 0.0  # of the driver electronics [degC]
        self.bus_v = 0.0  # voltage of the supply [V]
        self.bus_current_a = 0.0  # drawn from it [A]
        self.latch = 0  # bits of bus/wheels.py that the wheel has set and that are not cleared
        self.uptime_s = 0.0  # since it was last reset or switched on [s]
        self.temp_tick = NOT_HEARD  # on which temperatures and voltage came,
        self.power_tick = NOT_HEARD  # and current, latch and uptime
        self.valid = False  # both have come lately

    def count_age_ticks(self, tick: int) -> int:
        """Return the age of the older half at a tick [ticks]; of a half that has not come yet, huge."""
        return tick - min(self.temp_tick, self.power_tick)


FourPowers = tuple[WheelPower, WheelPower, WheelPower, WheelPower]


def four_powers() -> FourPowers:
    """Slow telemetry of four wheels of which none has been heard."""
    return (WheelPower(), WheelPower(), WheelPower(), WheelPower())


class Sensors(Record):
    """What the validated bus traffic up to one tick says. A stale or failed unit is marked, never left out."""

    __slots__ = (
        "gyro_valid",
        "omega_meas_b_rad_s",
        "powers",
        "q_ib_meas",
        "star_age_s",
        "star_new",
        "star_valid",
        "t_s",
        "tick",
        "wheels",
    )

    def __init__(
        self,
        tick: int = 0,
        t_s: float = 0.0,
        omega_meas_b_rad_s: Vec3 = ZERO3,
        gyro_valid: Flags3 = ALL_AXES,
        q_ib_meas: Vec4 = IDENTITY,
        star_new: bool = False,
        star_valid: bool = False,
        star_age_s: float = 0.0,
        wheels: FourReadings | None = None,
        powers: FourPowers | None = None,
    ) -> None:
        self.tick = tick
        self.t_s = t_s  # tick * base period
        # gyro rate per axis, mean over the last tick; last good value where not valid
        self.omega_meas_b_rad_s = omega_meas_b_rad_s
        self.gyro_valid = gyro_valid
        self.q_ib_meas = q_ib_meas  # star-tracker attitude, scalar first, unit norm
        self.star_new = star_new  # True on the tick on which q_ib_meas arrived
        self.star_valid = star_valid  # False once the last one is older than the staleness limit
        self.star_age_s = star_age_s  # age of q_ib_meas at this tick (0.0: measured at this tick)
        self.wheels: FourReadings = four_readings() if wheels is None else wheels
        self.powers: FourPowers = four_powers() if powers is None else powers

    def wheel_momenta(self) -> Vec4:
        """Momentum of each wheel relative to the body [N m s]; last good value where not valid."""
        a, b, c, d = self.wheels
        return (a.h_nms, b.h_nms, c.h_nms, d.h_nms)

    def wheels_valid(self) -> Flags4:
        """Which wheels have been heard lately."""
        a, b, c, d = self.wheels
        return (a.valid, b.valid, c.valid, d.valid)

    def wheels_new(self) -> Flags4:
        """Which wheels have been heard on this tick: what the others say is held from an earlier one."""
        a, b, c, d = self.wheels
        return (a.valid and a.new, b.valid and b.new, c.valid and c.new, d.valid and d.new)


class Estimate(Record):
    """Attitude and rate as the controllers use them."""

    __slots__ = ("bias_b_rad_s", "omega_bi_b_rad_s", "q_ib", "valid")

    def __init__(self, q_ib: Vec4, omega_bi_b_rad_s: Vec3, bias_b_rad_s: Vec3, valid: bool) -> None:
        self.q_ib = q_ib  # scalar first, Hamilton: v_i = R(q_ib) v_b
        self.omega_bi_b_rad_s = omega_bi_b_rad_s
        self.bias_b_rad_s = bias_b_rad_s  # gyro bias estimate (zeros where the estimator has none)
        self.valid = valid  # False: not fit for pointing


class Detection(Record):
    """What gyro fault detection found, and the estimate to use from here on."""

    __slots__ = ("estimate", "fault_hat_b_rad_s", "gyro_state", "rate_good", "rate_step_b_rad_s", "request_safe")

    def __init__(
        self,
        estimate: Estimate,
        rate_step_b_rad_s: Vec3,
        gyro_state: tuple[int, int, int],
        fault_hat_b_rad_s: Vec3,
        request_safe: bool,
        rate_good: bool,
    ) -> None:
        self.estimate = estimate
        # jump of the rate source at this tick, for bumpless transfer to observers (usually zeros)
        self.rate_step_b_rad_s = rate_step_b_rad_s
        self.gyro_state = gyro_state  # 0 nominal, 1 suspect, 2 alarm, 3 classified
        self.fault_hat_b_rad_s = fault_hat_b_rad_s  # gyro fault estimate per axis
        self.request_safe = request_safe  # True: rate knowledge is no longer good enough to point
        # False: the rate above is not fit even for damping (no gyro and nothing in its place)
        self.rate_good = rate_good


class WheelHealth(Record):
    """What is thought of the four wheels. What a monitor does not know stays at its default."""

    __slots__ = (
        "alarm",
        "available",
        "bias_nm",
        "confidence",
        "dead",
        "deficit_nm",
        "dither",
        "dither_rw_nm",
        "driver_gain",
        "effectiveness",
        "explained_b_nm",
        "friction_nm",
        "kind",
        "probe_rw_nm",
        "torque_gain",
    )

    def __init__(
        self,
        effectiveness: Vec4 = ONES4,
        available: Flags4 = ALL_WHEELS,
        alarm: Flags4 = NO_WHEEL,
        explained_b_nm: Vec3 = ZERO3,
        driver_gain: Vec4 = ONES4,
        torque_gain: Vec4 = ONES4,
        friction_nm: Vec4 = ZERO4,
        deficit_nm: Vec4 = ZERO4,
        kind: Ints4 = NO_KIND,
        confidence: Vec4 = ZERO4,
        dither: int = 0,
        dither_rw_nm: Vec4 = ZERO4,
        bias_nm: Vec4 = ZERO4,
        dead: Flags4 = NO_WHEEL,
        probe_rw_nm: Vec4 = ZERO4,
    ) -> None:
        self.effectiveness = effectiveness  # share of its commanded torque that each gives, 0 .. 1
        self.available = available  # False: not to be used
        self.alarm = alarm  # True while a wheel's torque is not what was commanded
        # the part of the observer's fault torque that `effectiveness` accounts for
        self.explained_b_nm = explained_b_nm
        self.driver_gain = driver_gain  # current against that of a sound driver, C_d
        self.torque_gain = torque_gain  # torque against that of a sound motor at its current, C_t
        self.friction_nm = friction_nm  # beyond the nominal, opposing the spin
        self.deficit_nm = (
            deficit_nm  # torque that the rotor lacks, whatever took it; about the wheel's axis, of the rotor
        )
        self.kind = kind  # of fault, see fsw/wheel_kinds.py
        self.confidence = confidence  # that it is this kind, 0 .. 1; of one not known yet, the likelier's
        self.dither = dither  # 0 off, 1 on, 2 asked for but the wheels in use leave no null space
        self.dither_rw_nm = dither_rw_nm  # to be added to the wheels' torques; no torque on the body
        self.bias_nm = bias_nm  # torque on the body that each wheel gives whatever it is told, about its axis
        self.dead = dead  # True: no torque is planned on it, yet it stays on, so that a recovery shows
        self.probe_rw_nm = probe_rw_nm  # what dead wheels are told meanwhile; zero for the others

    def find_usable(self) -> Flags4:
        """Return which wheels a torque can be planned on: available, and not dead."""
        if self.dead == NO_WHEEL:
            return self.available
        (p, q, r, s), (t, u, v, w) = self.available, self.dead
        return (p and not t, q and not u, r and not v, s and not w)

    def find_shares(self) -> Vec4:
        """Return the share of its command that each wheel gives that can be used, 0 for the others [1]."""
        usable = self.find_usable()
        if usable == ALL_WHEELS:
            return self.effectiveness
        (a, b, c, d), (p, q, r, s) = self.effectiveness, usable
        return (a if p else 0.0, b if q else 0.0, c if r else 0.0, d if s else 0.0)

    def replace(self, effectiveness: Vec4, available: Flags4, explained_b_nm: Vec3) -> WheelHealth:
        """Return the same with other wheels to reckon with."""
        return WheelHealth(
            effectiveness, available, self.alarm, explained_b_nm, self.driver_gain, self.torque_gain, self.friction_nm,
            self.deficit_nm, self.kind, self.confidence, self.dither, self.dither_rw_nm, self.bias_nm, self.dead,
            self.probe_rw_nm,
        )  # fmt: skip


HEALTHY = WheelHealth()


def without(health: WheelHealth, fitted: Flags4) -> WheelHealth:
    """Return the same health with no wheel available that is not fitted."""
    (p, q, r, s), (a, b, c, d) = health.available, fitted
    return health.replace(health.effectiveness, (p and a, q and b, r and c, s and d), health.explained_b_nm)


class Target(Record):
    """Where the body is to point, and how that moves."""

    __slots__ = ("alpha_ti_t_rad_s2", "omega_ti_t_rad_s", "q_it")

    def __init__(self, q_it: Vec4, omega_ti_t_rad_s: Vec3 = ZERO3, alpha_ti_t_rad_s2: Vec3 = ZERO3) -> None:
        self.q_it = q_it  # attitude of the target in inertial, scalar first, unit norm
        self.omega_ti_t_rad_s = omega_ti_t_rad_s  # rate of the target with respect to inertial, target axes
        self.alpha_ti_t_rad_s2 = alpha_ti_t_rad_s2  # its rate of change, target axes

    @property
    def at_rest(self) -> bool:
        """True where the target does not move."""
        return self.omega_ti_t_rad_s == ZERO3 and self.alpha_ti_t_rad_s2 == ZERO3


class PointingError(Record):
    """The body with respect to its target."""

    __slots__ = ("alpha_ti_b_rad_s2", "omega_bt_b_rad_s", "omega_ti_b_rad_s", "q_tb")

    def __init__(
        self, q_tb: Vec4, omega_bt_b_rad_s: Vec3, omega_ti_b_rad_s: Vec3 = ZERO3, alpha_ti_b_rad_s2: Vec3 = ZERO3
    ) -> None:
        self.q_tb = q_tb  # scalar first; the sign is chosen with hysteresis, so that q0 >= 0 but near the half turn
        self.omega_bt_b_rad_s = omega_bt_b_rad_s  # rate of the body with respect to the target, body axes
        self.omega_ti_b_rad_s = omega_ti_b_rad_s  # the target's own rate, body axes
        self.alpha_ti_b_rad_s2 = alpha_ti_b_rad_s2  # and its rate of change as seen in inertial, body axes


class Allocation(Record):
    """What the wheels are to give."""

    __slots__ = ("achieved_b_nm", "axes", "bias_nm", "margin", "shares", "tau_rw_nm")

    def __init__(
        self,
        tau_rw_nm: Vec4 = ZERO4,
        achieved_b_nm: Vec3 = ZERO3,
        margin: float = 1.0,
        shares: Vec4 = ONES4,
        bias_nm: Vec4 = ZERO4,
        axes: int = 3,
    ) -> None:
        self.tau_rw_nm = tau_rw_nm  # torque of each wheel on the body, within its limits
        # the body torque that these add up to, if each wheel gives what it is told
        self.achieved_b_nm = achieved_b_nm
        self.margin = margin  # share of the most loaded wheel's torque that is still free, 0 .. 1
        # What was reckoned with: share of its torque that each wheel gives, and what it gives whatever it is told
        self.shares = shares
        self.bias_nm = bias_nm
        self.axes = axes  # how many directions of torque the wheels span that were reckoned with


class WheelCommands(Record):
    """What goes out to the wheels, and what that is meant to do to the body.

    The two differ where the drive makes up for drag or lost gain: the frames then ask for more than the body is to feel.
    Whoever models the wheel reckons with what was sent; law, observer and detectors with what was meant.
    """

    __slots__ = ("meant_nm", "modes", "saturated", "tau_rw_nm")

    def __init__(
        self, modes: tuple[int, int, int, int], tau_rw_nm: Vec4, saturated: int, meant_nm: Vec4 | None = None
    ) -> None:
        self.modes = modes  # of each command frame: 0 off, 1 torque
        self.tau_rw_nm = tau_rw_nm  # torque on the body, as the frames carry it
        self.saturated = saturated  # how many of the four had to be cut to what a frame can carry
        self.meant_nm = tau_rw_nm if meant_nm is None else meant_nm  # torque that the body is to feel of it
