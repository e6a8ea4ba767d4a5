"""python-can's reader and writer for .mcap, so that can_player, can_logger and can_logconvert take our logs.

Registered as entry points `can.io.message_reader` and `can.io.message_writer` under the name `.mcap`.
"""

from __future__ import annotations

import heapq
import itertools
import operator
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import can
from can.io.generic import MessageReader, MessageWriter

from bus.errors import RecordError
from bus.telemetry.cdr import ENCAPSULATION, FRAMES_SCHEMA, FRAMES_TEXT
from bus.telemetry.packing import HEAD, pack_frames_stamped
from bus.wire.frames import EFF_FLAG, EFF_MASK, ERR_FLAG, FRAME, RTR_FLAG
from tools.log.mcap_reader import Run, read_run
from tools.log.mcap_writer import McapWriter

CHUNK_MESSAGES: Final = 2000
LATEST_S: Final = 2**63 / 1e9  # log times are read as signed numbers of ns
LAST_STAMP_S: Final = 2**31 - 1
MOST_REFUSED: Final = 20  # that the log lists
TIME_OF: Final = operator.itemgetter(0)


def iterate_frames(run: Run, buses: Sequence[str] = ()) -> Iterator[can.Message]:
    """The frames of a log in order of time (default: of all buses); channel is the bus name, timestamp in s."""
    rows = [_iterate_bus(run, bus) for bus in buses or run.buses()]
    for t_ns, bus, can_id, dlc, data in heapq.merge(*rows, key=TIME_OF) if len(rows) > 1 else itertools.chain(*rows):
        remote = bool(can_id & RTR_FLAG)
        yield can.Message(
            timestamp=t_ns * 1e-9,
            arbitration_id=can_id & EFF_MASK,
            is_extended_id=bool(can_id & EFF_FLAG),
            is_remote_frame=remote,
            is_error_frame=bool(can_id & ERR_FLAG),
            channel=bus,
            dlc=dlc,
            data=None if remote else data,
        )


def _iterate_bus(run: Run, bus: str) -> Iterator[tuple[int, str, int, int, bytes]]:
    """Time [ns], bus, id with flags, length and data of every frame of a bus, in file order."""
    for frames in run.iterate_frames(bus):
        data = frames["data"].tobytes()
        columns = (frames[name].tolist() for name in ("t_ns", "id", "dlc"))
        for index, (t_ns, can_id, dlc) in enumerate(zip(*columns, strict=True)):
            length = min(dlc, 8)
            yield t_ns, bus, can_id, length, data[8 * index : 8 * index + length]


class RefusedFrame(RecordError, can.CanError):
    """A frame that a log has no room for."""


class McapLogReader(MessageReader):
    """Iterates over the frames of a log. `channel` limits it to one bus."""

    def __init__(self, file: Any, channel: str | None = None, **kwargs: Any) -> None:
        self._run = read_run(_as_path(file))
        self._buses = [] if channel is None else [channel]

    def __iter__(self) -> Iterator[can.Message]:
        return iterate_frames(self._run, self._buses)

    def stop(self) -> None:
        """Nothing is left open."""


class McapLogWriter(MessageWriter):
    """Writes classic CAN frames to a log of frames only, one topic /can/<channel> for each channel.

    Log times reach from 1970 to 2262. The stamp inside a message ends in January 2038 and stands still there: the time of
    a frame is its log time.
    Raises RefusedFrame for a CAN FD frame or one stamped outside that time, which the format has no room for; the log
    says how many there were. RecordError when the file is there already or cannot be written.
    """

    def __init__(self, file: Any, append: bool = False, **kwargs: Any) -> None:
        if append:
            raise RecordError(f"{file}: frames cannot be appended to an MCAP log; name a new file")
        # An open file was made by the caller: that it is there is no surprise.
        self._writer = McapWriter(_as_path(file), replace=not isinstance(file, str | os.PathLike))
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._waiting: list[bytes] = []
        self._refused: list[str] = []

    def on_message_received(self, msg: can.Message) -> None:
        """Write one frame."""
        if msg.is_fd:
            raise self._refuse(msg, "is CAN FD; an MCAP log of hilsat takes classic CAN only")
        if not 0.0 <= msg.timestamp < LATEST_S:
            raise self._refuse(msg, f"is stamped {msg.timestamp:g} s; an MCAP log takes times from 1970 to 2262")
        bus = "bus0" if msg.channel is None else str(msg.channel)
        channel = self._channels.get(bus)
        if channel is None:
            channel = self._channels[bus] = len(self._channels) + 1
            schema = (FRAMES_SCHEMA, "ros2msg", FRAMES_TEXT)
            self._writer.add_channel(channel, f"/can/{bus}", "cdr", schema, {"deterministic": "true"})
        number = self._counts[bus] = self._counts.get(bus, -1) + 1
        can_id = (
            msg.arbitration_id
            | (EFF_FLAG if msg.is_extended_id else 0)
            | (RTR_FLAG if msg.is_remote_frame else 0)
            | (ERR_FLAG if msg.is_error_frame else 0)
        )
        frame = FRAME.pack(can_id, msg.dlc, bytes(msg.data))
        self._waiting.append(pack_frames_stamped(channel, _stamp(number, round(msg.timestamp * 1e9)), frame))
        if len(self._waiting) >= CHUNK_MESSAGES:
            self._flush()

    def _refuse(self, msg: can.Message, why: str) -> RefusedFrame:
        self._refused.append(f"frame {msg.arbitration_id:#x} {why}")
        return RefusedFrame(self._refused.pop() if len(self._refused) > MOST_REFUSED else self._refused[-1])

    def file_size(self) -> int:
        """Bytes written so far."""
        return self._writer.size

    def stop(self) -> None:
        """Close the file."""
        self._flush()
        if self._refused:
            self._writer.add_metadata("recording", {"refused": "; ".join(self._refused)})
        self._writer.close()

    def _flush(self) -> None:
        if self._waiting:
            self._writer.write_chunk(self._waiting)
            self._waiting = []


def _stamp(number: int, t_ns: int) -> bytes:
    """What stands behind the channel of a Message record; the stamp of the message saturates in January 2038."""
    sec, nsec = divmod(t_ns, 1_000_000_000)
    return HEAD.pack(number & 0xFFFFFFFF, t_ns, t_ns, ENCAPSULATION, min(sec, LAST_STAMP_S), nsec)


def _as_path(file: Any) -> Path:
    """The path behind what python-can hands over: a path, or an open file."""
    if isinstance(file, str | os.PathLike):
        return Path(file)
    name = getattr(file, "name", None)
    if not isinstance(name, str):
        raise RecordError("an MCAP log is opened by its path; this file object has none")
    return Path(name)
