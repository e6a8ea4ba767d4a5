"""Numbers of the flight software that can be changed while it flies: each by a command, `param.set`, on a tick boundary.

A change is an input like any other: it is in the log with its tick, and a replay makes it again. What a number may be is
checked before; a law with other settings is another law, made by the same rules as at boot.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from bus.errors import ConfigError, DesignError
from bus.settings import build, plain
from bus.units import DEG
from bus.words import describe, suggest

if TYPE_CHECKING:
    from fsw.flight import Flight

VERB: Final = "param.set"
LAW: Final = "LAW_"
LONGEST_NAME: Final = 16  # what MAVLink has room for
SLEW_RATE_DEG_S: Final = 0.2  # at boot
SLEW_ACCELERATION_DEG_S2: Final = 0.01
SLOW_TO_MAKE: Final = ("dismc",)  # laws that prove their stability first: nothing to do within a cycle


@dataclasses.dataclass(frozen=True, slots=True)
class Number:
    """One number that can be changed: an attribute of the flight, or of a part of it."""

    name: str
    text: str  # what it is, with its unit
    low: float
    high: float
    path: str
    kind: Callable[[float], Any] = float  # int: a whole number; bool: 0 or 1
    unit: float = 1.0  # what the attribute counts in, for one of ours


NUMBERS: Final = (
    Number(
        "SLEW_MAX_DEG_S", "rate of the slew to an attitude that is sent; 0: a step [deg/s]", 0.0, 10.0, "slew_rate_deg_s"
    ),
    Number(
        "SLEW_ACC_DEG_S2", "acceleration of that slew, and of a change of rate [deg/s^2]", 1e-4, 10.0,
        "slew_acceleration_deg_s2",
    ),
    Number("FEED_FORWARD", "1: add the torque that the target's own motion takes", 0.0, 1.0, "feed_forward", bool),
    Number("DAMPING_NM_S", "gain of the rate damping in detumble and safe [N m s/rad]", 1e-3, 1e4, "damping_nm_s"),
    Number(
        "DETUMBLE_DEG_S", "rate above which pointing is given up for damping [deg/s]", 0.01, 90.0,
        "modes.detumble_above_rad_s", unit=DEG,
    ),
    Number("POINT_DEG_S", "rate below which damping ends [deg/s]", 0.01, 90.0, "modes.point_below_rad_s", unit=DEG),
    Number("RECOVER_TICKS", "good ticks in a row before safe is left", 1.0, 1e6, "modes.recover_after_ticks", int),
    Number("STALE_TICKS", "ticks for which a value that does not come is held", 1.0, 1e6, "inputs.hold_ticks", int),
    Number(
        "STAR_STALE_S", "time for which an attitude of the star tracker is held [s]", 0.01, 3600.0, "inputs.star_hold_s"
    ),
)  # fmt: skip
BY_NAME: Final = {number.name: number for number in NUMBERS}


def list_gains(flight: Flight) -> dict[str, str]:
    """Return the numbers of the law that can be changed: the name of each, and its key in the law's settings."""
    settings = flight.law_settings
    gains: dict[str, str] = {}
    if settings.kind not in SLOW_TO_MAKE:
        for item in dataclasses.fields(settings):
            if isinstance(getattr(settings, item.name), float):
                gains.setdefault((LAW + item.name.upper())[:LONGEST_NAME].rstrip("_"), item.name)
    return gains


def list_names(flight: Flight) -> list[str]:
    """Return the names of all numbers that can be changed, in their order."""
    return [*BY_NAME, *list_gains(flight)]


def check(flight: Flight, arguments: dict[str, Any]) -> str:
    """Why a change cannot be made, in words; empty where it can."""
    name, value = arguments.get("name"), arguments.get("value")
    if arguments.keys() != {"name", "value"}:
        return f"{VERB} takes name and value"
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e300 < value < 1e300:
        return f"value: {describe(value)} is not a number"
    number = BY_NAME.get(name) if isinstance(name, str) else None
    if number is None:
        return _check_gain(flight, name, value)
    if not number.low <= value <= number.high:
        return f"{name} = {value:g} is not in {number.low:g} to {number.high:g}"
    if number.kind is not float and value != math.floor(value):
        return f"{name} = {value:g} is not a whole number"
    if name == "DETUMBLE_DEG_S" and not value * DEG > flight.modes.point_below_rad_s:
        return f"{name} = {value:g} deg/s must be above POINT_DEG_S = {flight.modes.point_below_rad_s / DEG:g}"
    if name == "POINT_DEG_S" and not value * DEG < flight.modes.detumble_above_rad_s:
        return f"{name} = {value:g} deg/s must be below DETUMBLE_DEG_S = {flight.modes.detumble_above_rad_s / DEG:g}"
    return ""


def apply(flight: Flight, arguments: dict[str, Any]) -> None:
    """Make a change that `check` did not object to."""
    name, value = arguments["name"], float(arguments["value"])
    number = BY_NAME.get(name)
    if number is None:
        flight.change_law(_change(flight, list_gains(flight)[name], value))
    else:
        owner, attribute = _find(flight, number)
        setattr(owner, attribute, number.kind(value * number.unit))


def read(flight: Flight, name: str) -> float:
    """Return the value of a number of `list_names`."""
    number = BY_NAME.get(name)
    if number is not None:
        owner, attribute = _find(flight, number)
        return float(getattr(owner, attribute)) / number.unit
    return float(getattr(flight.law_settings, list_gains(flight)[name]))


def _find(flight: Flight, number: Number) -> tuple[Any, str]:
    """Who holds a number, and under which name."""
    owner: Any = flight
    *parts, attribute = number.path.split(".")
    for part in parts:
        owner = getattr(owner, part)
    return owner, attribute


def _check_gain(flight: Flight, name: Any, value: float) -> str:
    names = list_names(flight)
    if not isinstance(name, str) or name not in names:
        guess = suggest(name, names) if isinstance(name, str) else ""
        return f"name: {describe(name)} is not known; {guess}there are: {', '.join(names)}"
    try:
        flight.check_law(_change(flight, list_gains(flight)[name], float(value)))
    except (ConfigError, DesignError) as error:
        return str(error)
    return ""


def _change(flight: Flight, key: str, value: float) -> Any:
    """The law's settings with another value. Raises ConfigError where that cannot be."""
    settings = flight.law_settings
    return build(type(settings), plain(settings) | {key: value}, "law")
