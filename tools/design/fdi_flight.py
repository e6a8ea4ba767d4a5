"""A closed loop without a bus, for campaigns on fault detection: plant, estimator, detector, observer, controller.

The stages and their order are those of the flight cycle; frames, modes and telemetry are left out, which makes an hour
of flight a matter of seconds. Scenarios exercise the same stages through the bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from bus.attitude import IDENTITY, angle_between, exp_map, multiply
from bus.units import Mat3, Vec3, Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers
from fsw.config import (
    DetectorConfig,
    IloConfig,
    MekfConfig,
    ModelConfig,
    PracticalDetectorConfig,
    PseudoInverseConfig,
    SmcConfig,
)
from fsw.guidance import Guidance
from fsw.records import Detection, Sensors
from fsw.wheel_axes import combine_wheels
from plant_server.config import BodyConfig, GyroConfig, PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.faults import Fault, make_fault
from plant_server.plant import Plant
from plant_server.truth import Truth

INERTIA_KGM2: Mat3 = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
# 50, 50 and 250 microradians: a common star tracker
STAR_ARCSEC: Vec3 = (10.3, 10.3, 51.6)
PUBLISHED_Q: Vec4 = (0.85, 0.25, -0.3, 0.35)
PUBLISHED_RATE_DEG_S: Vec3 = (0.51, 0.3, 0.009)
STALE_TICKS = 5  # a silent gyro axis is held for this long, then not valid
_MOUNTS = ("x", "y", "z", "skew")

# The wheel faults of Zhang, Ye & Sun 2018, section 4.
WHEEL_FAULTS = (
    make_fault(unit="wheel.2", kind="loss", at_s=10.0, until_s=50.0, effectiveness=0.5),
    make_fault(unit="wheel.3", kind="stuck_torque", at_s=20.0, until_s=40.0, torque_nm=0.015),
    make_fault(unit="wheel.1", kind="loss", at_s=30.0, until_s=100.0, effectiveness=0.6),
    make_fault(unit="wheel.1", kind="loss", at_s=100.0, effectiveness=0.4),
    make_fault(unit="wheel.4", kind="dead", at_s=30.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightSettings:
    """One flight of a campaign."""

    seed: int
    duration_s: float
    rate_hz: int = 20
    fog: str = "tactical"
    star_rate_hz: float = 4.0
    star_latency_s: float = 0.0
    tilt_max_deg: float = 10.0  # each wheel's axis is off by a random part of this, in a random direction
    inertia_sigma: float = 0.02  # truth = model * (1 + this * normal)
    manoeuvre_every_s: float = 120.0  # 0: hold one attitude
    published_start: bool = False  # attitude and rate of Zhang, Ye & Sun 2018, section 4, instead of random ones
    faults: tuple[Fault, ...] = ()
    detector: DetectorConfig = field(default_factory=lambda: PracticalDetectorConfig(kind="practical"))


class Moment(NamedTuple):
    """What a campaign sees at each tick."""

    tick: int
    t_s: float
    sensors: Sensors
    detection: Detection
    q_true: Vec4
    omega_true_b_rad_s: Vec3
    gyro_fault_b_rad_s: Vec3
    tau_fault_true_b_nm: Vec3
    tau_fault_hat_b_nm: Vec3
    error_deg: float


def make_plant(settings: FlightSettings) -> Plant:
    """Return the plant of a flight, its imperfections drawn from the seed."""
    rng = np.random.default_rng([settings.seed, 1])
    scale = 1.0 + settings.inertia_sigma * float(rng.normal())
    inertia = tuple(tuple(scale * v for v in row) for row in INERTIA_KGM2)
    tilts, clocks = settings.tilt_max_deg * rng.random(4), 360.0 * rng.random(4)
    wheels = tuple(
        WheelConfig(mount=mount, tilt_deg=float(tilt), clock_deg=float(clock))  # type: ignore[arg-type]
        for mount, tilt, clock in zip(_MOUNTS, tilts, clocks, strict=True)
    )
    attitude = exp_map(tuple((0.5 * rng.normal(size=3)).tolist()))
    rate_deg_s: Vec3 = tuple((0.3 * rng.normal(size=3)).tolist())
    config = PlantConfig(
        step_s=1.0 / settings.rate_hz,
        body=BodyConfig(
            inertia_kgm2=inertia,  # type: ignore[arg-type]
            attitude_q=PUBLISHED_Q if settings.published_start else attitude,
            rate_deg_s=PUBLISHED_RATE_DEG_S if settings.published_start else rate_deg_s,
        ),
        wheels=wheels,  # type: ignore[arg-type]
        gyro=GyroConfig(preset=settings.fog),  # type: ignore[arg-type]
        star_tracker=StarTrackerConfig(
            rate_hz=settings.star_rate_hz, noise_arcsec=STAR_ARCSEC, latency_s=settings.star_latency_s,
            max_rate_deg_s=2.0,
        ),
    )  # fmt: skip
    return Plant(config, settings.faults, 1.0 / settings.rate_hz, settings.seed)


class SensorReader:
    """Turns samples into what the validated bus traffic would say."""

    def __init__(self, tick_s: float, rotor_inertia_kgm2: float) -> None:
        self._tick_s, self._rotor = tick_s, rotor_inertia_kgm2
        self._rate = [0.0, 0.0, 0.0]
        self._heard = [0, 0, 0]
        self._q: Vec4 = IDENTITY
        self._q_tick = -(10**9)

    def read(self, plant: Plant) -> Sensors:
        """Return the sensors of the plant's present tick."""
        sample, tick = plant.sample(), plant.tick
        for axis in (0, 1, 2):
            if not sample.gyro_silent[axis] and sample.gyro_status[axis] == 0:
                self._rate[axis], self._heard[axis] = sample.gyro_rate_rad_s[axis], tick
        fresh = sample.star is not None and sample.star.age_ticks != 15
        if sample.star is not None and fresh:
            self._q, self._q_tick = sample.star.q_ib, tick - sample.star.age_ticks
        age_s = (tick - self._q_tick) * self._tick_s
        a, b, c, d = sample.wheel_speed_rad_s
        x, y, z = (tick - heard <= STALE_TICKS for heard in self._heard)
        return Sensors(
            tick, tick * self._tick_s, (self._rate[0], self._rate[1], self._rate[2]), (x, y, z), self._q, fresh,
            age_s <= 5.0, age_s, (a, b, c, d), (True, True, True, True),
            (a * self._rotor, b * self._rotor, c * self._rotor, d * self._rotor),
        )  # fmt: skip


