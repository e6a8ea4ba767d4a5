"""What kinds of fault are made of: the records that they change, what they are told, and the register of them all.

A kind is one frozen dataclass in a module under `kinds`: its magnitudes are its fields, with unit and range, its docstring
says what happens, and `disturb` does it. `register` puts it into KINDS; nothing else has to name it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar, TypeVar

from plant_server.config import PlantConfig
from plant_server.faults.units import FAMILIES


class Acting:
    """What an effect is told: how far its fault has come on at this moment, and what fell by chance."""

    __slots__ = ("drawn", "elapsed_s", "held_rad_s", "level", "start_s", "t_s")

    def __init__(self, start_s: float) -> None:
        self.start_s = start_s
        self.t_s = start_s  # middle of the integration step (wheels), or the sample (sensors)
        self.elapsed_s = 0.0  # since the onset
        self.level = 0.0  # 0 not there .. 1 fully there
        self.drawn: tuple[float, ...] = ()  # uniform on [0, 1), anew for every sample, as many as the kind asks for
        self.held_rad_s: float | None = None  # gyro: the output that was held at the onset


class WheelDisturbance:
    """What the faults of a wheel make of its motor's torque tau: gain tau + offset; and whether its telemetry stops."""

    __slots__ = ("gain", "offset_nm", "silent")

    def __init__(self) -> None:
        self.gain = 1.0
        self.offset_nm = 0.0
        self.silent = False


class GyroSample:
    """One sample of a gyro axis on its way through the faults."""

    __slots__ = ("frozen", "last_rad_s", "noise_gain", "rate_rad_s", "silent", "white_rad_s")

    def __init__(self, rate_rad_s: float, white_rad_s: float, last_rad_s: float) -> None:
        self.rate_rad_s = rate_rad_s
        self.white_rad_s = white_rad_s  # the white noise in it
        self.last_rad_s = last_rad_s  # what the axis gave out last
        self.noise_gain = 1.0  # of the white noise
        self.frozen = False  # the output stands still: it is not quantised again
        self.silent = False  # no frame

    def shift_to(self, rate_rad_s: float) -> None:
        """Change the rate; a frozen output that moves is no longer frozen."""
        self.frozen = self.frozen and rate_rad_s == self.rate_rad_s
        self.rate_rad_s = rate_rad_s


class StarSample:
    """One message of the star tracker on its way through the faults."""

    __slots__ = ("lost",)

    def __init__(self) -> None:
        self.lost = False


class Effect:
    """What all kinds share: settings of the kind itself, and what to say of one that can do nothing."""

    __slots__ = ()
    family: ClassVar[str]  # set by `register`,
    kind: ClassVar[str]  # as the name of the kind in scenarios
    rises: ClassVar[bool] = True  # whether another profile than a step means anything
    draws: ClassVar[int] = 0  # random numbers a sample, from a stream of the fault's own
    steady: ClassVar[bool] = (
        True  # changes only as its level does (a wheel's faults are looked at only when they change)
    )
    early: ClassVar[bool] = False  # acts ahead of all others of its unit, whenever its onset is

    def explain_futile(self, plant: PlantConfig | None) -> str | None:
        """Return why it can have no effect, whatever happens, on this plant (None: on any); None when it can."""
        return None


class WheelEffect(Effect):
    """A kind of wheel fault."""

    __slots__ = ()

    def disturb(self, wheel: WheelDisturbance, now: Acting) -> None:
        """Change the record as the fault does, after those with an earlier onset."""
        raise NotImplementedError


class GyroEffect(Effect):
    """A kind of gyro fault."""

    __slots__ = ()

    def disturb(self, sample: GyroSample, now: Acting) -> None:
        """Change the record as the fault does, after those with an earlier onset."""
        raise NotImplementedError


class StarEffect(Effect):
    """A kind of star tracker fault."""

    __slots__ = ()

    def disturb(self, sample: StarSample, now: Acting) -> None:
        """Change the record as the fault does, after those with an earlier onset."""
        raise NotImplementedError


KINDS: dict[str, dict[str, type[Effect]]] = {family: {} for family in FAMILIES}
E = TypeVar("E", bound=Effect)


def register(family: str, kind: str) -> Callable[[type[E]], type[E]]:
    """Return a class decorator that makes an effect known as `kind` of a family: wheel, gyro or star_tracker."""

    def enter(cls: type[E]) -> type[E]:
        if not dataclasses.is_dataclass(cls) or kind in KINDS[family]:
            raise TypeError(f"{cls.__name__}: a kind of fault is a dataclass under a name of its own, not {kind} again")
        cls.family, cls.kind = family, kind
        KINDS[family][kind] = cls
        return cls

    return enter
