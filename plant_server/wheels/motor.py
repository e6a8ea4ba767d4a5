"""Numbers of a wheel's motor, driver, bearing and supply: classes of wheels, and what is in force for its settings."""

from __future__ import annotations

from bus.record import Record
from plant_server.config import WheelConfig, WheelMotorConfig

PLAIN_MOTOR = WheelMotorConfig()
REFERENCE_C = -30.0  # temperature at which v0 holds


class Preset(Record):
    """What a class of wheels is made of. Symbols as in docs/wheels.md."""

    __slots__ = ("back_emf", "bandwidth", "coulomb", "driver_gain", "emf_gain", "inertia", "max_command", "overspeed",
                 "overspeed_gain", "torque_constant", "viscous", "viscous_slope")  # fmt: skip

    def __init__(
        self, inertia: float, driver_gain: float, torque_constant: float, viscous: float, viscous_slope: float
    ) -> None:
        self.inertia = inertia  # J [kg m^2]
        self.driver_gain = driver_gain  # G_d [A/V]
        self.torque_constant = torque_constant  # k_t [N m/A]
        self.viscous = viscous  # v0 [N m s/rad]
        self.viscous_slope = viscous_slope  # v1 [N m s/rad/K]
        # Read in a public transcription of Bialke's tables (Electronics 2021, 10(19) 2432; Sensors 2023, 23(3) 1474):
        self.back_emf = torque_constant  # k_e [V s/rad]
        self.bandwidth = 9.0  # w_d [rad/s]
        self.coulomb = 0.002  # tau_c [N m]
        self.overspeed = 680.0  # w_s [rad/s]; 690 in the other paper
        self.overspeed_gain = 95.0  # K_s [V s/rad]
        self.max_command = 5.0  # [V]
        # chosen: the source gives 0.5, from memory; with 10 the limit behaves as a limit
        self.emf_gain = 10.0  # K_f [V/V]


PRESETS: dict[str, Preset] = {
    # J, G_d, k_t, v1 read as above. v0 is recalled as 0.049 in mN m s/rad; printed 0.0049, it would be negative at room.
    "ithaco_a": Preset(0.0077, 0.19, 0.029, 4.9e-5, 2e-7),
    # chosen: 0.12 N m and 8 N m s at 400 rad/s, for the satellite of Zhang, Ye & Sun 2018
    "rw100": Preset(0.02, 0.4, 0.06, 4.9e-5, 2e-7),
    # chosen: a tenth of the drag, so that the speed limiter is reached on a bus of 28 V
    "low_drag": Preset(0.0077, 0.19, 0.029, 4.9e-6, 2e-8),
}


class Motor(Record):
    """The numbers in force: those given, and the preset's for the others. Units as in WheelMotorConfig."""

    __slots__ = ("back_emf", "bandwidth", "coulomb", "driver_gain", "emf_gain", "inertia", "max_command", "overspeed",
                 "overspeed_gain", "settings", "static", "torque_constant", "viscous", "viscous_slope")  # fmt: skip

    def __init__(self, settings: WheelMotorConfig) -> None:
        preset = PRESETS[settings.preset]
        self.settings = settings  # what no preset has
        self.inertia = _choose(settings.inertia_kgm2, preset.inertia)
        self.driver_gain = _choose(settings.driver_gain_a_v, preset.driver_gain)
        self.torque_constant = _choose(settings.torque_constant_nm_a, preset.torque_constant)
        self.back_emf = _choose(settings.back_emf_v_s, preset.back_emf)
        self.bandwidth = _choose(settings.bandwidth_rad_s, preset.bandwidth)
        self.max_command = _choose(settings.max_command_v, preset.max_command)
        self.coulomb = _choose(settings.coulomb_nm, preset.coulomb)
        self.static = _choose(settings.static_nm, self.coulomb)
        self.viscous = _choose(settings.viscous_nm_s, preset.viscous)
        self.viscous_slope = _choose(settings.viscous_slope_nm_s_k, preset.viscous_slope)
        self.overspeed = _choose(settings.overspeed_rad_s, preset.overspeed)
        self.overspeed_gain = _choose(settings.overspeed_gain_v_s, preset.overspeed_gain)
        self.emf_gain = _choose(settings.emf_gain, preset.emf_gain)


def fill_motor(wheel: WheelConfig) -> Motor:
    """Return the motor of a wheel of the ithaco model."""
    return Motor(wheel.motor or PLAIN_MOTOR)


def find_rotor_inertia(wheel: WheelConfig) -> float:
    """Return the inertia of a wheel's rotor about its spin axis, whatever its model [kg m^2]."""
    return wheel.inertia_kgm2 if wheel.model == "ideal" else fill_motor(wheel).inertia


def _choose(given: float | None, preset: float) -> float:
    return preset if given is None else given
