"""How much of a real CAN bus a schedule needs in the worst case, and the refusal of one that would not fit.

Worst case means that every frame is stuffed as often as the protocol allows: Davis, Burns, Bril & Lukkien 2007,
"Controller Area Network (CAN) schedulability analysis", eq (1).
"""

from __future__ import annotations

from bus.errors import BusLoadError
from bus.icd.messages import MESSAGES

LOAD_LIMIT = 0.80  # above this, low-priority frames may wait longer than a tick
BIT_RATES_BPS = (125_000, 250_000, 500_000, 1_000_000)  # CiA 301 rates worth offering
DATA_BYTES = 8  # of every message in the ICD


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


def required_bits_per_s(tick_rate_hz: float, star_rate_hz: float) -> float:
    """Bits per second that the whole ICD needs in the worst case [bit/s]; star_rate_hz 0 where there is no tracker."""
    rate_hz = {"tick": tick_rate_hz, "star": star_rate_hz, "second": 1.0}
    return worst_case_bits(DATA_BYTES) * sum(rate_hz[message.sent_per] for message in MESSAGES.values())


def bus_load(tick_rate_hz: float, star_rate_hz: float, bit_rate_bps: float) -> float:
    """Share of the bus that the schedule needs in the worst case [-]; above 1 it cannot be carried at all."""
    return required_bits_per_s(tick_rate_hz, star_rate_hz) / bit_rate_bps


def fitting_tick_rate_hz(star_rate_hz: float, bit_rate_bps: float) -> int:
    """Highest whole tick rate that stays within the limit [Hz]; 0 where none does."""
    frames_per_tick = sum(message.sent_per == "tick" for message in MESSAGES.values())
    bits_left = LOAD_LIMIT * bit_rate_bps - required_bits_per_s(0.0, star_rate_hz)
    return max(0, int(bits_left / (frames_per_tick * worst_case_bits(DATA_BYTES))))


def check_load(tick_rate_hz: float, star_rate_hz: float, bit_rate_bps: float) -> float:
    """Worst-case load of the schedule [-]. Raises BusLoadError above 80 %, with the figure and what would fit."""
    load = bus_load(tick_rate_hz, star_rate_hz, bit_rate_bps)
    if load <= LOAD_LIMIT:
        return load
    needed = required_bits_per_s(tick_rate_hz, star_rate_hz)
    star = f" and a star tracker at {star_rate_hz:g} Hz" if star_rate_hz else ""
    choices = []
    slower = fitting_tick_rate_hz(star_rate_hz, bit_rate_bps)
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
