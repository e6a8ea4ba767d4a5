"""Drive: from the torques that were allocated to the commands of the wheels, as their frames can carry them."""

from __future__ import annotations

from typing import Final

from bus.icd.ranges import find_signal, quantise_torque
from bus.linear import ZERO4
from bus.units import Vec4
from fsw.records import ALL_WHEELS, WheelCommands, WheelHealth

OFF: Final = 0  # mode of a command frame
TORQUE: Final = 1
ALL_OFF, ALL_TORQUE = (OFF, OFF, OFF, OFF), (TORQUE, TORQUE, TORQUE, TORQUE)
_SIGNAL = find_signal("RW1_CMD", "TORQUE")
_SCALE: Final = _SIGNAL.scale
_LEAST: Final = round(_SIGNAL.minimum / _SCALE)
_LARGEST: Final = round(_SIGNAL.maximum / _SCALE)
REST = WheelCommands(ALL_OFF, ZERO4, 0)


def command_wheels(tau_rw_nm: Vec4, health: WheelHealth) -> WheelCommands:
    """Return the commands for these torques on the body [N m]; a wheel that is not available is switched off.

    The torques that come back are those that the wheels will read: whole steps of the frame's resolution, cut to its range.
    Whoever reckons with what was commanded reckons with these.
    """
    if health.available != ALL_WHEELS:
        a, b, c, d = tau_rw_nm
        p, q, r, s = health.available
        tau_rw_nm = (a if p else 0.0, b if q else 0.0, c if r else 0.0, d if s else 0.0)
        modes = (TORQUE if p else OFF, TORQUE if q else OFF, TORQUE if r else OFF, TORQUE if s else OFF)
    else:
        modes = ALL_TORQUE
    a, b, c, d = tau_rw_nm
    w1, w2, w3, w4 = round(a / _SCALE), round(b / _SCALE), round(c / _SCALE), round(d / _SCALE)
    if not (
        _LEAST <= w1 <= _LARGEST and _LEAST <= w2 <= _LARGEST and _LEAST <= w3 <= _LARGEST and _LEAST <= w4 <= _LARGEST
    ):
        (a, p), (b, q), (c, r), (d, s) = (quantise_torque(torque_nm) for torque_nm in tau_rw_nm)
        return WheelCommands(modes, (a, b, c, d), p + q + r + s)
    return WheelCommands(modes, (w1 * _SCALE, w2 * _SCALE, w3 * _SCALE, w4 * _SCALE), 0)
