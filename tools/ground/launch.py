"""Starts the gateway beside a run, and ends it with it. Its death is told and ends nothing."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bus.errors import UsageError
from tools.ground.counters import describe_counters
from tools.ground.key import read_key
from tools.ground.links import LinkAddress, parse_link
from tools.run.children import Process, start, stop
from tools.run.run_file import RunFile

NICE = 5  # so that a flood from the ground does not take the time of the bench


@dataclass(frozen=True, slots=True)
class GatewayPlan:
    """The links to ground stations, with their sockets open, and the file of the key that signs what goes over them."""

    links: tuple[tuple[LinkAddress, socket.socket], ...]
    key: Path | None

    def start(self, private: Path, bench: RunFile) -> Process:
        """Start the gateway of a bench; it inherits the sockets."""
        words = ["--dir", str(private)]
        for side, path in (("--plant", bench.plant), ("--fsw", bench.fsw)):
            words += [side, path] if path is not None else []
        for address, opened in self.links:
            words += ["--link", f"{address}={opened.fileno()}"]
        if self.key is not None:
            words += ["--key", str(self.key.absolute())]
        fds = [opened.fileno() for _, opened in self.links]
        process = start("gateway", "tools.ground.gateway", words, fds, private / "gateway.err")
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process.popen.pid, NICE)
        return process


@contextlib.contextmanager
def plan_gateway(addresses: Sequence[str], key: Path | None) -> Iterator[GatewayPlan | None]:
    """Yield the plan for these addresses, None for none of them. Raises UsageError for what cannot be used."""
    if not addresses:
        if key is not None:
            raise UsageError("--mavlink-key signs a link; name one with --mavlink, such as --mavlink udp:14550")
        yield None
        return
    if key is not None:
        read_key(key)
    with contextlib.ExitStack() as stack:
        wanted = dict.fromkeys(parse_link(text) for text in addresses)
        yield GatewayPlan(tuple((address, stack.enter_context(address.open())) for address in wanted), key)


def end_gateway(process: Process) -> list[str]:
    """End the gateway; return what there is to say: that it had ended before, and what it refused."""
    notes = []
    if process.code is not None:
        words = process.words()
        notes.append(
            f"{process.fate()} before the run was over; the run went on without it" + f": {words}" * bool(words)
        )
    stop([process])
    return notes + describe_counters(process.stderr_path.parent)
