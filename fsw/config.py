"""Settings of the flight software as a whole. The settings of an algorithm stand beside it. Data only."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from bus.units import Vec4
from fsw import allocators, controllers, estimation, gyro_fdi, observers, wheel_health
from fsw.allocators.settings import PseudoInverseConfig
from fsw.guidance.timeline import TimelineEntry
from fsw.gyro_fdi.settings import NoDetectorConfig
from fsw.settings import DriveConfig, ExecutiveConfig, GuidanceConfig, ModelConfig, ModesConfig, NullSpaceConfig
from fsw.wheel_health.settings import NoWheelHealthConfig

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
    null_space: NullSpaceConfig = field(default_factory=NullSpaceConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)
    executive: ExecutiveConfig = field(default_factory=ExecutiveConfig)
    modes: ModesConfig = field(default_factory=ModesConfig)
