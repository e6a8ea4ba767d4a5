"""What the wheels make of their command frames: too old ones are ignored, a silence ends in zero torque."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from bus.units import Vec4

ZERO: Vec4 = (0.0, 0.0, 0.0, 0.0)


class CommandInbox:
    """Torque commands of the four wheels, from the frame's arrival to the motor."""

    __slots__ = ("_delay", "_max_age", "_missed", "_timeout", "held", "ignored", "timed_out")

    def __init__(self, timeout_ticks: int, max_age_ticks: int, latency_ticks: int) -> None:
        self._timeout = timeout_ticks
        self._max_age = max_age_ticks
        self._delay: deque[Vec4] = deque([ZERO] * latency_ticks)
        self._missed = [timeout_ticks] * 4  # nothing has come yet
        self.held: Vec4 = ZERO
        self.timed_out = (True, True, True, True)
        self.ignored = 0  # commands that came too late, all wheels

    def receive(self, commands_nm: Sequence[float | None], age_ticks: Sequence[int]) -> Vec4:
        """Return the torque command in effect over the tick that starts now [N m], per wheel.

        commands_nm : what arrived for this tick, None where nothing did, shape (4,)
        age_ticks   : how many ticks ago each was computed, shape (4,)

        A command older than the limit counts as none. Without one the last is held, until the wheel has been without
        for `timeout_ticks` in a row: then zero. Latency delays what results.
        """
        a, b, c, d = commands_nm
        if a is not None and b is not None and c is not None and d is not None and max(age_ticks) <= self._max_age:
            self.held = (a, b, c, d)
            self._missed = [0, 0, 0, 0]
            self.timed_out = (False, False, False, False)
        else:
            self._sort_out(commands_nm, age_ticks)
        if self._delay:
            self._delay.append(self.held)
            return self._delay.popleft()
        return self.held

    def _sort_out(self, commands_nm: Sequence[float | None], age_ticks: Sequence[int]) -> None:
        held = list(self.held)
        for i, (command, age) in enumerate(zip(commands_nm, age_ticks, strict=True)):
            if command is not None and age <= self._max_age:
                held[i] = command
                self._missed[i] = 0
                continue
            if command is not None:
                self.ignored += 1
            self._missed[i] += 1
            if self._missed[i] >= self._timeout:
                held[i] = 0.0
        self.held = (held[0], held[1], held[2], held[3])
        late = [missed >= self._timeout for missed in self._missed]
        self.timed_out = (late[0], late[1], late[2], late[3])
