"""The vehicle's end of the link: polled by the node, before a cycle for what has come, after it for what is to be said.

The cycle knows nothing of it: what the ground says becomes a command in the node's queue, and whatever it hears is read off
the flight and off the words of the log. A ground that is slow, absent, or sends whatever it likes costs a tick a bounded
time (bus/mavlink/component.py).
"""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path
from typing import Final

from bus.clock import MonotonicClock
from bus.mavlink import words
from bus.mavlink.component import LOOK_NS, Component, Identity, Traffic
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.parameters import Parameters
from bus.run import GroundConfig
from fsw.ground.can_forward import CanForward
from fsw.ground.downlink import Downlink
from fsw.ground.numbers import list_parameters
from fsw.ground.uplink import Uplink
from fsw.node import FswNode

WORDS_KEPT: Final = 64  # words that wait to be said; the oldest is left out for another
WORDS_AT_ONCE: Final = 8
SEVERITIES: Final = {
    "debug": 7, "info": words.INFO, "warning": words.WARNING, "error": words.ERROR, "fatal": words.CRITICAL,
}  # fmt: skip
CAPABILITIES: Final = (
    words.CAN_FLOAT_PARAMETERS
    | words.CAN_COMMAND_INT
    | words.CAN_SET_ATTITUDE_TARGET
    | words.CAN_MAVLINK2
    | words.CAN_PARAM_ENCODE_C_CAST
)


def open_ground(node: FswNode, config: GroundConfig, clock: MonotonicClock) -> FswGround:
    """Give a node its link to the ground. Raises UsageError where the socket cannot be made."""
    ground = FswGround(node, config, clock)
    node.ground = ground
    return ground


class FswGround:
    """One vehicle on its socket."""

    def __init__(self, node: FswNode, config: GroundConfig, clock: MonotonicClock) -> None:
        """Make the socket. Raises UsageError where that cannot be."""
        self._node = node
        self._clock = clock
        self._look_ns = 0  # when to look again for what has come
        self._said: deque[tuple[int, str]] = deque(maxlen=WORDS_KEPT)
        self.downlink = downlink = Downlink(node)
        self.uplink = uplink = Uplink(node, clock)
        endpoint = Endpoint(Path(os.fspath(config.socket)), words.SYSTEM_ID, words.FSW_COMPONENT)
        self.forward = CanForward(endpoint, clock, self._hear)
        traffic = Traffic(
            commands=uplink.commands | self.forward.commands,
            messages=dict(downlink.messages),
            rates_hz=dict(downlink.rates_hz),
            others=uplink.others | self.forward.others,
        )
        self.component = Component(
            endpoint,
            Identity(words.FSW_COMPONENT, words.TYPE_SPACECRAFT, words.AUTOPILOT_GENERIC, CAPABILITIES),
            clock,
            downlink.find_status,
            Parameters(list_parameters(node, uplink)),
            traffic,
            uplink.answer,
        )
        uplink.describe = self._describe
        node.log.link.hear = self._hear

    def poll(self, tick: int) -> None:
        """Before the cycle of a tick: take what has come. Commands are for this tick.

        A bench that flies many ticks in a millisecond does not look on each of them: a look costs as much as a sixth of its
        tick.
        """
        now_ns = self._clock.now_ns()
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + LOOK_NS
            self.uplink.tick = tick
            self.component.receive()

    def tell(self, frames: bytes, answer: bytes) -> None:
        """After the cycle: say what happened in it and send what is due.

        frames, answer : of the bus, received since the cycle before, and sent
        """
        self.uplink.note_cycle()
        if self._said:
            for _ in range(min(WORDS_AT_ONCE, len(self._said))):
                severity, text = self._said.popleft()
                self.component.say(severity, text)
        if self.forward.on:
            self.forward.send(frames, answer)
        self.component.send()

    def close(self) -> None:
        """Say what is left to say and close the socket. May be repeated."""
        if self._node.ground is self:
            self._node.ground = None
            self._node.log.link.hear = None
            while self._said:
                self.component.say(*self._said.popleft())
            self.component.close()

    def _hear(self, level: str, text: str) -> None:
        """Keep the words of an event until the cycle is over."""
        self._said.append((SEVERITIES.get(level, words.INFO), text))

    def _describe(self) -> dict[str, object]:
        """What there is to know of the link, for a request in JSON."""
        counters = self.component.endpoint.counters
        return {
            "link": {name: getattr(counters, name) for name in counters.__slots__},
            "can_forward": {"on": self.forward.on, "sent": self.forward.sent, "left_out": self.forward.left_out},
            "observer_fields": self.downlink.list_internals(),
        }
