"""Meeting the plant: both sides say who they are and which run they belong to before the first tick.

    fsw    HEARTBEAT boot, every 50 ms, until the plant is heard
    plant  HEARTBEAT pre-operational, once it hears the flight software
    fsw    HEARTBEAT operational, once; from here on the plant counts ticks

Frames of the meeting are not part of the run: their number depends on who came first. A plant of another run on the
same bus is not answered; it is named as the trouble only when no fitting one came.
"""

from __future__ import annotations

import time
from typing import Final

from bus.errors import PeerLostError, UsageError
from bus.icd.heartbeat import BOOT, OPERATIONAL, STOPPED, find_heartbeats
from bus.wire.transport import Transport
from fsw.inputs import HEARTBEAT_PLANT_ID
from fsw.outputs import Outputs

CALL_EVERY_S: Final = 0.05


def plant_stopped(batch: bytes, run_hash: int) -> bool:
    """True when the last heartbeat of the plant in this batch says that it has stopped.

    run_hash : of this run; another bench's plant does not count
    """
    states = [state for state, its in find_heartbeats(batch, HEARTBEAT_PLANT_ID) if its == run_hash]
    return bool(states) and states[-1] == STOPPED


def meet_plant(transport: Transport, outputs: Outputs, run_hash: int, patience_s: float) -> int:
    """Return once the plant has answered and the answer was confirmed: heartbeats of other runs that were ignored.

    Raises PeerLostError when nobody answers within patience_s, UsageError when only plants of other scenarios did.
    """
    until = time.monotonic() + patience_s
    call_s = 0.0
    foreign = []
    while (now_s := time.monotonic()) < until:
        if now_s >= call_s:
            transport.send(outputs.heartbeat(BOOT))
            call_s = now_s + CALL_EVERY_S
        heard = [its for _, its in find_heartbeats(transport.recv(call_s - now_s), HEARTBEAT_PLANT_ID)]
        foreign += [its for its in heard if its != run_hash]
        if run_hash in heard:
            transport.send(outputs.heartbeat(OPERATIONAL))
            outputs.reset()  # the run's own count starts here
            return len(foreign)
    if foreign:
        raise UsageError(
            f"the plant on {transport.address} runs another scenario (run hash {foreign[-1]:#010x}, ours is "
            f"{run_hash:#010x}), and no other answered within {patience_s:g} s; start both sides from the same scenario "
            "file and seed"
        )
    raise PeerLostError(
        f"no plant answered on {transport.address} within {patience_s:g} s; start `hilsat plant` with the same scenario "
        "and bus"
    )
