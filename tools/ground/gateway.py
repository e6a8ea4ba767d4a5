"""The gateway: between the private sockets of a bench and ground stations on UDP of this machine. A process of its own.

`hilsat run --mavlink ADDRESS` starts it. It waits for nobody: what a side or a ground station does not take is dropped and
counted, a turn of its loop takes a bounded number of datagrams from each socket, and the sides get a bounded number of
messages a second from each link, whatever comes. Its own heartbeats (system 255, component 240, an onboard controller) tell
the sides where to send their telemetry; the ground stations' are passed on as they are.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import selectors
import socket
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from bus.mavlink.packets import LinkCounters, Message
from bus.process import run_process
from tools.ground.counters import COUNTERS_FILE
from tools.ground.ground_link import GroundLink
from tools.ground.key import read_key
from tools.ground.links import parse_link
from tools.ground.rewriting import crc_extra_of
from tools.ground.router import Router
from tools.ground.side_link import SideLink
from tools.ground.signing import Signing

HEARTBEAT_S: Final = 0.5
BEHIND_S: Final = 2.0  # for which the plant's heartbeat waits for the vehicle's
HEARTBEAT_ID: Final = 0
RETRY_S: Final = 0.005  # after which a side that had no room is tried again


class Gateway:
    """Carries messages between ground links and sides."""

    def __init__(self, links: Sequence[GroundLink], sides: Sequence[SideLink], signing: Signing | None) -> None:
        self.links = links
        self.sides = {side.side: side for side in sides}
        self._signing = signing
        self._router = Router()
        self._heartbeat_s = 0.0
        self._held: Message | None = None  # a heartbeat of the plant
        self._vehicle_s = time.monotonic()  # when the vehicle's was last sent on
        self._selector = selectors.DefaultSelector()
        for link in links:
            self._selector.register(link.socket, selectors.EVENT_READ)
        for side in sides:
            self._selector.register(side, selectors.EVENT_READ)

    def turn(self) -> None:
        """Wait until there is something to do, and do it once."""
        left_s = max(0.0, self._heartbeat_s - time.monotonic())
        waits = any(side.waiting for side in self.sides.values())
        self._selector.select(min(left_s, RETRY_S) if waits else left_s)
        self.carry_down()
        for link in self.links:
            for message in link.receive(self._signing):
                self._carry_up(message, link.counters)
        for side in self.sides.values():
            side.flush()
        now_s = time.monotonic()
        if now_s >= self._heartbeat_s:
            self._heartbeat_s = now_s + HEARTBEAT_S
            for side in self.sides.values():
                side.greet()

    def carry_down(self) -> None:
        """Send what the sides have sent to the ground stations.

        The plant's heartbeat goes out behind the vehicle's: MAVSDK never calls a system connected whose first heartbeat is
        of another component than the autopilot.
        """
        for side in self.sides.values():
            for message in side.receive():
                is_heartbeat = message.get_msgId() == HEARTBEAT_ID
                if is_heartbeat and side.side == "plant" and self._expects_vehicle():
                    self._held = message
                    continue
                self._send_down(message)
                if is_heartbeat and side.side == "fsw":
                    self._vehicle_s = time.monotonic()
                    if self._held is not None:
                        self._send_down(self._held)
                        self._held = None

    def _expects_vehicle(self) -> bool:
        return "fsw" in self.sides and time.monotonic() - self._vehicle_s < BEHIND_S

    def _send_down(self, message: Message) -> None:
        packet = self._router.number(message)
        if self._signing is not None:
            packet = self._signing.sign(packet, crc_extra_of(message))
        for link in self.links:
            link.send(packet)

    def _carry_up(self, message: Message, counters: LinkCounters) -> None:
        for side, packet in self._router.route(message, counters):
            if side in self.sides and not self.sides[side].put(packet):
                counters.dropped += 1

    def close(self) -> None:
        """Close what it opened."""
        self._selector.close()
        for link in self.links:
            link.socket.close()
        for side in self.sides.values():
            side.close()


def main(argv: list[str] | None = None) -> int:
    """Serve until told to end; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.ground.gateway", description="hilsat MAVLink gateway")
    parser.add_argument("--dir", required=True, type=Path, help="private directory of the bench")
    parser.add_argument("--plant", help="the plant's socket")
    parser.add_argument("--fsw", help="the flight software's socket")
    parser.add_argument("--link", action="append", default=[], help="ADDRESS, or ADDRESS=FD for a socket that is open")
    parser.add_argument("--key", type=Path, help="file of the key that signs")
    args = parser.parse_args(argv)
    return run_process("gateway", lambda: _serve(args))


def _serve(args: argparse.Namespace) -> None:
    signing = None if args.key is None else Signing(read_key(args.key))
    paths = {"plant": args.plant, "fsw": args.fsw}
    sides = [SideLink(args.dir, side, path) for side, path in paths.items() if path is not None]
    gateway = Gateway([_open_link(text) for text in args.link], sides, signing)
    try:
        while True:
            gateway.turn()
    finally:
        gateway.carry_down()  # the last words of the sides
        counters = {str(link.address): asdict(link.counters) for link in gateway.links}
        with contextlib.suppress(OSError):
            (args.dir / COUNTERS_FILE).write_text(json.dumps(counters), encoding="utf-8")
        gateway.close()


def _open_link(text: str) -> GroundLink:
    address_text, _, fd = text.partition("=")
    address = parse_link(address_text)
    if not fd:
        return GroundLink(address, address.open())
    opened = socket.socket(fileno=int(fd))
    opened.setblocking(False)
    return GroundLink(address, opened)


if __name__ == "__main__":
    sys.exit(main())
