"""The gateway between a bench's sockets and ground stations: who gets what, who is believed, and what a flood does.

The sides are stand-ins on real sockets, the oracle for MAVLink and its signatures is pymavlink.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from bus.errors import UsageError
from bus.mavlink import words
from bus.mavlink.dialect import (
    MAVLink,
    MAVLink_command_ack_message,
    MAVLink_command_int_message,
    MAVLink_command_long_message,
    MAVLink_heartbeat_message,
    MAVLink_param_request_list_message,
    MAVLink_statustext_message,
    MAVLink_timesync_message,
    mavlink_map,
)
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.packets import LinkCounters, Message, Packets
from tools.ground.counters import describe_counters
from tools.ground.gateway import Gateway
from tools.ground.ground_link import BURST, RATE_HZ, GroundLink
from tools.ground.key import make_key, read_key
from tools.ground.launch import plan_gateway
from tools.ground.links import parse_link
from tools.ground.rewriting import crc_extra_of, put_checksum, readdress, renumber
from tools.ground.router import Router
from tools.ground.side_link import SideLink
from tools.ground.signing import BEHIND, Signing

KEY = hashlib.sha256(b"a passphrase").digest()
GROUND = (words.GROUND_SYSTEM_ID, words.GROUND_COMPONENT)
NOW = 36_000_000_000_000  # a time of signatures [10 us]


def packet_of(message: Message, system: int = GROUND[0], component: int = GROUND[1], sequence: int = 0) -> bytes:
    """The packet that the generated code makes."""
    protocol = MAVLink(None, system, component)
    protocol.seq = sequence
    return bytes(message.pack(protocol))


def read_one(packet: bytes) -> Message:
    counters = LinkCounters()
    (message,) = Packets(0, 0, counters).read(packet)
    assert counters.received == 1
    return message


def command(number: int, component: int, system: int = 1) -> Message:
    return MAVLink_command_long_message(system, component, number, 0, 101.0, 1.0, 2.0, float("nan"), 0.0, 0.0, 0.0)


def heartbeat() -> Message:
    return MAVLink_heartbeat_message(words.TYPE_GROUND, words.AUTOPILOT_INVALID, 0, 0, words.STATE_ACTIVE, 3)


# -- addresses and keys ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["udp:14550", "udpin:14550", "udp:127.0.0.1:14550", "udpin:localhost:1"])
def test_addresses(text: str) -> None:
    """Two ways, a port, and this machine."""
    address = parse_link(text)
    assert (address.way, address.port) == (text.split(":")[0], int(text.split(":")[-1]))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("tcp:5760", "no MAVLink address"),
        ("udpinn:5", "did you mean udpin"),
        ("udp:0.0.0.0:14550", "another machine"),
        ("udp:192.168.1.2:14550", "another machine"),
        ("udp:", "no port"),
        ("udp:0", "no port"),
        ("udp:65536", "no port"),
        ("udp:-1", "no port"),
        ("udp:99999999999999", "no port"),
        ("udp:١٤", "no port"),
        ("14550", "no MAVLink address"),
    ],
)
def test_addresses_that_are_none(text: str, what: str) -> None:
    """Each said with what to write; nothing but 127.0.0.1 is ever taken."""
    with pytest.raises(UsageError, match=what):
        parse_link(text)


def test_sockets_are_on_this_machine_alone_and_a_taken_port_is_said() -> None:
    """Both ways bind 127.0.0.1; two benches on one port: the second is refused before anything starts."""
    with plan_gateway(["udpin:0".replace("0", str(free_port())), "udp:14550"], None) as plan:
        assert plan is not None
        assert [opened.getsockname()[0] for _, opened in plan.links] == ["127.0.0.1", "127.0.0.1"]
        taken = str(plan.links[0][0])
        with pytest.raises(UsageError, match="name another port"), plan_gateway([taken], None):
            pass
    with pytest.raises(UsageError, match="--mavlink-key signs a link"), plan_gateway([], Path("key")):
        pass


def test_keys() -> None:
    """32 bytes are a key as they are; text is hashed as MAVProxy hashes a passphrase, without the line's end."""
    raw = bytes(range(200, 232))
    assert make_key(raw, "f") == raw
    assert make_key(b"a passphrase\n", "f") == make_key(b"a passphrase", "f") == KEY
    text = b"31 characters and a line's end.\n"
    assert len(text) == 32
    assert make_key(text, "f") == hashlib.sha256(text[:-1]).digest()
    for bad in (b"", b"\n", b"\xff" * 31, b"two\nlines", b"x" * 5000):
        with pytest.raises(UsageError, match="no key"):
            make_key(bad, "f")


