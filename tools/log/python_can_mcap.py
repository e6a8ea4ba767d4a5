"""python-can's reader and writer for .mcap, so that can_player, can_logger and can_logconvert take our logs.

Registered as entry points `can.io.message_reader` and `can.io.message_writer` under the name `.mcap`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import can
from can.io.generic import MessageReader, MessageWriter

from bus.errors import RecordError
from bus.telemetry.cdr import FRAMES_SCHEMA, FRAMES_TEXT
from bus.telemetry.link import pack_frames
from bus.wire.frames import EFF_FLAG, EFF_MASK, ERR_FLAG, FRAME, RTR_FLAG
from tools.log.mcap_reader import Run, read_run
from tools.log.mcap_writer import McapWriter

CHUNK_MESSAGES: Final = 2000


def iterate_frames(run: Run, buses: Sequence[str] = ()) -> Iterator[can.Message]:
    """The frames of a log in order of time (default: of all buses); channel is the bus name, timestamp in s."""
    present = [name.removeprefix("/can/") for name, info in run.topics.items() if info.schema_name == FRAMES_SCHEMA]
    rows: list[tuple[int, str, int, int, bytes]] = []
    for bus in buses or present:
        frames = run.frames(bus)
        data = frames["data"].tobytes()
        columns = (frames[name].tolist() for name in ("t_ns", "id", "dlc"))
        rows += [
            (t_ns, bus, can_id, dlc, data[8 * index : 8 * index + min(dlc, 8)])
            for index, (t_ns, can_id, dlc) in enumerate(zip(*columns, strict=True))
        ]
    if len(buses or present) > 1:
        rows.sort(key=lambda row: row[0])
    for t_ns, bus, can_id, dlc, data in rows:
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

    Raises RecordError for a CAN FD frame, which the format has no room for.
    """

    def __init__(self, file: Any, append: bool = False, **kwargs: Any) -> None:
        if append:
            raise RecordError(f"{file}: frames cannot be appended to an MCAP log; name a new file")
        self._writer = McapWriter(_as_path(file))
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._waiting: list[bytes] = []

    def on_message_received(self, msg: can.Message) -> None:
        if msg.is_fd:
            raise RecordError(f"frame {msg.arbitration_id:#x} is CAN FD; an MCAP log of hilsat takes classic CAN only")
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
        self._waiting.append(pack_frames(channel, number, round(msg.timestamp * 1e9), frame))
        if len(self._waiting) >= CHUNK_MESSAGES:
            self._flush()

    def file_size(self) -> int:
        """Bytes written so far."""
        return self._writer.size

    def stop(self) -> None:
        self._flush()
        self._writer.close()

    def _flush(self) -> None:
        if self._waiting:
            self._writer.write_chunk(self._waiting)
            self._waiting = []


def _as_path(file: Any) -> Path:
    """The path behind what python-can hands over: a path, or an open file."""
    if isinstance(file, str | os.PathLike):
        return Path(file)
    name = getattr(file, "name", None)
    if not isinstance(name, str):
        raise RecordError("an MCAP log is opened by its path; this file object has none")
    return Path(name)
