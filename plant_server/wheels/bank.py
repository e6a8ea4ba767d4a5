"""What the plant needs of a set of four wheels, whatever model each of them has."""

from __future__ import annotations

from collections.abc import Sequence

from mypy_extensions import mypyc_attr

from bus.units import Mat3, Vec3, Vec4
from bus.wheels import OFF, TORQUE

Status4 = tuple[int, int, int, int]
Flags4 = tuple[bool, bool, bool, bool]
NO_WHEEL: Flags4 = (False, False, False, False)
NO_BITS: Status4 = (0, 0, 0, 0)
ON_TIME: Status4 = NO_BITS
IDEAL = "ideal"  # `model` of a wheel that has neither supply nor temperature to report


def has_slow_telemetry(model: object) -> bool:
    """Whether a wheel with this `model` in its settings sends RWi_TEMP and RWi_POWER; None: the settings name no model."""
    return model is not None and model != IDEAL


@mypyc_attr(allow_interpreted_subclasses=True)
class WheelBank:
    """Four wheels: it owns the state of the rotors, and gives mean torques on the body over each integration step.

    One step: `receive` (new commands, once a tick), `drive`, then, when the body has moved, `advance`.

    What stands here with a value is for wheels that have a motor, a supply and electronics of their own: a bank without
    leaves it as it is. Its wheels then send no slow telemetry, do not know current and speed commands, and have nothing
    that could be latched or switched.
    """

    __slots__ = ()

    # written out: the compiler takes literals as values of attributes, and no names of tuples
    has_slow_telemetry: Flags4 = (False, False, False, False)  # which send RWi_TEMP and RWi_POWER; settled at the start
    temperature_c: Vec4 = (0.0, 0.0, 0.0, 0.0)  # of the motors [degC]
    ambient_c: float = 20.0  # of what surrounds them, their drivers included [degC]
    bus_v: float = 0.0  # voltage of the supply [V]
    bus_current_a: Vec4 = (0.0, 0.0, 0.0, 0.0)  # drawn from it [A]; negative while a motor feeds power back
    latch: Status4 = (0, 0, 0, 0)  # bits of bus/wheels.py that each has set and not cleared
    late_ticks: Status4 = (0, 0, 0, 0)  # each sends the fast telemetry of so many ticks ago,
    counter_frozen: Flags4 = (False, False, False, False)  # and with an alive counter that stands

    speed_rad_s: Vec4  # of the rotors, relative to the body
    h_b_nms: Vec3  # spin momentum of the rotors, absolute, body axes
    torque_nm: Vec4  # of each wheel on the body about its true axis, mean over the last step
    torque_b_nm: Vec3  # their sum on the body
    command_nm: Vec4  # in effect
    command_b_nm: Vec3  # what it would be on the body with nominal axes
    current_a: Vec4  # of the motors at the end of the last step, as the telemetry has it
    status: Status4  # of each wheel's frame: 0 ok, 2 no command, 3 speed limit
    silent: Flags4  # which send no telemetry

    def receive(self, commands_nm: Sequence[float | None]) -> None:
        """Take the torque commands of this tick [N m]; None: the wheel has none, so its motor gives no torque."""
        raise NotImplementedError

    def receive_modes(self, modes: Status4, setpoints: Sequence[float | None]) -> None:
        """Take the commands of a tick on which not all wheels are told a torque; stands for `receive`.

        modes     : of each wheel, as in bus/wheels.py: OFF, TORQUE, CURRENT, SPEED
        setpoints : torque on the body [N m]; motor current, positive with the torque on the body [A]; speed of the rotor
                    relative to the body [rad/s]; None: the wheel has no command
        A wheel that does not know the mode has no command.
        """
        wheels = zip(modes, setpoints, strict=True)
        self.receive([setpoint if mode == TORQUE else 0.0 if mode == OFF else None for mode, setpoint in wheels])

    def clear_latch(self, wheel: int, mask: int) -> None:
        """Clear these bits of a wheel's latch; one whose cause is still there is set again."""

    def set_power(self, wheel: int, on: bool) -> None:
        """Switch a wheel's power; without, its motor gives no torque and the rotor coasts."""

    def power_cycle(self, wheel: int) -> None:
        """Switch a wheel's power off, and on again as soon as the model says."""

    def drive(self, step: int) -> None:
        """Set the torques over the integration step `step`, from the rotors' state at its start."""
        raise NotImplementedError

    def advance(self, omega_bi_b_rad_s: Vec3, h_b_nms: Vec3) -> None:
        """Move the rotors to the end of the step: body rate there, and the sum of their momentum [N m s], body axes."""
        raise NotImplementedError

    def sample_speed(self, step: int) -> Vec4:
        """Return the tachometer readings [rad/s] at the start of `step`; brings `silent` up to date."""
        raise NotImplementedError

    def add_rotors(self, inertia_kgm2: Mat3) -> Mat3:
        """Return the inertia with the rotors' own about their spin axes added: that of the body with wheels locked."""
        raise NotImplementedError

    def look_again(self) -> None:
        """Note that the faults have changed."""
        raise NotImplementedError
