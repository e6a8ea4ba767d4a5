"""The true pointing error: the plant knows where the body points, the flight software where it should, the log both.

The plant leaves room for `error_deg` in /truth/attitude. It is filled in as a chunk is written: the angle between the
attitude of each tick and the target that the flight software logged for that tick, or last before it. NaN before any.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.units import DEG
from tools.log.message_index import DATA_AT, Pairs
from tools.log.topics import parse_layout

TRUTH, FLIGHT = "/truth/attitude", "/fsw/attitude"
FOUR: Final = 8 * np.arange(4)  # where four numbers in a row begin
BODY_AT: Final = DATA_AT + 4  # of a record: behind its head and the CDR encapsulation


class PointingError:
    """Fills one field of the truth from a field of the flight software's telemetry."""

    def __init__(self) -> None:
        self._truth: tuple[int, int, int] | None = None  # channel, place of q_ib and of error_deg in a record
        self._flight: tuple[int, int] | None = None  # channel, place of q_it
        self._target = np.empty((0, 4))  # the last one so far

    def learn(self, channel: int, topic: str, schema: str) -> None:
        """Note the layout of a channel, if it is one of the two."""
        if topic not in (TRUTH, FLIGHT):
            return
        places = _locate_fields(schema, topic)
        if topic == TRUTH and {"q_ib", "error_deg"} <= places.keys():
            self._truth = (channel, BODY_AT + places["q_ib"], BODY_AT + places["error_deg"])
        elif topic == FLIGHT and "q_it" in places:
            self._flight = (channel, BODY_AT + places["q_it"])

    def fill(self, pairs: dict[int, Pairs], data: bytes) -> bytes:
        """The chunk with every pointing error in it. pairs: log time and place of the messages of each channel."""
        if self._truth is None or self._flight is None or self._truth[0] not in pairs:
            return data
        channel, q_at, error_at = self._truth
        times, places = pairs[channel].T.astype(np.int64)
        attitudes = _gather(data, places + q_at)
        targets, which = self._find_targets(pairs, data, times)
        errors = np.full(len(places), np.nan)
        known = which >= 0
        errors[known] = angles_between(targets[which[known]], attitudes[known]) / DEG
        self._target = targets[-1:].copy()
        filled = bytearray(data)
        _view_doubles(filled)[places + error_at] = errors
        return bytes(filled)

    def _find_targets(
        self, pairs: dict[int, Pairs], data: bytes, times: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Targets, the last one of before first, and which of them holds at each time (-1: none)."""
        assert self._flight is not None
        channel, q_at = self._flight
        before = len(self._target)
        if channel not in pairs:
            return self._target, np.full(len(times), before - 1)
        since, places = pairs[channel].T.astype(np.int64)
        which = np.searchsorted(since, times, side="right") - 1 + before
        return np.concatenate((self._target, _gather(data, places + q_at))), which


def angles_between(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """`bus.attitude.angle_between` for many pairs, shapes (n, 4): the same bits [rad].

    numpy multiplies, adds and takes roots as Python does; its arc tangents differ from one processor to the next.
    """
    (p0, p1, p2, p3), (q0, q1, q2, q3) = p.T, q.T
    x = p0 * q1 - p1 * q0 - p2 * q3 + p3 * q2
    y = p0 * q2 + p1 * q3 - p2 * q0 - p3 * q1
    z = p0 * q3 - p1 * q2 + p2 * q1 - p3 * q0
    sines, cosines = np.sqrt(x * x + y * y + z * z), np.abs(p0 * q0 + p1 * q1 + p2 * q2 + p3 * q3)
    return 2.0 * np.array(list(map(math.atan2, sines.tolist(), cosines.tolist())))


@lru_cache(maxsize=8)  # numpy parses its formats slowly, and every run of a process has the same two
def _locate_fields(schema: str, topic: str) -> Mapping[str, int]:
    """Where each field of a layout begins."""
    fields: Any = parse_layout(schema, topic).fields or {}
    return {name: field[1] for name, field in fields.items()}


def _gather(data: bytes, places: NDArray[np.int64]) -> NDArray[np.float64]:
    """Four numbers from each place, shape (n, 4)."""
    found: NDArray[np.float64] = _view_doubles(data)[places[:, None] + FOUR]
    return found


def _view_doubles(data: bytes | bytearray) -> NDArray[np.float64]:
    """The eight bytes from every byte of `data` on as a number each: an overlapping view, nothing is copied."""
    return np.ndarray(len(data) - 7, "<f8", data, 0, (1,))
