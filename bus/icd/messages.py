"""What the frames on the bus are: ids, senders, receivers, signals, cycle times. The contract itself is icd.dbc.

The rows come from bus/icd/message_table.py, which is generated from the DBC, so that nothing is parsed at run time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bus.icd.message_table import ROWS

# Sent once per base tick, star-tracker measurement or second; per tick while a wheel is told to follow a setpoint; per
# second by each wheel that has slow telemetry; on request, at most one frame of all of them a tick.
SentPer = Literal["tick", "star", "second", "setpoint", "slow", "request"]


@dataclass(frozen=True, slots=True)
class Signal:
    """One value in a message. Physical value = raw * scale [unit]; little endian, no offsets."""

    name: str
    start_bit: int
    length_bits: int
    is_signed: bool
    scale: float
    minimum: float
    maximum: float
    unit: str
    choices: dict[int, str]  # raw value -> name, empty where the value is a number


@dataclass(frozen=True, slots=True)
class Message:
    """One data frame. The first three signals are CHECKSUM, COUNTER and a message's own 4-bit value."""

    frame_id: int
    name: str
    sender: str
    receivers: tuple[str, ...]
    sent_per: SentPer
    cycle_time_ms: int  # with ticks at 100 Hz and the star tracker at 10 Hz, 0: none; the scenario sets the real ones
    data_id: int
    signals: tuple[Signal, ...]


def _read_row(head: Any, rows: Any) -> Message:
    signals = tuple(Signal(*[*row[:-1], dict(row[-1])]) for row in rows)
    return Message(*[*head, signals])


MESSAGES: dict[int, Message] = {head[0]: _read_row(head, signals) for head, signals in ROWS}
IDS: dict[str, int] = {message.name: message.frame_id for message in MESSAGES.values()}


def dbc_path() -> Path:
    """Path of the DBC that ships with this package."""
    return Path(__file__).with_name("icd.dbc")
