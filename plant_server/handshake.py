"""Meeting the flight software: no tick is counted before it has said that it is ready, for this very run."""

from __future__ import annotations

from bus.clock import MonotonicClock
from bus.errors import PeerLostError, UsageError
from bus.wire.transport import Transport
from plant_server.channel import STATE_OPERATIONAL, STATE_PRE_OPERATIONAL, Channel


def meet_fsw(transport: Transport, channel: Channel, run_hash: int, patience_s: float, clock: MonotonicClock) -> None:
    """Return once the flight software has been heard, answered, and has confirmed.

    Raises PeerLostError when it does not come within patience_s, UsageError when it runs another scenario.
    """
    until_ns = clock.now_ns() + round(patience_s * 1e9)
    answered = False
    while (left_ns := until_ns - clock.now_ns()) > 0:
        channel.accept(transport.recv(left_ns * 1e-9))
        if channel.fsw_state < 0:
            continue
        if channel.fsw_run_hash != run_hash:
            raise UsageError(
                f"the flight software on {transport.address} runs another scenario (run hash "
                f"{channel.fsw_run_hash:#010x}, ours is {run_hash:#010x}); start both sides from the same file and seed"
            )
        if answered and channel.fsw_state == STATE_OPERATIONAL:
            channel.begin()
            return
        transport.send(channel.heartbeat(STATE_PRE_OPERATIONAL))
        answered = True
        channel.fsw_state = -1
    raise PeerLostError(
        f"no flight software answered on {transport.address} within {patience_s:g} s; start `hilsat fsw` with the same "
        "scenario and bus"
    )