def test_a_key_that_others_can_read_is_refused(tmp_path: Path) -> None:
    """With the command that mends it; what is no file, too."""
    file = tmp_path / "key"
    file.write_bytes(b"a passphrase\n")
    file.chmod(0o640)
    with pytest.raises(UsageError, match="chmod 0600"):
        read_key(file)
    file.chmod(0o600)
    assert read_key(file) == KEY
    for path, what in (
        (tmp_path, "not a file|cannot read"),
        (tmp_path / "none", "cannot read"),
        (Path("/dev/null"), "file"),
    ):
        with pytest.raises(UsageError, match=what):
            read_key(path)


# -- signing -----------------------------------------------------------------------------------------------------------


def make_oracle(key: bytes = KEY) -> Any:
    """pymavlink's own protocol object, signing."""
    oracle = common.MAVLink(None, 255, 190)
    oracle.signing.secret_key = key
    oracle.signing.sign_outgoing = True
    oracle.signing.timestamp = NOW
    oracle.signing.link_id = 3
    return oracle


def test_what_pymavlink_signs_is_accepted_and_the_other_way_round() -> None:
    """The signature of each is right for the other."""
    theirs = make_oracle()
    ours = Signing(KEY, link_id=3, now=lambda: NOW)
    signed = theirs.heartbeat_encode(6, 8, 0, 0, 4).pack(theirs)
    assert ours.accept(bytes(signed))
    back = make_oracle()
    for _ in range(3):
        packet = ours.sign(packet_of(heartbeat()), crc_extra_of(heartbeat()))
        message = back.parse_char(packet)
        assert message.get_type() == "HEARTBEAT"
        assert message.get_signed()
    assert back.signing.badsig_count == 0
    with pytest.raises(common.MAVError):
        make_oracle(b"x" * 32).parse_char(packet)


def test_a_packet_is_signed_byte_for_byte_as_pymavlink_does() -> None:
    """Same time, same link id, same bytes."""
    theirs, ours = make_oracle(), Signing(KEY, link_id=3, now=lambda: NOW)
    theirs.seq = 0
    signed = theirs.heartbeat_encode(6, 8, 0, 0, 4).pack(theirs)
    own = ours.sign(packet_of(heartbeat()), crc_extra_of(heartbeat()))
    assert own[:-12] == bytes(signed)[:-12]  # up to the time
    same = Signing(KEY, link_id=3, now=lambda: int.from_bytes(bytes(signed)[-12:-6], "little"))
    assert same.sign(packet_of(heartbeat()), crc_extra_of(heartbeat())) == bytes(signed)


def sign_at(time_10us: int, key: bytes = KEY, component: int = 190) -> bytes:
    signing = Signing(key, now=lambda: time_10us)
    return signing.sign(packet_of(heartbeat(), component=component), crc_extra_of(heartbeat()))


def test_replayed_old_and_forged_packets_are_refused() -> None:
    """Times go up in each stream; a new stream is at most a minute late; one bit is enough to be refused."""
    ours = Signing(KEY, now=lambda: NOW)
    first, second = sign_at(NOW), sign_at(NOW + 1)
    assert not ours.accept(packet_of(heartbeat()))  # unsigned
    assert not ours.accept(first[:-1] + bytes([first[-1] ^ 1]))
    assert not ours.accept(sign_at(NOW, b"y" * 32))
    assert ours.accept(first)
    assert not ours.accept(first)
    assert ours.accept(second)
    assert not ours.accept(first)
    assert ours.accept(sign_at(NOW - BEHIND + 1, component=191))
    assert not ours.accept(sign_at(NOW - BEHIND - 1, component=192))
    for at in range(len(second)):
        broken = bytearray(sign_at(NOW + 10))
        broken[at] ^= 4
        assert not ours.accept(bytes(broken)), at
    assert ours.accept(sign_at(NOW + 2))


