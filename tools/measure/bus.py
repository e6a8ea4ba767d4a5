"""What a bus costs between two processes: round trip of one frame and one-way throughput, beside a bare socket pair.

Every figure is of two processes on one CPU core: there a wake-up is a context switch, and figures of different buses
can be compared. On two cores of a virtual machine one costs several times more, whatever the bus.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bus.errors import BusError
from bus.wire.address import open_transport
from bus.wire.can_link import find_link, kernel_has_can, list_can_links
from bus.wire.frames import FRAME
from bus.wire.transport import Transport

BENCH_ID, PING_ID, ACK_ID, ASK_ID = 0x7D0, 0x7D1, 0x7D2, 0x7D3
PATIENCE_S = 10.0
ASK_AFTER_S = 0.05
WINDOW = 4096  # frames under way at most: a reader that keeps up never has more waiting
WINDOW_KERNEL = 768  # of the kernel's CAN: net.core.netdev_max_backlog drops beyond 1000, and no socket sees a count
ACK_EVERY = 256
QUEUE_FRAMES = 8192
WARM_UP = 200
ROOT = Path(__file__).resolve().parents[2]


def measure_all(rounds: int = 5000, frames: int = 200_000) -> dict[str, Any]:
    """Return every figure as one flat table: for the pair, the hub, and each CAN interface that is up."""
    pair = measure_round_trip("pair", rounds)
    table: dict[str, Any] = {"pair: round trip, us, p50": pair["p50_us"], "pair: round trip, us, p99": pair["p99_us"]}
    for address in ("hub:", *_can_addresses()):
        name = address.rstrip(":")
        trip = measure_round_trip(address, rounds)
        batched = measure_one_way(address, frames, 32)
        single = measure_one_way(address, frames // 4, 1)
        table |= {
            f"{name}: round trip, us, p50": trip["p50_us"],
            f"{name}: round trip, us, p99": trip["p99_us"],
            f"{name}: round trip / pair, p50": trip["p50_us"] / pair["p50_us"],
            f"{name}: frames/s one way, by 32": batched["frames_per_s"],
            f"{name}: frames/s one way, by 1": single["frames_per_s"],
            f"{name}: frames lost": batched["lost"] + single["lost"],
        }
    if not kernel_has_can():
        table["socketcan"] = "this kernel has no CAN; try: hilsat vcan exec -- hilsat bench --only bus"
    return table


def measure_round_trip(address: str, rounds: int = 5000) -> dict[str, Any]:
    """Return p50, p99 and mean of one frame there and one back [us]. `address` "pair": a bare AF_UNIX socket pair.

    "hub:" takes a directory of its own.
    """
    ping = FRAME.pack(PING_ID, 8, bytes(8))
    with _one_core(), _echo(address) as (send, recv):
        times_ns = []
        for _ in range(WARM_UP + rounds):
            started = time.perf_counter_ns()
            send(ping)
            if not recv():
                raise BusError(f"{address}: no answer within {PATIENCE_S:g} s while measuring the round trip")
            times_ns.append(time.perf_counter_ns() - started)
    times_us = sorted(t / 1e3 for t in times_ns[WARM_UP:])
    return {
        "address": address,
        "rounds": rounds,
        "p50_us": times_us[rounds // 2],
        "p99_us": times_us[rounds * 99 // 100],
        "mean_us": sum(times_us) / rounds,
    }


def measure_one_way(address: str, frames: int = 200_000, batch_frames: int = 32) -> dict[str, Any]:
    """Return throughput [frames/s] and frames lost, from the first frame sent to the last one read elsewhere.

    The reader acknowledges every so many frames; the sender has at most WINDOW of them under way.
    """
    frames -= frames % batch_frames
    with _one_core(), _own_address(address) as where, contextlib.ExitStack() as stack:
        transport = open_transport(where, node="bench", host=True, queue_frames=QUEUE_FRAMES)
        stack.callback(transport.close)
        _start_child(stack, "read", where)
        _await_child(transport)
        started = time.perf_counter()
        read, lost = _stream(transport, frames, batch_frames)
        elapsed_s = time.perf_counter() - started
    return {
        "address": address,
        "frames": frames,
        "batch_frames": batch_frames,
        "frames_per_s": frames / elapsed_s,
        "lost": frames - read,
        "dropped_by_bus": lost,
        "not_taken": transport.counters.tx_failed,
    }


def _stream(transport: Transport, frames: int, batch_frames: int) -> tuple[int, int]:
    """Send all frames within the window; return how many the reader got and how many it was told were dropped."""
    account = (0, 0)
    sent = 0
    window = WINDOW_KERNEL if transport.address.startswith("socketcan:") else WINDOW
    while sent < frames:
        transport.send(b"".join(FRAME.pack(BENCH_ID, 8, (sent + k).to_bytes(8, "little")) for k in range(batch_frames)))
        sent += batch_frames
        if sent - sum(account) >= window:
            account = _await_account(transport, account, sent - window + 1)
    return _await_account(transport, account, frames)


def _await_account(transport: Transport, account: tuple[int, int], wanted: int) -> tuple[int, int]:
    """Return (read, dropped) once they add up to `wanted`. A reader that is silent is asked."""
    deadline = time.monotonic() + PATIENCE_S
    while sum(account) < wanted:
        if time.monotonic() >= deadline:
            raise BusError(
                f"{transport.address}: {wanted - sum(account)} frames unaccounted for after {PATIENCE_S:g} s"
            )
        batch = transport.recv(ASK_AFTER_S)
        if not batch:
            transport.send(FRAME.pack(ASK_ID, 8, bytes(8)))
        for can_id, _, data in FRAME.iter_unpack(batch):
            if can_id == ACK_ID:
                account = (int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little"))
    return account


# -- the other process ----------------------------------------------------------------------------------------------


def _read_frames(transport: Transport) -> None:
    """Read and acknowledge, every so many frames and when asked; the test frames must come in their order."""
    read = acked = 0
    transport.send(FRAME.pack(ACK_ID, 8, bytes(8)))
    while batch := transport.recv(PATIENCE_S):
        asked = False
        for can_id, _, data in FRAME.iter_unpack(batch):
            if can_id == BENCH_ID:
                if int.from_bytes(data, "little") < read:
                    raise BusError(f"{transport.address}: frame {data.hex()} came out of order")
                read += 1
            elif can_id == ASK_ID:
                asked = True
        if asked or read - acked >= ACK_EVERY:
            acked = read
            dropped = transport.counters.dropped
            transport.send(FRAME.pack(ACK_ID, 8, read.to_bytes(4, "little") + dropped.to_bytes(4, "little")))


def _echo_frames(transport: Transport) -> None:
    transport.send(FRAME.pack(ACK_ID, 8, bytes(8)))
    while batch := transport.recv(PATIENCE_S):
        transport.send(batch)


def _echo_pair(fd: int) -> None:
    end = socket.socket(fileno=fd)
    while datagram := end.recv(65536):
        end.send(datagram)


def main(arguments: list[str]) -> int:
    """The second process of a measurement: `read ADDRESS`, `echo ADDRESS` or `pair FD`."""
    role, where = arguments
    if role == "pair":
        _echo_pair(int(where))
        return 0
    transport = open_transport(where, node="bench-peer", queue_frames=QUEUE_FRAMES)
    with contextlib.closing(transport), contextlib.suppress(BusError):
        (_read_frames if role == "read" else _echo_frames)(transport)
    return 0


def _start_child(
    stack: contextlib.ExitStack, role: str, where: str, fds: tuple[int, ...] = ()
) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-P", "-m", "tools.measure.bus", role, where]
    child = subprocess.Popen(command, env=environment, pass_fds=fds, stdin=subprocess.DEVNULL, stdout=sys.stderr)
    stack.callback(child.wait)
    stack.callback(child.kill)
    return child


def _await_child(transport: Transport) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not transport.recv(PATIENCE_S):
        if time.monotonic() >= deadline:
            raise BusError(f"{transport.address}: the second process did not start within {PATIENCE_S:g} s")


@contextlib.contextmanager
def _echo(address: str) -> Iterator[tuple[Any, Any]]:
    """Give (send, recv) towards a second process that sends everything back."""
    with contextlib.ExitStack() as stack:
        if address == "pair":
            near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with far:
                _start_child(stack, "pair", str(far.fileno()), (far.fileno(),))
            stack.callback(near.close)
            yield near.send, lambda: near.recv(65536)
            return
        where = stack.enter_context(_own_address(address))
        transport = open_transport(where, node="bench", host=True, queue_frames=QUEUE_FRAMES)
        stack.callback(transport.close)
        _start_child(stack, "echo", where)
        _await_child(transport)
        yield transport.send, lambda: transport.recv(PATIENCE_S)


@contextlib.contextmanager
def _own_address(address: str) -> Iterator[str]:
    if address != "hub:":
        yield address
        return
    with tempfile.TemporaryDirectory(prefix="hilsat-bench-") as directory:
        yield f"hub:{directory}/bus"


@contextlib.contextmanager
def _one_core() -> Iterator[None]:
    """Keep this process and its children on one core for as long as it lasts."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _can_addresses() -> list[str]:
    if not kernel_has_can():
        return []
    links = [find_link(name) for name in list_can_links()]
    return [f"socketcan:{link.name}" for link in links if link is not None and link.is_up and link.bitrate_bps is None]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
