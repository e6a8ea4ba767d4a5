"""The frames of the flight software that the plant logged, beside those that a replay sends."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Final

from bus.icd.messages import MESSAGES
from bus.wire.frames import FRAME_SIZE
from tools.log.mcap_reader import FRAMES_AT, LogRecord, Run
from tools.log.message_index import DATA_AT

BUS: Final = "/can/bus0"
SAID_BY_FSW: Final = tuple(sorted(can_id for can_id, message in MESSAGES.items() if message.sender == "FSW"))
PATIENCE: Final = 50  # real time: cycles that a logged frame may be ahead of the one that sent it


@dataclass(frozen=True, slots=True)
class Found:
    """One value that is not the same."""

    where: str
    signal: str
    recorded: Any
    replayed: Any


class HeardFrames:
    """The frames of the flight software as the plant logged them, beside those that it sends again: id by id, in order."""

    def __init__(self, run: Run) -> None:
        """In real time a frame may be lost, and one may be logged before or after the cycle that sent it."""
        self._lossy = run.metadata.get("run", {}).get("clock") == "realtime"
        self._recorded: dict[int, deque[bytes]] = {can_id: deque() for can_id in SAID_BY_FSW}
        self._replayed: dict[int, deque[bytes]] = {can_id: deque() for can_id in SAID_BY_FSW}
        self.compared = 0
        self.differing = 0
        self.unheard = 0  # frames sent again that the plant did not log

    def note_recorded(self, record: LogRecord) -> None:
        """Take the frames of a tick of the bus."""
        _sort(record.data[FRAMES_AT - DATA_AT :], self._recorded)

    def note_replayed(self, frames: bytes) -> None:
        """Take the frames of a cycle."""
        _sort(frames, self._replayed)

    def compare(self, at_end: bool = False) -> Found | None:
        """Match what both sides have by now; the first mismatch."""
        first = None
        for can_id in SAID_BY_FSW:
            recorded, replayed = self._recorded[can_id], self._replayed[can_id]
            while recorded and (replayed or at_end):
                frame = recorded[0]
                place = replayed.index(frame) if frame in replayed else -1
                if place < 0 and self._lossy and len(replayed) < PATIENCE and not at_end:
                    break  # it may still come
                self.compared += 1
                recorded.popleft()
                if place == 0 or (place > 0 and self._lossy):
                    self.unheard += place
                    for _ in range(place + 1):
                        replayed.popleft()
                else:
                    other = replayed.popleft() if replayed else b""
                    self.differing += 1
                    first = first or Found(
                        f"frame 0x{can_id:03X}", "data", frame[8:].hex(), other[8:].hex() or "no frame"
                    )
        if at_end:
            self.unheard += sum(map(len, self._replayed.values()))
        return first


def _sort(frames: bytes, queues: dict[int, deque[bytes]]) -> None:
    for at in range(0, len(frames), FRAME_SIZE):
        queue = queues.get(int.from_bytes(frames[at : at + 4], "little"))
        if queue is not None:
            queue.append(frames[at : at + FRAME_SIZE])
