"""What the frames can carry: ranges of the physical values, and what becomes of a torque on its way."""

from __future__ import annotations

from bus.icd.messages import IDS, MESSAGES, Signal


def _find(message: str, name: str) -> Signal:
    return next(signal for signal in MESSAGES[IDS[message]].signals if signal.name == name)


_TORQUE = _find("RW1_CMD", "TORQUE")
_STEP_NM = _TORQUE.scale
_MAX_RAW = (1 << _TORQUE.length_bits - 1) - 1
_MIN_RAW = -_MAX_RAW - 1


def torque_range_nm() -> tuple[float, float]:
    """Least and greatest torque command of a wheel [N m]."""
    return _TORQUE.minimum, _TORQUE.maximum


def speed_range_rad_s() -> tuple[float, float]:
    """Least and greatest rotor speed of the telemetry [rad/s]."""
    signal = _find("RW1_TLM", "SPEED")
    return signal.minimum, signal.maximum


def current_range_a() -> tuple[float, float]:
    """Least and greatest motor current of the telemetry [A]."""
    signal = _find("RW1_TLM", "CURRENT")
    return signal.minimum * 1e-3, signal.maximum * 1e-3


def rate_range_rad_s() -> tuple[float, float]:
    """Least and greatest rate of a gyro axis [rad/s]."""
    signal = _find("FOGX_RATE", "RATE")
    return signal.minimum, signal.maximum


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
