"""Watches the bus: which units have fallen silent, which ids come far too often, what the CAN controller reports.

Nothing here is looked at while every unit speaks in its turn: a silent unit is looked for on ticks on which somebody is
missing, a babbling id in batches that hold more frames between the usual ones than a tick can bring.
"""

from __future__ import annotations

from typing import Final

from bus.icd.e2e import LOST, OK, Link
from bus.wire.frames import ERR_FLAG, FRAME_ID, FRAME_SIZE
from fsw.records import NOT_HEARD

UNITS: Final = ("wheel.1", "wheel.2", "wheel.3", "wheel.4", "gyro.x", "gyro.y", "gyro.z", "star_tracker")
STAR: Final = 7  # place of the star tracker among them
SILENT_HOLDS: Final = 2  # a unit is silent once it is missing for so many times as long as a value is held
LEAST_SILENT_TICKS: Final = 10
OFTEN: Final = 5  # frames of one id in a batch, which no unit sends
FOREIGN_FLOOD: Final = 16  # frames that nobody listens to in a batch, each id less than OFTEN
ROW: Final = 3  # batches in a row that make a babbler: one alone is what has piled up while a tick was late
CALM_TICKS: Final = 10  # after which it is over
MOST_TAKEN: Final = (
    64  # frames of one id out of one batch; more are counted and left, so that no flood makes a cycle long
)
MOST_IDS: Final = 32  # that are followed at a time
MANY_BYTES: Final = (OFTEN - 1) * FRAME_SIZE  # a batch of that size holds no id too often
FOREIGN: Final = -1  # stands for all ids that nobody listens to
NEVER_DUE: Final = 1 << 62

# classes of error frames and what data[1] says, linux/can/error.h
CRTL, BUSOFF, RESTARTED = 0x4, 0x40, 0x100
WARNING_BITS, PASSIVE_BITS, ACTIVE_BITS = 0x0C, 0x30, 0x40
WORDS: Final = ("error active again", "at the warning limit", "error passive", "bus-off", "restarted")
BACK_ACTIVE, WARNS, PASSIVE, OFF, BACK = 0, 1, 2, 3, 4
QUIET_TICKS: Final = 500  # between two lines that say the same of a unit or of the CAN controller

Line = tuple[int, str, str]  # tick, level, words


class Babbler:
    """An id that comes too often."""

    __slots__ = ("count", "is_named", "last_tick", "row")

    def __init__(self) -> None:
        self.count = 0  # frames in the last batch in which it was too often,
        self.last_tick = NOT_HEARD  # on which tick that was,
        self.row = 0  # how many there have been in a row,
        self.is_named = False  # and whether it has been called a babbler


