"""What the frames can carry: ranges of the physical values, and what becomes of a torque on its way."""

from __future__ import annotations

from bus.icd.messages import IDS, MESSAGES, Signal


def find_signal(message: str, name: str) -> Signal:
    """The signal of a message, with its scale and the range of its physical values."""
    return next(signal for signal in MESSAGES[IDS[message]].signals if signal.name == name)


_TORQUE = find_signal("RW1_CMD", "TORQUE")
_STEP_NM = _TORQUE.scale
_MAX_RAW = (1 << _TORQUE.length_bits - 1) - 1
_MIN_RAW = -_MAX_RAW - 1


def quantise_torque(torque_nm: float) -> tuple[float, bool]:
    """Torque that a wheel gets when this one is sent [N m], and whether it was cut to what the frame can carry.

    Exactly what decoding gives for what encoding makes of it, to the last bit: whole steps of 1e-7 N m, half-even.
    Raises ValueError for NaN, as the encoder does.
    """
    try:
        raw = round(torque_nm / _STEP_NM)
    except OverflowError:  # infinite
        raw = _MAX_RAW + 1 if torque_nm > 0.0 else _MIN_RAW - 1
    if raw > _MAX_RAW:
        return _MAX_RAW * _STEP_NM, True
    if raw < _MIN_RAW:
        return _MIN_RAW * _STEP_NM, True
    return raw * _STEP_NM, False
