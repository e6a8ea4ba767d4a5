"""How much of a real CAN bus a schedule needs in the worst case, and the refusal of one that would not fit.

Worst case means that every frame is stuffed as often as the protocol allows: Davis, Burns, Bril & Lukkien 2007,
"Controller Area Network (CAN) schedulability analysis", eq (1).
"""

from __future__ import annotations

from bus.errors import BusLoadError
from bus.icd.messages import MESSAGES, SentPer

LOAD_LIMIT = 0.80  # above this, low-priority frames may wait longer than a tick
BIT_RATES_BPS = (125_000, 250_000, 500_000, 1_000_000)  # CiA 301 rates worth offering
DATA_BYTES = 8  # of every message in the ICD
WHEELS = 4


def worst_case_bits(data_bytes: int, *, extended: bool = False) -> int:
    """Bits of one data frame with worst-case stuffing and the 3 bits of interframe space [bit].

    Davis et al. 2007, eq (1): g + 8 s + 13 + floor((g + 8 s - 1) / 4), with s data bytes and g = 34 (11-bit id) or
    54 (29-bit id) bits that are subject to stuffing besides the data. 8 bytes on an 11-bit id: 135 bits.
    Raises ValueError unless 0 <= data_bytes <= 8.
    """
    if not 0 <= data_bytes <= 8:
        raise ValueError(f"a classic CAN frame has 0..8 data bytes, not {data_bytes}")
    stuffable = (54 if extended else 34) + 8 * data_bytes
    return stuffable + 13 + (stuffable - 1) // 4


def required_bits_per_s(
    tick_rate_hz: float, star_rate_hz: float, motor_wheels: int = 0, setpoint_wheels: int = 0
) -> float:
    """Bits per second that the ICD needs in the worst case [bit/s].

    star_rate_hz    : 0 where there is no tracker
    motor_wheels    : wheels with slow telemetry; with any, a request to one of them goes out on every tick
    setpoint_wheels : wheels that follow a current or a speed, at most all four
    """
    rate_hz = _list_rates(tick_rate_hz, star_rate_hz, motor_wheels, setpoint_wheels)
    return worst_case_bits(DATA_BYTES) * sum(rate_hz[message.sent_per] for message in MESSAGES.values())


def _list_rates(
    tick_rate_hz: float, star_rate_hz: float, motor_wheels: int, setpoint_wheels: int
) -> dict[SentPer, float]:
    """Frames per second of one message, by what it is sent per [Hz]; where that depends on the wheel, the mean of all."""
    return {
        "tick": tick_rate_hz,
        "star": star_rate_hz,
        "second": 1.0,
        "slow": motor_wheels / WHEELS,
        "request": tick_rate_hz / WHEELS if motor_wheels else 0.0,  # one frame a tick, to whichever wheel
        "setpoint": tick_rate_hz * setpoint_wheels / WHEELS / 2,  # a wheel follows a current or a speed, not both
    }


def bus_load(
    tick_rate_hz: float, star_rate_hz: float, bit_rate_bps: float, motor_wheels: int = 0, setpoint_wheels: int = 0
) -> float:
    """Share of the bus that the schedule needs in the worst case [-]; above 1 it cannot be carried at all."""
    return required_bits_per_s(tick_rate_hz, star_rate_hz, motor_wheels, setpoint_wheels) / bit_rate_bps


def fitting_tick_rate_hz(
    star_rate_hz: float, bit_rate_bps: float, motor_wheels: int = 0, setpoint_wheels: int = 0
) -> int:
    """Highest whole tick rate that stays within the limit [Hz]; 0 where none does."""
    at_rest = required_bits_per_s(0.0, star_rate_hz, motor_wheels, setpoint_wheels)
    bits_per_tick = required_bits_per_s(1.0, star_rate_hz, motor_wheels, setpoint_wheels) - at_rest
    return max(0, int((LOAD_LIMIT * bit_rate_bps - at_rest) / bits_per_tick))


def check_load(
    tick_rate_hz: float, star_rate_hz: float, bit_rate_bps: float, motor_wheels: int = 0, setpoint_wheels: int = 0
) -> float:
    """Worst-case load of the schedule [-]. Raises BusLoadError above 80 %, with the figure and what would fit."""
    load = bus_load(tick_rate_hz, star_rate_hz, bit_rate_bps, motor_wheels, setpoint_wheels)
    if load <= LOAD_LIMIT:
        return load
    needed = required_bits_per_s(tick_rate_hz, star_rate_hz, motor_wheels, setpoint_wheels)
    star = f" and a star tracker at {star_rate_hz:g} Hz" if star_rate_hz else ""
    star += f", with slow telemetry of {motor_wheels} wheels and requests to them," if motor_wheels else ""
    choices = []
    slower = fitting_tick_rate_hz(star_rate_hz, bit_rate_bps, motor_wheels, setpoint_wheels)
    if slower:
        choices.append(f"a tick rate of at most {slower} Hz")
    faster = next((rate for rate in BIT_RATES_BPS if needed <= LOAD_LIMIT * rate), None)
    if faster:
        choices.append(f"a bit rate of {faster} bit/s ({100 * needed / faster:.1f} %)")
    raise BusLoadError(
        f"bus: ticks at {tick_rate_hz:g} Hz{star} need {needed:.0f} bit/s with worst-case stuffing, "
        f"{100 * load:.1f} % of {bit_rate_bps:g} bit/s; allowed is {100 * LOAD_LIMIT:.0f} %; "
        f"what fits: {' or '.join(choices) or 'nothing on classic CAN; lower both rates'}"
    )
