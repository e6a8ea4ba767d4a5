"""Whatever a program puts into the hub's socket: the hub goes on, others see only whole frames, and nothing is free."""

from __future__ import annotations

import contextlib
import itertools
import socket
import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.wire.frames import ERR_FLAG, FRAME, FRAME_SIZE, FrameFilter, drop_malformed
from bus.wire.hub.datagrams import MARK, MAX_DATAGRAM, pack_control, read_filters, unpack_control
from bus.wire.hub.host import HubHost

EXAMPLES = settings.default.max_examples
_serial = itertools.count()

frames = st.builds(FRAME.pack, st.integers(0, 0xFFFFFFFF), st.integers(0, 255), st.binary(min_size=8, max_size=8))
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**40), 2**40) | st.floats() | st.text(max_size=8),
    lambda children: st.lists(children, max_size=4) | st.dictionaries(st.text(max_size=8), children, max_size=4),
    max_leaves=8,
)
controls = st.one_of(
    st.builds(lambda value: pack_control(filters=value), json_values),
    st.builds(lambda value: pack_control(hello=value), json_values),
    st.builds(
        lambda node, version, queue, filters: pack_control(
            hello={"node": node, "version": version, "queue_frames": queue, "filters": filters}
        ),
        json_values, json_values, json_values, json_values,
    ),
    st.binary(max_size=100).map(lambda junk: MARK + junk + b" " * ((8 - len(MARK + junk)) % 16)),
)  # fmt: skip
datagrams = st.one_of(
    st.binary(max_size=200),
    st.lists(frames, max_size=20).map(b"".join),
    controls,
    st.integers(MAX_DATAGRAM - 8, MAX_DATAGRAM + 64).map(bytes),
)


@pytest.fixture(scope="module")
def host() -> Iterator[HubHost]:
    with (
        tempfile.TemporaryDirectory() as directory,
        contextlib.closing(HubHost(f"{directory}/bus", "plant", queue_frames=100_000)) as opened,
    ):
        yield opened


def connect(host: HubHost) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.settimeout(10.0)
    sock.connect(host._hub.directory.socket_path)
    return sock


def introduce(host: HubHost, sock: socket.socket) -> str:
    node = f"good-{next(_serial)}"
    sock.send(pack_control(hello={"version": 1, "node": node}))
    while not any(peer.node == node for peer in host.peers()):
        host.serve(0.01)
    return node


@settings(max_examples=EXAMPLES, deadline=None)
@given(junk=st.lists(datagrams, max_size=12), polite=st.booleans())
def test_no_datagram_stops_the_hub_or_reaches_others_but_as_whole_sound_frames(
    host: HubHost, junk: list[bytes], polite: bool
) -> None:
    """A stranger sends anything, before or after its hello, and leaves. Then two others still talk; what the host got
    are exactly the sound frames that a member sent in datagrams of whole frames, in order."""
    with contextlib.closing(connect(host)) as stranger:
        if polite:
            introduce(host, stranger)
        sent = []
        for datagram in junk:
            try:
                stranger.send(datagram)
            except (BrokenPipeError, ConnectionResetError):
                break  # shown the door for what it said
            sent.append(datagram)
            host.serve(0.0)
    received = b"".join(iter(lambda: host.recv(0.0), b""))
    expected = b"".join(
        drop_malformed(datagram)
        for datagram in sent
        if 0 < len(datagram) <= MAX_DATAGRAM and len(datagram) % FRAME_SIZE == 0
    )
    if polite:
        assert received == expected
    else:  # perhaps one of its messages was a hello that made it a member
        assert expected.endswith(received)
    assert all(dlc <= 8 for _, dlc, _ in FRAME.iter_unpack(received))

    with contextlib.closing(connect(host)) as one, contextlib.closing(connect(host)) as two:
        introduce(host, one)
        introduce(host, two)
        for sock in (one, two):
            assert unpack_control(sock.recv(4096)) is not None
        one.send(FRAME.pack(0x123, 8, b"still on"))
        assert host.recv(10.0) == FRAME.pack(0x123, 8, b"still on")
        while unpack_control(answer := two.recv(MAX_DATAGRAM)) is not None:
            pass
        assert answer == FRAME.pack(0x123, 8, b"still on")
    while host.peers():
        host.serve(0.01)


@given(datagram=st.one_of(st.binary(max_size=300), controls))
def test_reading_a_control_message_never_raises(datagram: bytes) -> None:
    """Either nothing, or an object; its filters are pairs of 32-bit numbers or a ValueError."""
    message = unpack_control(datagram)
    assert message is None or isinstance(message, dict)
    with contextlib.suppress(ValueError):
        for pair in read_filters((message or {}).get("filters")) or ():
            assert all(0 <= value < 1 << 32 for value in pair)


@given(value=st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=20), max_size=4).filter(bool))
def test_a_control_message_is_never_taken_for_frames(value: dict[str, object]) -> None:
    """Its length is no multiple of a frame's, and it comes back as it was."""
    datagram = pack_control(**value)
    assert len(datagram) % FRAME_SIZE != 0
    assert unpack_control(datagram) == value


@given(
    batch=st.lists(frames, max_size=30),
    rules=st.none() | st.lists(st.tuples(st.integers(0, 0xFFFFFFFF), st.integers(0, 0xFFFFFFFF)), max_size=4),
)
def test_filters_follow_the_kernels_definition(batch: list[bytes], rules: list[tuple[int, int]] | None) -> None:
    """linux/can.h: `received_id & mask == id & mask`, inverted by CAN_INV_FILTER (bit 29 of the id); several add up.
    Error frames have a filter of their own, which lets all of them pass."""

    def passes(can_id: int) -> bool:
        if rules is None or can_id & ERR_FLAG:
            return True
        for wanted, mask in rules:
            inverted = bool(wanted & 0x20000000)
            match = (can_id & mask & 0xDFFFFFFF) == (wanted & mask & 0xDFFFFFFF)
            if match is not inverted:
                return True
        return False

    expected = b"".join(one for one in batch if passes(FRAME.unpack(one)[0]))
    accepted = FrameFilter(rules)
    assert accepted.select(b"".join(batch)) == expected
    assert accepted.select(b"".join(batch)) == expected  # with all ids known