def fly(settings: FlightSettings, watch: Callable[[Moment], None], plant: Plant | None = None) -> object:
    """Fly in closed loop and show every tick to `watch`; return the detector as it stands at the end.

    Observer and controller have the gains that the figures of docs/gyro-fdi.md were measured with.
    """
    tick_s = 1.0 / settings.rate_hz
    plant = plant if plant is not None else make_plant(settings)
    model = ModelConfig(inertia_kgm2=INERTIA_KGM2)
    estimator = estimation.REGISTRY["mekf"](make_estimator_config(settings.fog), model, tick_s)
    detector = gyro_fdi.REGISTRY[settings.detector.kind](settings.detector, model, tick_s)
    ilo_every = max(1, round(0.05 / tick_s))
    observer = observers.REGISTRY["ilo"](IloConfig(kind="ilo", period_s=ilo_every * tick_s), model)
    law = SmcConfig(kind="smc", k1=15.0, beta0=math.sqrt(0.08), beta_law="fixed")
    controller = controllers.REGISTRY["smc"](law, model)
    allocator = allocators.REGISTRY["pseudo_inverse"](PseudoInverseConfig(kind="pseudo_inverse"), model)
    rng = np.random.default_rng([settings.seed, 2])
    target = IDENTITY
    guidance = Guidance(target)
    reader = SensorReader(tick_s, model.wheel_inertia_kgm2)
    turn_ticks = round(settings.manoeuvre_every_s / tick_s)
    tau_rw: Vec4 = (0.0, 0.0, 0.0, 0.0)
    tau_b: Vec3 = (0.0, 0.0, 0.0)
    tau_hat: Vec3 = (0.0, 0.0, 0.0)
    for tick in range(round(settings.duration_s / tick_s)):
        sensors = reader.read(plant)
        detection = detector.step(sensors, estimator.step(sensors), tau_rw)
        estimate = detection.estimate
        if detection.rate_step_b_rad_s != (0.0, 0.0, 0.0):
            observer.shift_rate(detection.rate_step_b_rad_s)
        truth = plant.truth()
        if tick % ilo_every == 0:
            rate = estimate.omega_bi_b_rad_s
            tau_hat = observer.step(ilo_every * tick_s, rate, tau_b, combine_wheels(sensors.h_rw_nms))
            demand = controller.step(ilo_every * tick_s, guidance.find_error(estimate.q_ib), rate, tau_hat)
            tau_rw = allocator.allocate(demand.tau_cmd_b_nm)
            tau_b = combine_wheels(tau_rw)
        watch(_look(tick, sensors, detection, truth, tau_hat, target))
        if turn_ticks and (tick + 1) % turn_ticks == 0:
            target = multiply(target, exp_map(tuple((0.35 * rng.normal(size=3)).tolist())))
            guidance = Guidance(target)
        plant.step(tau_rw)
    return detector


def make_estimator_config(fog: str) -> MekfConfig:
    """Return the Kalman filter's settings for a class of gyros."""
    if fog == "space":
        return MekfConfig(kind="mekf", gyro_arw_rad_sqrt_s=5.8e-7, gyro_rrw_rad_s_sqrt_s=5e-9,
                          star_noise_arcsec=STAR_ARCSEC, initial_bias_sigma_rad_s=1e-5)  # fmt: skip
    return MekfConfig(kind="mekf", star_noise_arcsec=STAR_ARCSEC, initial_bias_sigma_rad_s=3e-5,
                      gyro_rrw_rad_s_sqrt_s=3e-7)  # fmt: skip


def with_detector(settings: FlightSettings, **changes: object) -> FlightSettings:
    """Return the same flight with other settings of its detector."""
    return replace(settings, detector=replace(settings.detector, **changes))  # type: ignore[arg-type]


def _look(tick: int, sensors: Sensors, detection: Detection, truth: Truth, tau_hat: Vec3, target: Vec4) -> Moment:
    """The parts of the truth that campaigns grade on."""
    return Moment(
        tick, sensors.t_s, sensors, detection, truth.q_ib, truth.omega_bi_b_rad_s, truth.fault_b_rad_s,
        truth.tau_fault_b_nm, tau_hat, math.degrees(angle_between(target, truth.q_ib)),
    )  # fmt: skip
