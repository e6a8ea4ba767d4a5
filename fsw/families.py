"""The families of algorithms that a scenario can choose from: what each must offer, and how a kind is registered.

An algorithm is one module: its settings, a frozen dataclass with a `kind`, and a class that is made as
`Algorithm(settings, vehicle, period_s)`, with period_s the nominal time between two calls of `step`. It is registered by
one line in its family's `__init__.py`. It is deterministic: no clock, no random numbers, no input or output of its own.
"""

from __future__ import annotations

import functools
import operator
import typing
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from bus.settings import fields_of
from bus.units import Vec3, Vec4
from fsw.records import Allocation, Detection, Estimate, PointingError, Sensors, Target, WheelHealth, WheelReading
from fsw.vehicle import Vehicle

T = TypeVar("T")
Wheels = tuple[WheelReading, WheelReading, WheelReading, WheelReading]


class NoInternals(NamedTuple):
    """Of an algorithm that has nothing to show."""


class Algorithm(Protocol):
    """What all families have in common."""

    @property
    def internals(self) -> tuple[Any, ...]:
        """A named tuple of numbers and tuples of numbers, fixed in shape, for telemetry."""
        ...

    def reset(self) -> None:
        """Back to where it was when it was made."""
        ...


class Estimator(Algorithm, Protocol):
    """Attitude and rate from the sensors of a tick."""

    def step(self, sensors: Sensors) -> Estimate: ...


class Detector(Algorithm, Protocol):
    """Gyro fault detection."""

    def step(self, sensors: Sensors, estimate: Estimate, tau_rw_cmd_nm: Vec4) -> Detection:
        """tau_rw_cmd_nm: wheel torques commanded over the tick that ends now (as sent) [N m]."""
        ...


class Observer(Algorithm, Protocol):
    """The lumped fault torque on the body."""

    def step(self, dt_s: float, omega_bi_b_rad_s: Vec3, tau_cmd_b_nm: Vec3, h_rw_b_nms: Vec3) -> Vec3:
        """Advance by dt_s; return the lumped fault torque on the body [N m].

        dt_s         : time since the last call; the nominal period, or more after lost ticks
        tau_cmd_b_nm : torque commanded (as sent) over the interval that ends now [N m]
        h_rw_b_nms   : total wheel momentum in body axes [N m s]; zeros for the papers' plant
        """
        ...

    def shift_rate(self, step_b_rad_s: Vec3) -> None:
        """Move the internal rate state by a known jump of the rate source (bumpless transfer)."""
        ...


class WheelHealthMonitor(Algorithm, Protocol):
    """Which wheels give what they are told."""

    def step(self, dt_s: float, wheels: Wheels, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None) -> WheelHealth:
        """Advance by dt_s; return what is thought of the wheels now.

        tau_rw_cmd_nm      : wheel torques commanded (as sent) over the interval that ends now [N m]
        tau_fault_hat_b_nm : the observer's fault torque for that interval [N m]; None while no observer runs
        """
        ...


class Guide(Protocol):
    """A course of the target over time."""

    def point(self, t_s: float) -> Target:
        """Return the target at the time t_s [s]."""
        ...


class Controller(Algorithm, Protocol):
    """From the pointing error to a body torque."""

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Advance by dt_s; return the torque that is to act on the body, body axes [N m].

        tau_fault_hat_b_nm : the observer's fault torque less what `health` explains, which the law makes up for [N m]
        """
        ...


class Allocator(Algorithm, Protocol):
    """From a body torque to wheel torques within limits."""

    def allocate(self, tau_cmd_b_nm: Vec3, health: WheelHealth) -> Allocation:
        """Return the wheels' share of a body torque [N m]; see each allocator for what is kept on saturation."""
        ...


class Registry(Generic[T]):
    """The kinds of one family, by the `kind` of their settings."""

    def __init__(self, *pairs: tuple[type, Callable[[Any, Vehicle, float], T]]) -> None:
        """pairs: settings class and algorithm of each kind."""
        self.kinds = {find_kind(settings): (settings, make) for settings, make in pairs}

    @property
    def settings(self) -> Any:
        """The type of a setting that chooses one of the kinds."""
        return functools.reduce(operator.or_, [settings for settings, _ in self.kinds.values()])

    def make(self, settings: Any, vehicle: Vehicle, period_s: float) -> T:
        """The algorithm that the settings ask for. Raises ConfigError or DesignError where it cannot be made."""
        return self.kinds[settings.kind][1](settings, vehicle, period_s)


def find_kind(settings: type) -> str:
    """The word that a settings class goes by."""
    word: str = typing.get_args(fields_of(settings)["kind"][0])[0]
    return word
