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
MOST_PLACES: Final = 1000
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
        self._places: dict[bytes, tuple[int, int]] = {}  # by the ids of a tick
        self._idle = True  # nothing waits for its match
        self.compared = 0
        self.differing = 0
        self.unheard = 0  # frames sent again that the plant did not log

    def match(self, sent: bytes, ahead: deque[LogRecord], tick: int) -> Found | None:
        """Take the frames that a cycle sends, and those of the bus up to its tick out of `ahead`; the first mismatch."""
        if self._idle and ahead and ahead[0].sequence == tick and (len(ahead) == 1 or ahead[1].sequence > tick):
            frames = ahead[0].data[FRAMES_AT - DATA_AT :]
            start, end = self._find_ours(frames)
            if end and frames[start:end] == sent:  # nearly always
                ahead.popleft()
                self.compared += (end - start) // FRAME_SIZE
                return None
        _sort(sent, self._replayed)
        while ahead and ahead[0].sequence <= tick:
            self.note_recorded(ahead.popleft())
        found = self.compare()
        self._idle = not any(self._recorded.values()) and not any(self._replayed.values())
        return found

    def _find_ours(self, frames: bytes) -> tuple[int, int]:
        """From where to where the frames of the flight software are in those of a tick; (0, 0) where others are between."""
        ids = frames[0::FRAME_SIZE] + frames[1::FRAME_SIZE] + frames[2::FRAME_SIZE] + frames[3::FRAME_SIZE]
        place = self._places.get(ids)
        if place is None:
            starts = range(0, len(frames) - FRAME_SIZE + 1, FRAME_SIZE)
            ours = [at for at in starts if int.from_bytes(frames[at : at + 4], "little") in self._recorded]
            apart = not ours or ours[-1] - ours[0] != FRAME_SIZE * (len(ours) - 1)
            place = (0, 0) if apart else (ours[0], ours[-1] + FRAME_SIZE)
            if len(self._places) < MOST_PLACES:
                self._places[ids] = place
        return place

    def note_recorded(self, record: LogRecord) -> None:
        """Take the frames of a tick of the bus."""
        _sort(record.data[FRAMES_AT - DATA_AT :], self._recorded)

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
