"""The recorder process: reads the pipes of the other processes and writes the log.

    python -P -m tools.run.recorder_process --out run.mcap --meta meta.json --source 1:FD --source 2:FD

META is a JSON object: metadata {text: text}, attachments [{name, media_type, text}], realtime true or false. It ends
when every pipe has closed, and says nothing when all went well. The first SIGTERM, SIGINT or SIGHUP is for the other
processes, whose end closes the pipes; a second one closes the log at once. Exit codes: 0, 2 usage, 3 cannot write.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final

from bus.errors import RecordError, UsageError
from bus.process import ENDING, guard_process
from bus.telemetry.link import ANNOUNCE, CLOSE, HEADER, JSON, MAGIC, TICK
from tools.log.recorder import Recorder, RecordSummary, RunAttachment

READ_BYTES: Final = 1 << 16  # larger buffers cost a mapping a read
REST_S: Final = {True: 0.05, False: 0.005}  # between looks at the pipes, by realtime: they hold 1 MB each
NAMES: Final = {1: "plant", 2: "flight software"}


class HeldClock:
    """The monotonic clock as of the last `advance()`: a system call less for every tick."""

    def __init__(self) -> None:
        self.advance()

    def __call__(self) -> float:
        return self._now_s

    def advance(self) -> None:
        """Read the clock."""
        self._now_s = time.monotonic()


class SourceStream:
    """The pieces that come through one pipe, handed to the recorder as they become whole."""

    def __init__(self, recorder: Recorder, source: int, fd: int) -> None:
        self.fd = fd
        self._recorder = recorder
        self._source = source
        self._name = NAMES.get(source, f"source {source}")
        self._buffer = b""
        self._closed = False  # it has said goodbye
        self.behind = False  # the last read took all it could

    def read(self) -> bool:
        """Take what is waiting; False once the pipe has closed. Raises RecordError for bytes that are no telemetry."""
        try:
            data = os.read(self.fd, READ_BYTES)
        except BlockingIOError:
            return True
        self.behind = len(data) == READ_BYTES
        if not data:
            self._end()
            return False
        self._take(self._buffer + data)
        return True

    def _take(self, data: bytes) -> None:
        at, end, head = 0, len(data), HEADER.size
        while at + head <= end:
            magic, kind, source, size, tick, t_ns = HEADER.unpack_from(data, at)
            if magic != MAGIC or source != self._source or size < 0:
                raise RecordError(f"telemetry of the {self._name}: what comes through its pipe is not telemetry")
            if at + head + size > end:
                break
            body = data[at + head : at + head + size]
            at += head + size
            if kind == TICK:
                self._recorder.write_ticks(source, [tick], t_ns, [body])
            else:
                self._take_other(kind, t_ns, body)
        self._buffer = data[at:]

    def _take_other(self, kind: int, t_ns: int, body: bytes) -> None:
        if kind == ANNOUNCE:
            self._recorder.announce(self._source, body)
        elif kind == JSON:
            topic, _, payload = body.partition(b"\0")
            self._recorder.write_json(self._source, topic.decode(), t_ns, payload)
        elif kind == CLOSE:
            goodbye = json.loads(body)
            self._closed = True
            self._recorder.end_source(self._source, goodbye["reason"], goodbye["dropped"])
        else:
            raise RecordError(f"telemetry of the {self._name}: piece of unknown kind {kind}")

    def _end(self) -> None:
        if not self._closed:
            self._recorder.end_source(self._source, "its pipe closed without a goodbye")
            self._recorder.report("error", f"the {self._name} ended without closing its telemetry")


def record(
    recorder: Recorder, sources: Sequence[tuple[int, int]], clock: HeldClock, realtime: bool = False
) -> RecordSummary:
    """Record until every pipe has closed or a second signal arrives; return what the log holds.

    sources  : pairs of source number and the read end of its pipe
    clock    : the one that the recorder was given
    realtime : the processes must not be disturbed: look at the pipes 20 times a second
    Raises RecordError when the log cannot be written; what is in it stays readable.
    """
    signals: list[int] = []

    def count(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    previous = {number: signal.signal(number, count) for number in ENDING}
    streams = {fd: SourceStream(recorder, source, fd) for source, fd in sources}
    poller = select.poll()
    for fd in streams:
        os.set_blocking(fd, False)
        poller.register(fd, select.POLLIN)
    try:
        while streams and len(signals) < 2:
            ready = poller.poll(recorder.poll() * 1000)
            clock.advance()
            for fd, _ in ready:
                if not streams[fd].read():
                    poller.unregister(fd)
                    del streams[fd]
            # Writing into a pipe on which nobody waits is cheap: it wakes nobody up.
            if streams and not any(stream.behind for stream in streams.values()):
                time.sleep(REST_S[realtime])
        return recorder.close()
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the recorder process; return its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -P -m tools.run.recorder_process", description="Record the telemetry of a run."
    )
    parser.add_argument("--out", type=Path, required=True, help="MCAP file to write")
    parser.add_argument("--meta", type=Path, required=True, help="JSON file: metadata, attachments, realtime")
    parser.add_argument("--source", action="append", required=True, metavar="N:FD", help="1 plant, 2 flight software")
    args = parser.parse_args(argv)
    return guard_process("recorder", lambda: _record(args))


def _record(args: argparse.Namespace) -> None:
    sources = [_parse_source(text) for text in args.source]
    meta = _read_meta(args.meta)
    clock = HeldClock()
    recorder = Recorder(
        args.out,
        metadata=meta["metadata"],
        attachments=[RunAttachment(a["name"], a["media_type"], a["text"].encode()) for a in meta["attachments"]],
        sources=[source for source, _ in sources],
        realtime=meta["realtime"],
        clock=clock,
    )
    record(recorder, sources, clock, meta["realtime"])


def _parse_source(text: str) -> tuple[int, int]:
    number, _, fd = text.partition(":")
    if not (number.isdecimal() and fd.isdecimal() and 0 < int(number) < 255):
        raise UsageError(f'--source "{text}" is not N:FD, a source number (1..254) and a file descriptor')
    return int(number), int(fd)


def _read_meta(path: Path) -> dict[str, Any]:
    try:
        given: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"--meta {path}: cannot be read as JSON: {error}") from None
    return {"metadata": {}, "attachments": [], "realtime": False} | given


if __name__ == "__main__":
    sys.exit(main())