def test_a_forged_packet_changes_nothing() -> None:
    """One from the far future with a wrong signature must not shut the stream out, as it does with the generated code."""
    ours, theirs = Signing(KEY, now=lambda: NOW), make_oracle()
    forged = sign_at(NOW + 10**9, b"z" * 32)
    honest = sign_at(NOW + 1)
    assert not ours.accept(forged)
    assert ours.accept(honest)
    with pytest.raises(common.MAVError):
        theirs.decode(bytearray(forged))
    with pytest.raises(common.MAVError):
        theirs.decode(bytearray(honest))


def test_times_sent_never_repeat() -> None:
    """Also when the wall clock stands still or goes back."""
    times = iter([NOW, NOW, NOW - 500, NOW + 3])
    ours = Signing(KEY, now=lambda: next(times))
    packets = [ours.sign(packet_of(heartbeat()), crc_extra_of(heartbeat())) for _ in range(4)]
    sent = [int.from_bytes(packet[-12:-6], "little") for packet in packets]
    assert sent == [NOW, NOW + 1, NOW + 2, NOW + 3]


# -- rewriting and routing ---------------------------------------------------------------------------------------------


def test_rewritten_packets_are_sound() -> None:
    """Another number and sender, the same content; pymavlink's own dialect reads them. MAVLink 1 becomes MAVLink 2."""
    for version_1 in (False, True):
        protocol = MAVLink(None, 1, 25)
        original = heartbeat()
        source = read_one(bytes(original.pack(protocol, force_mavlink1=version_1)))
        packet = renumber(source, 77, 1)
        reader = common.MAVLink(None)
        message = reader.parse_char(packet)
        assert (message.get_seq(), message.get_srcSystem(), message.get_srcComponent()) == (77, 1, 1)
        assert (packet[0], message.type) == (0xFD, words.TYPE_GROUND)
    moved = read_one(readdress(read_one(packet_of(command(420, 0), sequence=9)), 25))
    assert (moved.target_component, moved.get_seq(), moved.get_srcSystem()) == (25, 9, 255)
    assert moved.param4 != moved.param4  # NaN stays NaN


@given(data=st.data())
def test_any_message_is_routed_and_rewritten(data: st.DataObject) -> None:
    """Every message of the dialect with any content: nothing raises, content stays, checksums are right, signed or not."""
    kind = data.draw(st.sampled_from(sorted(mavlink_map)))
    payload = data.draw(st.binary(min_size=1, max_size=mavlink_map[kind].unpacker.size))
    source = data.draw(st.tuples(st.integers(0, 255), st.integers(0, 255)))
    packet = bytearray([0xFD, len(payload), 0, 0, 5, *source, *kind.to_bytes(3, "little"), *payload, 0, 0])
    put_checksum(packet, mavlink_map[kind].crc_extra)
    found = Packets(0, 0).read(bytes(packet))
    for message in found:  # none where a text is none
        for _, routed in Router().route(message, LinkCounters()):
            assert read_one(routed).get_msgId() == kind
        down = Router().number(message)
        assert down[10:-2] == payload
        again = read_one(Signing(KEY, now=lambda: NOW).sign(down, crc_extra_of(message)))
        assert (again.get_srcSystem(), again.get_msgId()) == (source[0], kind)


@given(st.lists(st.binary(max_size=400), max_size=5))
def test_no_datagram_raises(datagrams: list[bytes]) -> None:
    """Whatever comes, with a key and without one."""
    packets, signing = Packets(0, 0), Signing(KEY, now=lambda: NOW)
    for datagram in datagrams:
        for message in packets.read(datagram):
            Router().route(message, LinkCounters())
        assert not signing.accept(datagram)


