"""The motor of a wheel as the flight software believes it to be: driver, torque constant, nominal drag."""

from __future__ import annotations

import math

from bus.record import Record
from fsw.settings import WheelMotorConfig

# Below this speed dry friction goes over into its other sign when drag is made up for [rad/s]. Wider than the bearing's own
# 0.1 rad/s, or the sign would chatter with the noise of the speed.
FEED_FORWARD_RAD_S = 0.5


class WheelMotor(Record):
    """Driver current I: dI/dt = w_d (G_d V - I); rotor: J dw/dt = k_t I - drag. Spec of the ITHACO Type-A class."""

    __slots__ = (
        "bandwidth_rad_s",
        "coulomb_nm",
        "driver_gain_a_v",
        "max_command_v",
        "max_torque_nm",
        "torque_constant_nm_a",
        "viscous_nm_s",
    )

    def __init__(
        self,
        driver_gain_a_v: float,
        torque_constant_nm_a: float,
        bandwidth_rad_s: float,
        coulomb_nm: float,
        viscous_nm_s: float,
        max_command_v: float,
    ) -> None:
        self.driver_gain_a_v = driver_gain_a_v  # current for a volt of command, G_d
        self.torque_constant_nm_a = torque_constant_nm_a  # k_t
        self.bandwidth_rad_s = bandwidth_rad_s  # of the driver, w_d
        self.coulomb_nm = coulomb_nm  # dry friction
        self.viscous_nm_s = viscous_nm_s  # viscous friction [N m s/rad], at 20 C
        self.max_command_v = max_command_v
        self.max_torque_nm = max_command_v * driver_gain_a_v * torque_constant_nm_a  # of the motor

    def find_drag(self, speed_rad_s: float) -> float:
        """Return the nominal drag at a speed, with the speed's sign [N m]."""
        return self.coulomb_nm * math.tanh(speed_rad_s / FEED_FORWARD_RAD_S) + self.viscous_nm_s * speed_rad_s


def fill_motor(config: WheelMotorConfig) -> WheelMotor:
    """Return the motor that the settings describe: the values given, and the preset's for the others."""
    # Bialke's Type-A structure with the values of Electronics 2021, 10(19) 2432 and Sensors 2023, 23(3) 1474. `rw100` is a
    # wheel of 0.12 N m of our own; its driver and bearing are taken to be as those of the other.
    gain, constant = (0.19, 0.029) if config.preset == "ithaco_a" else (0.4, 0.06)
    return WheelMotor(
        _choose(config.driver_gain_a_v, gain),
        _choose(config.torque_constant_nm_a, constant),
        _choose(config.bandwidth_rad_s, 9.0),
        _choose(config.coulomb_nm, 0.002),
        _choose(config.viscous_nm_s, 3.9e-5),
        _choose(config.max_command_v, 5.0),
    )


def _choose(given: float | None, preset: float) -> float:
    return preset if given is None else given
