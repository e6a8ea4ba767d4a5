"""Settings of the flight software as a whole. The settings of an algorithm stand beside it. Data only."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from bus.units import Ge, Gt, Seconds, Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers, wheel_health
from fsw.allocators.pseudo_inverse import PseudoInverseConfig
from fsw.guidance.timeline import TimelineEntry
from fsw.gyro_fdi.none import NoDetectorConfig
from fsw.modes import ModesConfig
from fsw.vehicle import ModelConfig
from fsw.wheel_health.none import NoWheelHealthConfig

if TYPE_CHECKING:
    EstimatorConfig: TypeAlias = Any
    DetectorConfig: TypeAlias = Any
    ObserverConfig: TypeAlias = Any
    WheelHealthConfig: TypeAlias = Any
    ControllerConfig: TypeAlias = Any
    AllocatorConfig: TypeAlias = Any
else:  # whatever is registered can be chosen
    EstimatorConfig = estimation.REGISTRY.settings
    DetectorConfig = gyro_fdi.REGISTRY.settings
    ObserverConfig = observers.REGISTRY.settings
    WheelHealthConfig = wheel_health.REGISTRY.settings
    ControllerConfig = controllers.REGISTRY.settings
    AllocatorConfig = allocators.REGISTRY.settings


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutiveConfig:
    """Rates and what to do when a cycle is late. The base rate is the run's tick rate."""

    control_divider: Annotated[int, Ge(1)] = 1  # observe, guide, control, allocate every n-th tick
    overrun: Literal["skip", "catch_up", "degrade", "safe"] = "skip"
    max_consecutive_slips: Annotated[int, Ge(1)] = 50  # past this the run ends as an infrastructure failure
    watchdog_s: Annotated[Seconds, Gt(0)] = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidanceConfig:
    """How a target that moves is followed."""

    feed_forward: bool = True  # the torque that the target's own motion takes is added to the law's


@dataclass(frozen=True, slots=True, kw_only=True)
class FswConfig:
    """Everything the flight software needs beside the clock and the bus."""

    model: ModelConfig
    target_q: Vec4 = (1.0, 0.0, 0.0, 0.0)  # attitude to begin with, q_it, scalar first; normalised when read
    timeline: tuple[Annotated[TimelineEntry, "do"], ...] = ()  # what to point at from when on
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    estimator: EstimatorConfig
    detector: DetectorConfig = field(default_factory=lambda: NoDetectorConfig(kind="none"))
    observer: ObserverConfig
    wheel_health: WheelHealthConfig = field(default_factory=lambda: NoWheelHealthConfig(kind="none"))
    controller: ControllerConfig
    allocator: AllocatorConfig = field(default_factory=lambda: PseudoInverseConfig(kind="pseudo_inverse"))
    executive: ExecutiveConfig = field(default_factory=ExecutiveConfig)
    modes: ModesConfig = field(default_factory=ModesConfig)
