"""What the flight computer's own controller reports, as error frames in the form of Linux (linux/can/error.h)."""

from __future__ import annotations

from typing import Final

from bus.wire.frames import ERR_FLAG, FRAME
from plant_server.can_bus.controller import Controller, State

CRTL, PROT, ACK, BUSOFF, BUSERROR, RESTARTED, CNT = 0x4, 0x8, 0x20, 0x40, 0x80, 0x100, 0x200  # classes
RX_WARNING, TX_WARNING, RX_PASSIVE, TX_PASSIVE, AGAIN_ACTIVE = 0x04, 0x08, 0x10, 0x20, 0x40  # data[1] of CRTL
UNSPECIFIED, BIT, STUFF, SENDING = 0x00, 0x01, 0x04, 0x80  # data[2] of PROT
IN_DATA, IN_CRC, IN_ACK = 0x0A, 0x08, 0x19  # data[3] of PROT
ERROR_DLC: Final = 8


def make_error_frame(
    kinds: int, controller: int = 0, protocol: int = 0, place: int = 0, tec: int = 0, rec: int = 0
) -> bytes:
    """Return one error frame of these classes."""
    data = bytes((0, controller, protocol, place, 0, 0, min(tec, 255), min(rec, 255)))
    return FRAME.pack(ERR_FLAG | kinds, ERROR_DLC, data)


class Reporter:
    """Watches one controller, and has a frame for each change of its state and, at most one a tick, for a bus error."""

    __slots__ = ("_controller", "_error", "_frames", "_level", "reported")

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._frames: list[bytes] = []
        self._level = 0  # 0 active, 1 warning, 2 passive, 3 off: as last reported
        self._error = b""
        self.reported = 0

    def note_error(self, kinds: int, protocol: int, place: int) -> None:
        """Keep the first bus error of the tick that it saw, unless it is off."""
        if not self._error and not self._controller.is_off:
            self._error = make_error_frame(kinds, 0, protocol, place)

    def look(self) -> None:
        """Note a change of state since the last look."""
        node = self._controller
        level = 3 if node.is_off else 2 if node.state is State.PASSIVE else 1 if node.warns else 0
        before, self._level = self._level, level
        if level == before:
            return
        tec, rec = node.tec, node.rec
        if level == 3:
            self._frames.append(make_error_frame(BUSOFF | CNT, 0, 0, 0, tec, rec))
        elif before == 3:
            self._frames.append(make_error_frame(RESTARTED | CRTL | CNT, AGAIN_ACTIVE))
        elif level == 2:
            word = (TX_PASSIVE if tec >= 128 else 0) | (RX_PASSIVE if rec >= 128 else 0)
            self._frames.append(make_error_frame(CRTL | CNT, word, 0, 0, tec, rec))
        elif level == 1:
            word = (TX_WARNING if tec >= 96 else 0) | (RX_WARNING if rec >= 96 else 0)
            self._frames.append(make_error_frame(CRTL | CNT, word, 0, 0, tec, rec))
        else:
            self._frames.append(make_error_frame(CRTL | CNT, AGAIN_ACTIVE, 0, 0, tec, rec))

    def take(self) -> bytes:
        """Return what there is to report, no longer kept."""
        frames = self._error + b"".join(self._frames)
        self._error, self._frames = b"", []
        self.reported += len(frames) // FRAME.size
        return frames