class LinkWatch:
    """What is wrong with the links to the units, in numbers for telemetry and in lines for people."""

    def __init__(self, hold_ticks: int, star_hold_ticks: int, fitted: tuple[bool, bool, bool, bool]) -> None:
        a, b, c, d = fitted
        self._watched = (a, b, c, d, True, True, True, True)
        ticks = max(LEAST_SILENT_TICKS, SILENT_HOLDS * hold_ticks)
        self._limits = (ticks, ticks, ticks, ticks, ticks, ticks, ticks, max(ticks, star_hold_ticks))
        self.reset()

    def reset(self) -> None:
        """Forget everything, as after boot."""
        self.silent = [False] * len(UNITS)
        self._said_silent = [False] * len(UNITS)
        self._named_tick = [NOT_HEARD] * len(UNITS)
        self.babblers: dict[int, Babbler] = {}
        self.babbling = 0  # how many ids are named
        self.error_frames = 0
        self.flooded = 0  # frames so far that were left in a batch
        self.last_babbler = 0  # id that was named last
        self.controller = BACK_ACTIVE  # of the CAN controller, as last reported
        self.lines: list[Line] = []  # that nobody has said yet
        self.is_troubled = False  # whether there has ever been anything to say
        self.next_look = (
            self._limits[STAR] + 1
        )  # tick on which somebody may have something to say without a missing unit
        self._said_ticks = [NOT_HEARD] * len(WORDS)

    # -- silent units --------------------------------------------------------------------------------------------------

    def look(self, tick: int, links: tuple[Link, ...]) -> None:
        """Look who is silent. links: in the order of UNITS."""
        gone: dict[str, list[str]] = {}  # who has fallen silent, by what there is to say of it
        back: list[str] = []
        for i in range(len(UNITS)):
            if not self._watched[i]:
                continue
            link = links[i]
            last = link.tick if link.accepted else -1
            is_silent = self.silent[i] = tick - last > self._limits[i]
            if is_silent == self._said_silent[i] or (is_silent and tick - self._named_tick[i] < QUIET_TICKS):
                continue
            self._said_silent[i] = is_silent
            if not is_silent:
                back.append(UNITS[i])
                continue
            self._named_tick[i] = tick
            refused = "" if link.outcome in (OK, LOST) else ": what comes is refused"
            gone.setdefault(f"silent since tick {last + 1}{refused}", []).append(UNITS[i])
        for words, units in gone.items():
            self._say(tick, "warning", f"{_list(units)} {words}")
        if back:
            self._say(tick, "info", f"{_list(back)} heard again")

    def look_ahead(self, tick: int, links: tuple[Link, ...]) -> None:
        """Look at what can change without a missing unit: the star tracker's slow frames, and babblers that have ended."""
        self.look(tick, links)
        for can_id in [can_id for can_id, item in self.babblers.items() if tick - item.last_tick > CALM_TICKS]:
            if self.babblers.pop(can_id).is_named:
                self.babbling -= 1
                self._say(tick, "info", f"{_name(can_id)} no longer babbles")
        star = links[STAR]
        due = (star.tick if star.accepted else -1) + self._limits[STAR] + 1
        self.next_look = tick + 1 if self.silent[STAR] or self.babblers else max(due, tick + 1)

    # -- too many frames -----------------------------------------------------------------------------------------------

    def thin(self, tick: int, frames: bytes, known: dict[int, Link]) -> bytes:
        """Return what of a batch is to be taken: all of it, unless an id comes more than MOST_TAKEN times."""
        counts: dict[int, int] = {}
        for (can_id,) in FRAME_ID.iter_unpack(frames):
            counts[can_id] = counts.get(can_id, 0) + 1
        foreign = most = 0
        for can_id, count in counts.items():
            if count > most:
                most = count
            if can_id & ERR_FLAG:
                continue
            if count >= OFTEN:
                self._note_often(tick, can_id, count)
            elif can_id not in known:
                foreign += count
        if foreign >= FOREIGN_FLOOD:
            self._note_often(tick, FOREIGN, foreign)
        return frames if most <= MOST_TAKEN else self._leave_rest(frames)

    def _note_often(self, tick: int, can_id: int, count: int) -> None:
        item = self.babblers.get(can_id)
        if item is None:
            if len(self.babblers) >= MOST_IDS:
                return
            item = self.babblers[can_id] = Babbler()
            self.next_look = tick + 1
        if item.last_tick == tick:
            return
        item.row = item.row + 1 if item.last_tick == tick - 1 else 1
        item.last_tick, item.count = tick, count
        if item.row >= ROW and not item.is_named:
            item.is_named = True
            self.babbling += 1
            self.last_babbler = can_id
            self._say(tick, "warning", f"babbling: {_name(can_id)}, {count} frames a tick")

    def _leave_rest(self, frames: bytes) -> bytes:
        taken: dict[int, int] = {}
        kept: list[bytes] = []
        at = 0
        for (can_id,) in FRAME_ID.iter_unpack(frames):
            count = taken.get(can_id, 0)
            if count < MOST_TAKEN:
                taken[can_id] = count + 1
                kept.append(frames[at : at + FRAME_SIZE])
            at += FRAME_SIZE
        left = len(frames) // FRAME_SIZE - len(kept)
        self.flooded += left
        self.is_troubled = True
        return b"".join(kept)

    # -- the controller ------------------------------------------------------------------------------------------------

    def note_error_frame(self, tick: int, can_id: int, data: bytes) -> None:
        """Take an error frame of the flight computer's own controller; a line for a change of its state."""
        self.error_frames += 1
        self.is_troubled = True
        if can_id & RESTARTED:
            self._note_state(tick, BACK)
        elif can_id & BUSOFF:
            self._note_state(tick, OFF)
        elif can_id & CRTL:
            bits = data[1]
            if bits & PASSIVE_BITS:
                self._note_state(tick, PASSIVE)
            elif bits & WARNING_BITS:
                self._note_state(tick, WARNS)
            elif bits & ACTIVE_BITS:
                self._note_state(tick, BACK_ACTIVE)

    def _note_state(self, tick: int, state: int) -> None:
        before = self.controller
        self.controller = BACK_ACTIVE if state == BACK else state
        if before == state or tick - self._said_ticks[state] < QUIET_TICKS:
            return
        self._said_ticks[state] = tick
        self._say(tick, "warning" if state in (PASSIVE, OFF) else "info", f"CAN controller {WORDS[state]}")

    def _say(self, tick: int, level: str, words: str) -> None:
        self.is_troubled = True
        self.lines.append((tick, level, words))

    def take_lines(self) -> list[Line]:
        """Return what there is to say, no longer kept."""
        lines, self.lines = self.lines, []
        return lines


def _list(units: list[str]) -> str:
    return f"{', '.join(units)} {'is' if len(units) == 1 else 'are'}"


def _name(can_id: int) -> str:
    return "frames that nobody listens to" if can_id == FOREIGN else f"id 0x{can_id:03X}"
