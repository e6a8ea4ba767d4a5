"""Meeting the flight software: no tick is counted before it has said that it is ready, for this very run.

Flight software of another run on the same bus is not answered; it is named as the trouble only when no fitting one came.
"""

from __future__ import annotations

from typing import Final

from bus.clock import MonotonicClock
from bus.errors import PeerLostError, UsageError
from bus.icd.codec import encode_HEARTBEAT_PLANT
from bus.icd.heartbeat import OPERATIONAL, PRE_OPERATIONAL, find_heartbeats
from bus.wire.transport import Transport
from plant_server.channel import HEARTBEAT_FSW_ID, Channel

MEETING_COUNTER: Final = 14  # ahead of the run's first: an answer that is read late does not disturb its sequence


def meet_fsw(transport: Transport, channel: Channel, run_hash: int, patience_s: float, clock: MonotonicClock) -> int:
    """Return once the flight software has been heard, answered, and has confirmed: foreign heartbeats ignored.

    Raises PeerLostError when it does not come within patience_s, UsageError when only flight software of other
    scenarios did.
    """
    until_ns = clock.now_ns() + round(patience_s * 1e9)
    answer = encode_HEARTBEAT_PLANT(MEETING_COUNTER, 0, PRE_OPERATIONAL, run_hash)
    answered = False
    foreign = []
    while (left_ns := until_ns - clock.now_ns()) > 0:
        heard = list(find_heartbeats(transport.recv(left_ns * 1e-9), HEARTBEAT_FSW_ID))
        foreign += [its for _, its in heard if its != run_hash]
        states = [state for state, its in heard if its == run_hash]
        if answered and OPERATIONAL in states:
            channel.begin()
            return len(foreign)
        if states:
            transport.send(answer)
            answered = True
    if foreign and not answered:
        raise UsageError(
            f"the flight software on {transport.address} runs another scenario (run hash {foreign[-1]:#010x}, ours is "
            f"{run_hash:#010x}), and no other came within {patience_s:g} s; start both sides from the same file and seed"
        )
    raise PeerLostError(
        f"no flight software answered on {transport.address} within {patience_s:g} s; start `hilsat fsw` with the same "
        "scenario and bus"
    )