@pytest.mark.parametrize(
    ("message", "sides"),
    [
        (command(512, 1), ["fsw"]),
        (command(512, 25), ["plant"]),
        (command(512, 0), ["fsw", "plant"]),
        (command(512, 0, system=0), ["fsw", "plant"]),
        (command(512, 0, system=2), []),
        (command(512, 100), []),
        (command(420, 0), ["plant"]),
        (command(420, 1), ["plant"]),
        (command(420, 25), ["plant"]),
        (command(420, 100), []),
        (MAVLink_command_int_message(1, 1, 0, 420, 0, 0, 101.0, 1.0, 2.0, 0.0, 0, 0, 0.0), ["plant"]),
        (MAVLink_param_request_list_message(1, 1), ["fsw"]),
        (MAVLink_param_request_list_message(1, 0), ["fsw", "plant"]),
        (MAVLink_timesync_message(0, 5), ["fsw", "plant"]),
        (heartbeat(), ["fsw", "plant"]),
    ],
)
def test_routes(message: Message, sides: list[str]) -> None:
    """By the target; no target is both; INJECT_FAILURE is the plant's, and says so in its target."""
    counters = LinkCounters()
    routed = Router().route(read_one(packet_of(message)), counters)
    assert [side for side, _ in routed] == sides
    assert counters.foreign == (0 if sides else 1)
    for side, packet in routed:
        target = getattr(read_one(packet), "target_component", 0)
        assert target in (0, {"fsw": 1, "plant": 25}[side])
        if getattr(message, "command", 0) == 420:
            assert target == 25


def test_who_pretends_to_be_us_is_not_heard() -> None:
    """An echo of our own packets, or somebody in the satellite's name."""
    counters = LinkCounters()
    assert Router().route(read_one(packet_of(heartbeat(), system=1, component=25)), counters) == []
    assert counters.foreign == 1


def ack(result: int, to: tuple[int, int] = GROUND, number: int = 420) -> Message:
    return read_one(packet_of(MAVLink_command_ack_message(number, result, 0, 0, *to), 1, 25))


def test_the_answer_comes_from_who_was_asked() -> None:
    """INJECT_FAILURE asked of the vehicle (component 0 or 1) is answered by component 1, asked of the plant by 25.

    IN_PROGRESS is not the last word. Answers to other commands, and to others, stay as they are.
    """
    router, counters = Router(), LinkCounters()

    def come(message: Message) -> int:
        return read_one(router.number(message)).get_srcComponent()

    assert come(ack(0)) == 25
    router.route(read_one(packet_of(command(420, 1))), counters)
    assert come(ack(0, number=512)) == 25
    assert come(ack(0, to=(254, 190))) == 25
    assert come(ack(words.IN_PROGRESS)) == 1
    assert come(ack(words.ACCEPTED)) == 1
    assert come(ack(words.ACCEPTED)) == 25
    for asked, answered in ((0, 1), (25, 25), (1, 1)):
        router.route(read_one(packet_of(command(420, asked))), counters)
        assert come(ack(0)) == answered


def test_an_answer_that_is_too_late_is_nobodys() -> None:
    """What was asked is forgotten after a while."""
    now_s = 0.0
    router = Router(lambda: now_s)
    router.route(read_one(packet_of(command(420, 1))), LinkCounters())
    now_s = 20.0
    assert read_one(router.number(ack(0))).get_srcComponent() == 25


def test_each_component_counts_by_itself() -> None:
    """A dense sequence on the ground's side, whatever the sides' own are, over the wrap of a byte."""
    router = Router()
    seen: dict[int, list[int]] = {1: [], 25: []}
    for i in range(600):
        component = 25 if i % 3 else 1
        source = read_one(packet_of(heartbeat(), 1, component, sequence=(7 * i) % 256))
        seen[component].append(read_one(router.number(source)).get_seq())
    for numbers in seen.values():
        assert numbers == [i % 256 for i in range(len(numbers))]


