"""What each cycle of the flight software was given, as /fsw/input has it."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from bus.commands import Command
from bus.errors import RecordError
from bus.telemetry.cdr import ENCAPSULATION
from bus.telemetry.packing import check_input
from bus.wire.frames import FRAME_SIZE

# encapsulation, seconds, nanoseconds, slips, flags, checksum, bytes of the text of the commands
HEAD: Final = struct.Struct("<4siIIIII")
KNOWN_FLAGS: Final = 3
LENGTH_AT: Final = 4  # in a frame
LONGEST: Final = 8  # bytes of data; no transport lets a longer frame in


@dataclass(frozen=True, slots=True)
class CycleInput:
    """Everything that one cycle consumed."""

    tick: int
    slips: int  # deadlines missed so far, as its executive counted
    flags: int  # SAFE_ASKED, SHEDDING
    commands: tuple[Command, ...]  # of the ground, due on this tick
    frames: bytes  # received since the cycle before


def parse_input(tick: int, data: bytes) -> CycleInput:
    """The input of a cycle from its record. Raises RecordError when it is none."""
    try:
        encapsulation, _, _, slips, flags, crc, size = HEAD.unpack_from(data)
        text_end = HEAD.size + size
        frames_at = HEAD.size + size + -size % 4 + 4
        count = int.from_bytes(data[frames_at - 4 : frames_at], "little")
        frames = data[frames_at:]
        text = data[HEAD.size : text_end - 1].decode()
        sound = (
            encapsulation == ENCAPSULATION
            and size > 0
            and not any(data[text_end - 1 : frames_at - 4])  # its end and the padding
            and not flags & ~KNOWN_FLAGS
            and len(frames) == count
            and not count % FRAME_SIZE
            and max(frames[LENGTH_AT::FRAME_SIZE], default=0) <= LONGEST
            and crc == check_input(slips, flags, text, frames)
        )
        commands = tuple(Command.from_json(line) for line in text.split("\n")) if text else ()
    except (struct.error, ValueError, IndexError, TypeError) as error:
        raise RecordError(f"/fsw/input of tick {tick} is damaged: {error}") from None
    if not sound:
        raise RecordError(f"/fsw/input of tick {tick} is damaged: its checksum or its layout is wrong")
    return CycleInput(tick, slips, flags, commands, frames)
