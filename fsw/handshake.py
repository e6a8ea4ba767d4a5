"""Meeting the plant: both sides say who they are and which run they belong to before the first tick.

    fsw    HEARTBEAT boot, every 50 ms, until the plant is heard
    plant  HEARTBEAT pre-operational, once it hears the flight software
    fsw    HEARTBEAT operational, once; from here on the plant counts ticks

Frames of the meeting are not part of the run: their number depends on who came first.
"""

from __future__ import annotations

import time

from bus.errors import PeerLostError, UsageError
from bus.icd.codec import decode_HEARTBEAT_PLANT
from bus.wire.frames import FRAME
from bus.wire.transport import Transport
from fsw.inputs import HEARTBEAT_PLANT_ID
from fsw.outputs import STATE_BOOT, STATE_OPERATIONAL, STATE_STOPPED, Outputs

CALL_EVERY_S = 0.05


def plant_heartbeat(batch: bytes) -> tuple[int, int] | None:
    """State and run hash of the last plant heartbeat in a batch, or None."""
    found = None
    for can_id, length, data in FRAME.iter_unpack(batch):
        if can_id == HEARTBEAT_PLANT_ID and length == 8:
            values = decode_HEARTBEAT_PLANT(data)
            if values is not None:
                found = (int(values[2]), int(values[3]))
    return found


def plant_stopped(batch: bytes, run_hash: int) -> bool:
    """True when the plant says in this batch that it has stopped.

    run_hash : of this run, as heard from the plant; another bench's plant does not count. 0: not heard yet
    """
    heartbeat = plant_heartbeat(batch)
    return heartbeat is not None and heartbeat[0] == STATE_STOPPED and run_hash in (0, heartbeat[1])


def meet_plant(transport: Transport, outputs: Outputs, run_hash: int, patience_s: float) -> None:
    """Return once the plant has answered and the answer was confirmed.

    Raises PeerLostError when nobody answers within patience_s, UsageError when the plant runs another scenario.
    """
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        transport.send(outputs.heartbeat(STATE_BOOT))
        heartbeat = plant_heartbeat(transport.recv(CALL_EVERY_S))
        if heartbeat is None:
            continue
        if heartbeat[1] != run_hash:
            raise UsageError(
                f"the plant on {transport.address} runs another scenario (run hash {heartbeat[1]:#010x}, ours is "
                f"{run_hash:#010x}); start both sides from the same scenario file and seed"
            )
        transport.send(outputs.heartbeat(STATE_OPERATIONAL))
        outputs.reset()  # the run's own count starts here
        return
    raise PeerLostError(
        f"no plant answered on {transport.address} within {patience_s:g} s; start `hilsat plant` with the same scenario "
        "and bus"
    )