# -- the gateway at work -----------------------------------------------------------------------------------------------


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Rig:
    """A gateway that turns in a thread between two stand-in sides and a link on which it waits."""

    def __init__(self, place: Path, key: bytes | None = None) -> None:
        self.sides = {
            name: Endpoint(place / f"{name}.sock", words.SYSTEM_ID, number)
            for number, name in ((1, "fsw"), (25, "plant"))
        }
        address = parse_link(f"udpin:{free_port()}")
        self.link = GroundLink(address, address.open())
        links = [SideLink(place, name, str(place / f"{name}.sock")) for name in self.sides]
        signing = None if key is None else Signing(key)
        self.gateway = Gateway([self.link], links, signing)
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.settimeout(3.0)
        self.ground.connect(("127.0.0.1", address.port))
        self.slowest_s = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._ended.is_set():
            self.gateway.turn()
        self.gateway.close()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self.ground.close()
        for side in self.sides.values():
            side.close()

    def await_message(self, side: str, wanted: Callable[[Message], bool], within_s: float = 3.0) -> tuple[Message, str]:
        """The first such message at a side, and who sent it."""
        until_s = time.monotonic() + within_s
        while time.monotonic() < until_s:
            for message, sender in self.sides[side].poll():
                if wanted(message):
                    return message, sender
            time.sleep(0.002)
        raise AssertionError(f"nothing of that kind came to {side}")

    def hear(self, wanted: Callable[[Message], bool]) -> Message:
        """The first such message on the ground."""
        while True:
            message = read_one(self.ground.recv(4096))
            if wanted(message):
                return message


@pytest.fixture
def place() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="hs") as name:
        yield Path(name)


@pytest.fixture
def rig(place: Path) -> Iterator[Rig]:
    rig = Rig(place)
    yield rig
    rig.close()


@pytest.fixture
def signed_rig(place: Path) -> Iterator[Rig]:
    rig = Rig(place, KEY)
    yield rig
    rig.close()


def is_command(number: int) -> Callable[[Message], bool]:
    return lambda message: getattr(message, "command", None) == number


def test_there_and_back(rig: Rig) -> None:
    """INJECT_FAILURE to the vehicle comes to the plant, its answer back to who asked, as from the vehicle."""
    rig.ground.send(packet_of(command(420, 1)))
    message, sender = rig.await_message("plant", is_command(420))
    assert (message.target_component, message.param1, message.param3) == (25, 101.0, 2.0)
    rig.sides["plant"].send(MAVLink_command_ack_message(420, 0, 0, 0, *GROUND), sender)
    answer = rig.hear(is_command(420))
    assert (answer.get_srcSystem(), answer.get_srcComponent(), answer.result) == (1, 1, 0)
    assert not any(is_command(420)(m) for m, _ in rig.sides["fsw"].poll())


def test_the_gateways_own_heartbeat_comes_to_both_sides(rig: Rig) -> None:
    """So that they stream before any ground station has spoken; it is no ground station's."""
    for side in ("plant", "fsw"):
        message, _ = rig.await_message(side, lambda m: m.get_type() == "HEARTBEAT")
        assert (message.get_srcComponent(), message.type) == (words.GATEWAY_COMPONENT, words.TYPE_ONBOARD)


def test_several_ground_stations(rig: Rig) -> None:
    """Each that has spoken hears the sides; one that has not does not."""
    _, sender = rig.await_message("fsw", lambda m: m.get_type() == "HEARTBEAT")
    second = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    second.settimeout(3.0)
    with second:
        second.connect(rig.ground.getpeername())
        for ground in (rig.ground, second):
            ground.send(packet_of(heartbeat()))
            rig.await_message("fsw", lambda m: m.get_srcComponent() == GROUND[1])
        rig.sides["fsw"].send(heartbeat(), sender)
        assert read_one(second.recv(4096)).get_srcComponent() == 1
        assert rig.hear(lambda m: m.get_srcComponent() == 1)


