"""The vehicle's parameters: the numbers that can be changed in flight (fsw/tuning.py), and some that can be read."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

from bus.mavlink.parameters import Parameter
from fsw import tuning
from fsw.flight import Flight
from fsw.ground.uplink import Uplink
from fsw.node import FswNode

SLACK = 1e-6  # a limit as a 32-bit float may be a little beyond it


def list_parameters(node: FswNode, uplink: Uplink) -> list[Parameter]:
    """Return the parameters of a vehicle."""
    flight = node.flight
    found = [_make_changeable(flight, uplink, name) for name in tuning.list_names(flight)]
    for name, text, value in _list_known(node):
        found.append(Parameter(name, partial(float, value), None, text=text))
    return found


def _make_changeable(flight: Flight, uplink: Uplink, name: str) -> Parameter:
    number = tuning.BY_NAME.get(name)
    write: Callable[[float], str] = lambda value: uplink.set_number(name, tidy(value))  # noqa: E731
    if number is None:
        key = tuning.list_gains(flight)[name]
        return Parameter(
            name, partial(uplink.read_number, name), write, text=f"{key} of the law {flight.law_settings.kind}"
        )
    low, high = number.low - abs(number.low) * SLACK, number.high + abs(number.high) * SLACK
    return Parameter(name, partial(uplink.read_number, name), write, low, high, number.text)


def _list_known(node: FswNode) -> list[tuple[str, str, float]]:
    """Name, text and value of what stays as it is."""
    flight = node.flight
    vehicle = flight.vehicle
    rows = [
        ("TICK_HZ", "rate of the cycle [Hz]", 1e9 / node.tick_ns),
        ("CONTROL_DIVIDER", "ticks of a control period", float(flight.control_ticks)),
    ]
    for i, axes in enumerate(("XX", "YY", "ZZ")):
        rows.append((f"INERTIA_{axes}", "as the flight software believes it [kg m^2]", vehicle.inertia_kgm2[i][i]))
    for i in (0, 1, 2, 3):
        rows.append((f"WHEEL{i + 1}_MAX_NM", "torque limit [N m]", vehicle.wheels.max_torque_nm[i]))
        rows.append((f"WHEEL{i + 1}_MAX_RAD_S", "speed limit [rad/s]", vehicle.wheel_max_speed_rad_s[i]))
    return rows


def tidy(value: float) -> float:
    """Return the shortest decimal number that is this value as a 32-bit float: 0.3, not 0.30000001192092896."""
    for digits in (6, 7, 8, 9):
        text = float(f"{value:.{digits}g}")
        try:
            if struct.pack("<f", text) == struct.pack("<f", value):
                return text
        except OverflowError:
            break
    return value
