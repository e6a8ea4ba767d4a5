"""Meeting the flight software: no tick is counted before it has said that it is ready, for this very run."""

from __future__ import annotations

import time

from bus.errors import PeerLostError, UsageError
from bus.wire.transport import Transport
from plant_server.channel import STATE_OPERATIONAL, STATE_PRE_OPERATIONAL, PlantServer


def meet_fsw(transport: Transport, server: PlantServer, run_hash: int, patience_s: float) -> None:
    """Return once the flight software has been heard, answered, and has confirmed.

    Raises PeerLostError when it does not come within patience_s, UsageError when it runs another scenario.
    """
    until = time.monotonic() + patience_s
    answered = False
    while (left_s := until - time.monotonic()) > 0:
        server.accept(transport.recv(left_s))
        if server.fsw_state < 0:
            continue
        if server.fsw_run_hash != run_hash:
            raise UsageError(
                f"the flight software on {transport.address} runs another scenario (run hash "
                f"{server.fsw_run_hash:#010x}, ours is {run_hash:#010x}); start both sides from the same file and seed"
            )
        if answered and server.fsw_state == STATE_OPERATIONAL:
            server.begin()
            return
        transport.send(server.heartbeat(STATE_PRE_OPERATIONAL))
        answered = True
        server.fsw_state = -1
    raise PeerLostError(
        f"no flight software answered on {transport.address} within {patience_s:g} s; start `hilsat fsw` with the same "
        "scenario and bus"
    )