def test_rubbish_harms_nobody(rig: Rig) -> None:
    """Empty datagrams, noise, halves, wrong checksums, messages of other dialects: counted, and the next good one passes."""
    good = packet_of(command(512, 1))
    for bad in (b"", b"\xfd", os.urandom(300), good[:-1], good[:-1] + b"\0", b"\xfd" * 280, b"\xfe" * 9, bytes(65000)):
        rig.ground.send(bad)
    unknown = common.MAVLink_rc_channels_override_message(1, 1, *([1500] * 8)).pack(common.MAVLink(None, 255, 190))
    rig.ground.send(bytes(unknown))
    rig.ground.send(good)
    message, _ = rig.await_message("fsw", is_command(512))
    assert message.param2 == 1.0
    counters = rig.link.counters
    assert counters.garbage >= 5
    assert counters.bad_checksum >= 1
    assert counters.unknown == 1
    assert counters.received == 1


def test_an_unsigned_packet_does_not_pass_a_signed_link(signed_rig: Rig) -> None:
    """Refused and counted, as is a replay; one that pymavlink signs passes, and what comes back pymavlink believes."""
    theirs = make_oracle()
    theirs.signing.timestamp = int((time.time() - 1420070400) * 1e5)
    signed = bytes(theirs.command_long_encode(1, 1, 512, 0, 7, 0, 0, 0, 0, 0, 0).pack(theirs))
    for packet in (packet_of(command(512, 1)), signed[:-1] + bytes([signed[-1] ^ 1]), signed, signed):
        signed_rig.ground.send(packet)
    message, sender = signed_rig.await_message("fsw", is_command(512))
    assert message.param1 == 7.0
    signed_rig.sides["fsw"].send(heartbeat(), sender)
    back = theirs.parse_char(signed_rig.ground.recv(4096))
    assert (back.get_type(), back.get_signed()) == ("HEARTBEAT", True)
    counters = signed_rig.link.counters
    until_s = time.monotonic() + 3.0
    while counters.bad_signature < 3 and time.monotonic() < until_s:  # the replay may still be on its way in
        time.sleep(0.002)
    assert (counters.bad_signature, counters.received) == (3, 1)
    assert not any(is_command(512)(m) for m, _ in signed_rig.sides["fsw"].poll())


