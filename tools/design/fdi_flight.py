"""Flights for campaigns on gyro fault detection: a scenario drawn from a seed, flown on the bench, watched tick by tick.

The satellite of Zhang, Ye & Sun 2018 with misaligned wheels and an inertia that is not quite the model's, manoeuvring. The
mode is held at pointing, whatever the rate and however long the star tracker is blind: it is the detector that is judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from bus.attitude import IDENTITY, exp_map, multiply
from bus.run import ClockConfig
from bus.units import Mat3, Vec3, Vec4
from fsw.config import DetectorConfig, FswConfig
from fsw.controllers.settings import SmcConfig
from fsw.estimation.settings import MekfConfig
from fsw.gyro_fdi.settings import PracticalDetectorConfig
from fsw.observers.settings import IloConfig
from fsw.records import Detection, Flags4, Sensors
from fsw.settings import ExecutiveConfig, ModelConfig, ModesConfig
from fsw.wheel_health.settings import TorqueMonitorConfig
from plant_server.config import BodyConfig, GyroConfig, PlantConfig, StarTrackerConfig, WheelConfig
from plant_server.faults import Fault, make_fault
from plant_server.truth import Truth
from tools.config.scenario import Resolved, Scenario
from tools.run.bench import Bench

INERTIA_KGM2: Mat3 = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
# 50, 50 and 250 microradians: a common star tracker
STAR_ARCSEC: Vec3 = (10.3, 10.3, 51.6)
PUBLISHED_Q: Vec4 = (0.85, 0.25, -0.3, 0.35)
PUBLISHED_RATE_DEG_S: Vec3 = (0.51, 0.3, 0.009)
CONTROL_S = 0.05  # observe and control this often, or every tick where ticks are longer
NEVER = 1e6  # deg/s, s: a limit that no flight reaches
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
    star_max_rate_deg_s: float = 2.0
    tilt_max_deg: float = 10.0  # each wheel's axis is off by a random part of this, in a random direction
    inertia_sigma: float = 0.02  # truth = model * (1 + this * normal)
    manoeuvre_every_s: float = 120.0  # 0: hold one attitude
    published_start: bool = False  # attitude and rate of Zhang, Ye & Sun 2018, section 4, instead of random ones
    start_rate_deg_s: Vec3 | None = None  # instead of either
    faults: tuple[Fault, ...] = ()
    detector: DetectorConfig = field(default_factory=lambda: PracticalDetectorConfig(kind="practical"))


class Moment(NamedTuple):
    """What a campaign sees at each tick. `sensors` is brought up to date in place: whoever keeps a moment copies it."""

    tick: int
    t_s: float
    sensors: Sensors
    detection: Detection
    wheel_alarm: Flags4
    truth: Truth
    tau_fault_hat_b_nm: Vec3


def fly(settings: FlightSettings, watch: Callable[[Moment], None]) -> Bench:
    """Fly in closed loop and show every tick to `watch`; return the bench as it stands at the end."""
    bench = Bench(Resolved.of(make_scenario(settings)))
    flight = bench.flight
    rng = np.random.default_rng([settings.seed, 2])
    target = IDENTITY
    turn_ticks = round(settings.manoeuvre_every_s * settings.rate_hz)
    for tick in range(bench.ticks):
        if turn_ticks and tick and tick % turn_ticks == 0:
            target = multiply(target, exp_map(tuple((0.35 * rng.normal(size=3)).tolist())))
            bench.retarget("hold", target_q=target)
        bench.step()
        sensors = flight.inputs.sensors
        alarm, tau_hat = flight.health.alarm, flight.tau_fault_hat_b_nm
        watch(Moment(tick, sensors.t_s, sensors, flight.detection, alarm, bench.sampled_truth, tau_hat))
    return bench


def make_scenario(settings: FlightSettings) -> Scenario:
    """Return a flight as a scenario, the plant's imperfections drawn from the seed."""
    tick_s = 1.0 / settings.rate_hz
    control_ticks = max(1, round(CONTROL_S / tick_s))
    return Scenario(
        name="gyro-fdi-campaign",
        seed=settings.seed,
        duration_s=round(settings.duration_s / tick_s) * tick_s,
        clock=ClockConfig(mode="inprocess", tick_hz=settings.rate_hz),
        plant=_make_plant(settings, tick_s),
        faults=settings.faults,
        fsw=FswConfig(
            model=ModelConfig(inertia_kgm2=INERTIA_KGM2),
            estimator=make_estimator_config(settings.fog),
            detector=settings.detector,
            observer=IloConfig(kind="ilo", period_s=control_ticks * tick_s),
            wheel_health=TorqueMonitorConfig(kind="torque_monitor", reaction="report"),
            controller=SmcConfig(kind="smc", k1=15.0, beta0=math.sqrt(0.08), beta_law="fixed"),
            executive=ExecutiveConfig(control_divider=control_ticks),
            modes=ModesConfig(detumble_above_deg_s=NEVER, star_stale_after_s=NEVER),
        ),
    )


def make_estimator_config(fog: str) -> MekfConfig:
    """Return the Kalman filter's settings for a class of gyros."""
    if fog == "space":
        return MekfConfig(kind="mekf", gyro_arw_rad_sqrt_s=5.8e-7, gyro_rrw_rad_s_sqrt_s=5e-9,
                          star_noise_arcsec=STAR_ARCSEC, initial_bias_sigma_rad_s=1e-5)  # fmt: skip
    return MekfConfig(kind="mekf", star_noise_arcsec=STAR_ARCSEC, initial_bias_sigma_rad_s=3e-5,
                      gyro_rrw_rad_s_sqrt_s=3e-7)  # fmt: skip


def with_detector(settings: FlightSettings, **changes: object) -> FlightSettings:
    """Return the same flight with other settings of its detector."""
    return replace(settings, detector=replace(settings.detector, **changes))


def _make_plant(settings: FlightSettings, tick_s: float) -> PlantConfig:
    rng = np.random.default_rng([settings.seed, 1])
    scale = 1.0 + settings.inertia_sigma * float(rng.normal())
    inertia = tuple(tuple(scale * v for v in row) for row in INERTIA_KGM2)
    tilts, clocks = settings.tilt_max_deg * rng.random(4), 360.0 * rng.random(4)
    wheels = tuple(
        WheelConfig(mount=mount, tilt_deg=float(tilt), clock_deg=float(clock))  # type: ignore[arg-type]
        for mount, tilt, clock in zip(_MOUNTS, tilts, clocks, strict=True)
    )
    attitude: Vec4 = exp_map(tuple((0.5 * rng.normal(size=3)).tolist()))
    rate_deg_s: Vec3 = tuple((0.3 * rng.normal(size=3)).tolist())
    if settings.published_start:
        attitude, rate_deg_s = PUBLISHED_Q, PUBLISHED_RATE_DEG_S
    body = BodyConfig(
        inertia_kgm2=inertia,  # type: ignore[arg-type]
        attitude_q=attitude,
        rate_deg_s=rate_deg_s if settings.start_rate_deg_s is None else settings.start_rate_deg_s,
    )
    star_tracker = StarTrackerConfig(
        rate_hz=settings.star_rate_hz, noise_arcsec=STAR_ARCSEC, latency_s=settings.star_latency_s,
        max_rate_deg_s=settings.star_max_rate_deg_s,
    )  # fmt: skip
    gyro = GyroConfig(preset=settings.fog)  # type: ignore[arg-type]
    return PlantConfig(step_s=tick_s, body=body, wheels=wheels, gyro=gyro, star_tracker=star_tracker)  # type: ignore[arg-type]
