"""Whether the bus of a scenario can be opened, and whether its frames can carry what the vehicle does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bus.errors import BusAddressError
from bus.icd.ranges import find_signal
from bus.settings import KeyPath, Problem
from bus.wire.address import BUILT_IN, EXPLICIT, describe_unknown, python_can_interfaces
from bus.wire.hub.directory import check_place, resolve_directory

Problems = Iterator[Problem]


def check_address(parts: dict[KeyPath, Any]) -> Problems:
    """Whether two processes can meet on the bus; in one process none is opened."""
    address, mode = parts.get(("bus", "address")), parts.get(("clock", "mode"))
    if address is None or mode not in ("lockstep", "realtime"):
        return
    if word := explain_address(address):
        yield Problem(("bus", "address"), word)


def explain_address(address: str) -> str | None:
    """Why two processes cannot meet at a bus address; None when nothing is known against it."""
    scheme, colon, where = address.partition(":")
    if not colon or (scheme not in (*BUILT_IN, EXPLICIT) and scheme not in python_can_interfaces()):
        return describe_unknown(address, scheme, python_can_interfaces())
    if scheme == "memory":
        return "memory: is a bus within one process; use hub: for two, or clock.mode: inprocess"
    if scheme == "hub" and where:
        try:
            check_place(resolve_directory(where))
        except BusAddressError as error:
            return str(error)
    return None


def range_of(message: str, signal: str) -> float:
    """Largest magnitude that a signal of the ICD can carry with either sign, in its unit."""
    found = find_signal(message, signal)
    return min(-found.minimum, found.maximum)


def check_ranges(parts: dict[KeyPath, Any]) -> Problems:
    """What wheels and gyro may reach, and what their frames have room for."""
    for index in range(4):
        wheel = ("plant", "wheels", index)
        yield from _fit(parts, (*wheel, "max_torque_nm"), f"RW{index + 1}_CMD", "TORQUE", "N m")
        yield from _fit(parts, (*wheel, "max_speed_rad_s"), f"RW{index + 1}_TLM", "SPEED", "rad/s")
        yield from _fit_current(parts, index)
    model = ("fsw", "model")
    yield from _fit(parts, (*model, "wheel_max_torque_nm"), "RW1_CMD", "TORQUE", "N m")
    yield from _fit(parts, (*model, "wheel_max_speed_rad_s"), "RW1_TLM", "SPEED", "rad/s")
    yield from _fit(parts, ("plant", "gyro", "range_rad_s"), "FOGX_RATE", "RATE", "rad/s")


def _fit(parts: dict[KeyPath, Any], path: KeyPath, message: str, signal: str, unit: str) -> Problems:
    value, most = parts.get(path), range_of(message, signal)
    if value is not None and value > most:
        yield Problem(path, f"{value:g} {unit} does not fit into {signal} of {message}; at most {most:g} {unit}")


def _fit_current(parts: dict[KeyPath, Any], index: int) -> Problems:
    """The motor's current at full torque, which the wheel reports in mA."""
    wheel = ("plant", "wheels", index)
    torque_nm, constant_nm_a = parts.get((*wheel, "max_torque_nm")), parts.get((*wheel, "motor_constant_nm_a"))
    if torque_nm is None or constant_nm_a is None:
        return
    most_a = range_of(f"RW{index + 1}_TLM", "CURRENT") * 1e-3
    if torque_nm / constant_nm_a > most_a:
        word = f"{torque_nm:g} N m at {constant_nm_a:g} N m/A draw {torque_nm / constant_nm_a:g} A, which does not fit "
        fix = f"into CURRENT of RW{index + 1}_TLM; at most {most_a:g} A: give at least {torque_nm / most_a:.4g} N m/A"
        yield Problem((*wheel, "motor_constant_nm_a"), word + fix)