def test_mavutil_with_setup_signing(signed_rig: Rig) -> None:
    """The connection that pymavlink programs use, on a signed link, in a process of its own (it keeps global state)."""
    program = (
        "import sys, os; os.environ['MAVLINK20'] = '1'\n"
        "from pymavlink import mavutil\n"
        f"link = mavutil.mavlink_connection('udpout:127.0.0.1:{signed_rig.link.address.port}', dialect='common')\n"
        f"link.setup_signing(bytes.fromhex('{KEY.hex()}'), sign_outgoing=True)\n"
        "link.mav.heartbeat_send(6, 8, 0, 0, 4)\n"
        "link.mav.command_long_send(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)\n"
        "message = link.recv_match(type='COMMAND_ACK', blocking=True, timeout=5)\n"
        "print(message.command, message.result, message.get_signed(), link.mav.signing.badsig_count)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    _, sender = signed_rig.await_message("fsw", is_command(512), 20.0)
    signed_rig.sides["fsw"].send(MAVLink_command_ack_message(512, 0, 0, 0, *GROUND), sender)
    assert child.communicate(timeout=20)[0].split() == ["512", "0", "True", "0"]


@pytest.mark.parametrize("content", ["rubbish", "forged", "valid"])
def test_a_flood_starves_nobody(content: str, place: Path) -> None:
    """10 000 datagrams a second for a second: telemetry goes down meanwhile, and the sides get a bounded number.

    A side that reads nothing blocks nobody: the gateway's thread ends at once afterwards.
    """
    rig = Rig(place, KEY if content == "forged" else None)
    try:
        rig.ground.send(sign_at(int((time.time() - 1420070400) * 1e5)))
        _, sender = rig.await_message("fsw", lambda m: m.get_srcComponent() == GROUND[1])
        datagrams = {
            "rubbish": os.urandom(60),
            "forged": sign_at(NOW, b"q" * 32),
            "valid": packet_of(command(512, 1)),
        }
        flood = datagrams[content]
        begun_s = time.monotonic()
        sent, down = 0, 0
        for slice_number in range(100):
            for _ in range(100):
                rig.ground.send(flood)
                sent += 1
            down += rig.sides["fsw"].send(heartbeat(), sender)
            time.sleep(max(0.0, begun_s + (slice_number + 1) * 0.01 - time.monotonic()))
        took_s = time.monotonic() - begun_s
        heard = 0
        rig.ground.settimeout(0.5)
        while heard < down:
            heard += read_one(rig.ground.recv(4096)).get_type() == "HEARTBEAT"
    finally:
        closing_s = time.monotonic()
        rig.close()
    assert time.monotonic() - closing_s < 2.0
    counters = rig.link.counters
    assert sent == 10_000
    assert heard == down >= 90
    assert counters.garbage + counters.bad_signature + counters.dropped > 1000
    if content == "valid":
        assert counters.received - counters.dropped <= BURST + RATE_HZ * (took_s + 1.0) + 1
    else:
        assert counters.received == 1


def test_the_heartbeat_of_the_plant_goes_behind_that_of_the_vehicle(place: Path) -> None:
    """Whoever listens from now on hears the vehicle first: MAVSDK connects to none that is heard second."""
    rig = Rig(place)
    try:
        rig.ground.send(packet_of(heartbeat()))
        senders = {side: rig.await_message(side, lambda m: m.get_srcComponent() == GROUND[1])[1] for side in rig.sides}
        rig.sides["plant"].send(heartbeat(), senders["plant"])
        rig.sides["plant"].send(MAVLink_statustext_message(6, b"not held", 0, 0), senders["plant"])
        rig.ground.settimeout(1.0)
        assert read_one(rig.ground.recv(4096)).get_type() == "STATUSTEXT"
        rig.sides["fsw"].send(heartbeat(), senders["fsw"])
        heard = [read_one(rig.ground.recv(4096)) for _ in range(2)]
        assert [(m.get_type(), m.get_srcComponent()) for m in heard] == [("HEARTBEAT", 1), ("HEARTBEAT", 25)]
    finally:
        rig.close()


def test_a_side_that_is_not_there_is_no_trouble(place: Path) -> None:
    """Neither when it has not come yet nor when it has gone."""
    rig = Rig(place)
    try:
        rig.sides["plant"].close()
        rig.ground.send(packet_of(command(512, 0)))
        rig.await_message("fsw", is_command(512))
    finally:
        rig.close()


def test_the_process_serves_and_leaves_its_counters(place: Path) -> None:
    """Started as `hilsat run` starts it, ended by SIGTERM; what was refused is told afterwards."""
    port = free_port()
    with plan_gateway([f"udpin:{port}"], None) as plan:
        assert plan is not None
        (_, opened) = plan.links[0]
        side = Endpoint(place / "fsw.sock", 1, 1)
        words_ = ["--dir", str(place), "--fsw", str(place / "fsw.sock"), "--link", f"udpin:{port}={opened.fileno()}"]
        child = subprocess.Popen(
            [sys.executable, "-P", "-m", "tools.ground.gateway", *words_], pass_fds=(opened.fileno(),)
        )
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
                ground.sendto(b"rubbish!rubbish!", ("127.0.0.1", port))
                ground.sendto(packet_of(command(512, 1)), ("127.0.0.1", port))
            until_s = time.monotonic() + 20.0
            found = False
            while not found and time.monotonic() < until_s:
                found = any(is_command(512)(message) for message, _ in side.poll())
                time.sleep(0.01)
            assert found
        finally:
            child.terminate()
            code = child.wait(10)
            side.close()
    assert code == 143
    assert json.loads((place / "gateway.json").read_text())[f"udpin:{port}"]["received"] == 1
    assert describe_counters(place) == [f"gateway, udpin:{port}: refused 1 datagrams that are no MAVLink"]
    assert not list(place.glob("gateway-*.sock"))
