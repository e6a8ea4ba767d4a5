"""What the plant needs of a set of four wheels, whatever model each of them has."""

from __future__ import annotations

from collections.abc import Sequence

from mypy_extensions import mypyc_attr

from bus.units import Mat3, Vec3, Vec4

Status4 = tuple[int, int, int, int]
Flags4 = tuple[bool, bool, bool, bool]


@mypyc_attr(allow_interpreted_subclasses=True)
class WheelBank:
    """Four wheels: it owns the state of the rotors, and gives mean torques on the body over each integration step.

    One step: `receive` (new commands, once a tick), `drive`, then, when the body has moved, `advance`.
    """

    __slots__ = ()

    speed_rad_s: Vec4  # of the rotors, relative to the body
    h_b_nms: Vec3  # spin momentum of the rotors, absolute, body axes
    torque_nm: Vec4  # of each wheel on the body about its true axis, mean over the last step
    torque_b_nm: Vec3  # their sum on the body
    command_nm: Vec4  # in effect
    command_b_nm: Vec3  # what it would be on the body with nominal axes
    current_a: Vec4  # of the motors over the last step
    status: Status4  # of each wheel's frame: 0 ok, 2 no command, 3 speed limit
    silent: Flags4  # which send no telemetry

    def receive(self, commands_nm: Sequence[float | None]) -> None:
        """Take the torque commands of this tick [N m]; None: the wheel has none, so its motor gives no torque."""
        raise NotImplementedError

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
