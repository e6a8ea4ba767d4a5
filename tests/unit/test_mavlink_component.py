"""What every component of ours does on a link, against pymavlink's own common dialect at the other end.

Time is a clock of the test's own; packets are packed and decoded by the stock dialect alone.
"""

from __future__ import annotations

import inspect
import itertools
import math
import os
import socket
import struct
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common, development

from bus.errors import ConfigError, UsageError
from bus.mavlink import dialect, words
from bus.mavlink.component import (
    AT_ONCE,
    FASTEST_US,
    LATER,
    LISTENERS,
    Asked,
    CommandRequest,
    Component,
    Identity,
    Traffic,
)
from bus.mavlink.dialect import MAVLink_statustext_message
from bus.mavlink.endpoint import AT_ONCE as TAKEN
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.json_parts import cut_request
from bus.mavlink.parameters import Parameter, Parameters
from tools.design.generate_dialect import MODULE, generate

SECOND = 1_000_000_000
ME = (1, 7)
CAPABILITIES = words.CAN_MAVLINK2 | words.CAN_PARAM_ENCODE_C_CAST
NAN = math.nan
ODD = (NAN, math.inf, -math.inf, -0.0, 1e38, -1e38, 1e-40, 0.5, 65535.0)


class Clock:
    """Wall time as the test has it."""

    def __init__(self) -> None:
        self.ns = 5 * SECOND

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int) -> None:
        raise AssertionError("nobody sleeps here")


class Rig:
    """A component on its endpoint, and a stock ground program's socket."""

    def __init__(self, directory: Path) -> None:
        self.clock = Clock()
        self.directory = directory
        self.done: list[CommandRequest] = []
        self.asked: list[Asked] = []
        self.value = 0.25
        items = [Parameter(f"P_{i}", lambda i=i: float(i), None) for i in range(40)]
        items.append(Parameter("P_SET", lambda: self.value, self._write, -1.0, 0.99))
        traffic = Traffic(commands={400: self._arm}, messages={2: self._time}, rates_hz={2: 10.0})
        self.endpoint = Endpoint(directory / "c.sock", *ME)
        self.component = Component(
            self.endpoint, Identity(ME[1], 18, 8, CAPABILITIES), self.clock, lambda: (32, 3, 4),
            Parameters(items), traffic, self.asked.append,
        )  # fmt: skip
        self.socket = self.open_socket("g")
        self._out, self._in = common.MAVLink(None, 255, 190), common.MAVLink(None)

    def _write(self, value: float) -> str:
        if value == 0.5:
            return "a half will not do"
        self.value = value
        return ""

    def _arm(self, request: CommandRequest) -> int:
        self.done.append(request)
        return len(self.done) % 2

    def _time(self, _: int) -> list[Any]:
        return [dialect.MAVLink_system_time_message(1, self.clock.ns // 1_000_000)]

    def open_socket(self, name: str) -> socket.socket:
        found = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        found.bind(str(self.directory / f"{name}.sock"))
        return found

    def send_raw(self, data: bytes) -> None:
        self.socket.sendto(data, str(self.endpoint.path))

    def send(self, message: Any) -> None:
        self.send_raw(message.pack(self._out))

    def beat(self) -> None:
        """A ground program's heartbeat."""
        self.send(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def poll(self, times: int = 1) -> list[Any]:
        """Turn the loop, and return what has come after each turn, decoded by the stock dialect."""
        found = []
        for _ in range(times):
            self.component.poll()
            found += self.hear()
        return found

    def hear(self) -> list[Any]:
        found: list[Any] = []
        while True:
            try:
                found += self._in.parse_buffer(self.socket.recv(65536)) or []
            except BlockingIOError:
                return found

    def call(self, message: Any, times: int = 1) -> list[Any]:
        self.send(message)
        return self.poll(times)

    def command(self, number: int, *params: float, confirmation: int = 0, to: tuple[int, int] = ME) -> list[Any]:
        given = (*params, *[0.0] * (7 - len(params)))
        return self.call(common.MAVLink_command_long_message(*to, number, confirmation, *given))


@pytest.fixture
def rig() -> Iterator[Rig]:
    with tempfile.TemporaryDirectory(prefix="hs-", dir="/tmp") as name:
        found = Rig(Path(name))
        yield found
        found.component.close()
        found.socket.close()


def kinds(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


def results(messages: list[Any]) -> list[int]:
    return [message.result for message in messages if message.get_type() == "COMMAND_ACK"]


# -- the dialect ---------------------------------------------------------------------------------------------------


def test_the_dialect_is_what_the_generator_writes() -> None:
    """dialect.py is up to date with hilsat.xml."""
    assert MODULE.read_text(encoding="utf-8") == generate()


def test_messages_are_those_of_the_stock_dialects() -> None:
    """Each but our own two and ESC_STATUS: the same checksum seed, name, fields, types and lengths as pymavlink's.

    pymavlink has no ESC_STATUS; 10 is the checksum seed of common.xml's definition.
    """
    missing = []
    for number, ours in dialect.mavlink_map.items():
        stock = common.mavlink_map.get(number) or development.mavlink_map.get(number)
        if stock is None:
            missing.append(ours.msgname)
            continue
        for name in (
            "msgname",
            "crc_extra",
            "fieldnames",
            "ordered_fieldnames",
            "fieldtypes",
            "native_format",
            "lengths",
        ):
            assert getattr(ours, name) == getattr(stock, name), (ours.msgname, name)
    assert missing == ["ESC_STATUS", "HILSAT_REQUEST", "HILSAT_REPLY"]
    assert dialect.mavlink_map[291].crc_extra == 10


def test_private_messages_keep_out_of_the_ranges_of_others() -> None:
    """Above all of the dialects that pymavlink has."""
    assert {number for number in dialect.mavlink_map if number > 60_049} == {62_000, 62_001}


# -- 1: presence ---------------------------------------------------------------------------------------------------


def test_a_heartbeat_a_second_of_wall_time_while_the_loop_turns(rig: Rig) -> None:
    """However often the loop turns; none while it stands, and no burst afterwards."""
    rig.beat()
    first = rig.poll()
    assert kinds(first).count("HEARTBEAT") == 1
    (beat,) = [message for message in first if message.get_type() == "HEARTBEAT"]
    assert (beat.type, beat.autopilot, beat.base_mode, beat.custom_mode, beat.system_status) == (18, 8, 32, 3, 4)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == ME
    times = []
    for _ in range(5000):
        rig.clock.ns += SECOND // 1000
        if rig.clock.ns % SECOND == 0:
            rig.beat()
        if "HEARTBEAT" in kinds(rig.poll()):
            times.append(rig.clock.ns)
    assert [later - sooner for sooner, later in itertools.pairwise(times)] == [SECOND] * 4
    rig.clock.ns += 8 * SECOND
    assert rig.hear() == []
    assert kinds(rig.poll(3)).count("HEARTBEAT") == 1


def test_who_is_not_heard_for_ten_seconds_is_forgotten(rig: Rig) -> None:
    """No streams and no heartbeats to nobody; heard again, at once."""
    rig.beat()
    assert rig.poll() != []
    assert rig.component.has_listeners
    rig.clock.ns += 11 * SECOND
    rig.poll()
    assert not rig.component.has_listeners
    rig.clock.ns += 5 * SECOND
    assert rig.poll(3) == []
    rig.beat()
    assert "HEARTBEAT" in kinds(rig.poll())


def test_more_listeners_than_there_is_room_for_are_not_kept(rig: Rig) -> None:
    """The first ones stay."""
    sockets = [rig.open_socket(f"n{i}") for i in range(LISTENERS + 5)]
    packed = common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(common.MAVLink(None, 255, 190))
    for one in sockets:
        one.sendto(packed, str(rig.endpoint.path))
        rig.component.poll()
    rig.component.say(words.INFO, "to all")
    rig.component.poll()
    heard = 0
    for one in sockets:
        try:
            while b"to all" not in one.recv(2000):
                pass
            heard += 1
        except BlockingIOError:
            pass
        one.close()
    assert heard == LISTENERS


# -- 2: version ----------------------------------------------------------------------------------------------------


def test_version_on_request(rig: Rig) -> None:
    """By 512 with NaN behind the number, as MAVSDK sends it, and by the older 520: MAVLink 2 and parameters by C cast."""
    for heard in (rig.command(512, 148, *[NAN] * 6), rig.command(520, 1)):
        (version,) = [message for message in heard if message.get_type() == "AUTOPILOT_VERSION"]
        assert version.capabilities == CAPABILITIES
        assert version.capabilities & common.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        assert version.capabilities & common.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        assert results(heard) == [0]
    for number in (149, 1e9, 0.5, -1, NAN, math.inf):
        heard = rig.command(512, number)
        assert results(heard) == [words.UNSUPPORTED]
        assert len(heard) == 1
    assert "SYSTEM_TIME" in kinds(rig.command(512, 2))


# -- 3: commands ---------------------------------------------------------------------------------------------------


def test_each_command_has_one_answer(rig: Rig) -> None:
    """By either message; its number and who asked are in it; one that is unknown is unsupported."""
    heard = rig.command(400, 1, 2, 3, 4, 5, 6, 7)
    heard += rig.call(common.MAVLink_command_int_message(*ME, 0, 400, 0, 0, 1, 2, 3, 4, 5, 6, 7))
    assert [request.params for request in rig.done] == [(1, 2, 3, 4, 5, 6, 7)] * 2
    assert [(m.command, m.result, m.target_system, m.target_component) for m in heard] == [
        (400, 1, 255, 190), (400, 0, 255, 190),
    ]  # fmt: skip
    for number in (0, 410, 31010, 65535):
        assert results(rig.command(number)) == [words.UNSUPPORTED]
    assert len(rig.done) == 2


def test_a_repeated_command_is_answered_again_and_not_done_again(rig: Rig) -> None:
    """confirmation above 0, the same number and parameters, NaN and all; other parameters are another command."""
    assert results(rig.command(400, 1, NAN)) == [1]
    for confirmation in (1, 2, 255):
        assert results(rig.command(400, 1, NAN, confirmation=confirmation)) == [1]
    assert len(rig.done) == 1
    assert results(rig.command(400, 2, NAN, confirmation=1)) == [0]
    assert results(rig.command(400, 2, NAN)) == [1]
    assert len(rig.done) == 3


def test_answers_are_remembered_for_some_and_not_for_all(rig: Rig) -> None:
    """A flood of different commands does not grow what is kept."""
    for number in range(1000):
        rig.command(number)
    assert len(rig.component._answered) == 64


# -- 4: targets ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("to", "taken"),
    [
        ((1, 7), True),
        ((0, 7), True),
        ((1, 0), True),
        ((0, 0), True),
        ((2, 7), False),
        ((1, 1), False),
        ((255, 190), False),
    ],
)
def test_what_is_for_others_is_left_alone(rig: Rig, to: tuple[int, int], taken: bool) -> None:
    """And counted; 0 means everybody."""
    assert (results(rig.command(400, to=to)) == [1]) == taken
    assert len(rig.done) == taken
    assert rig.endpoint.counters.foreign == (not taken)


# -- 5: odd numbers ------------------------------------------------------------------------------------------------


def test_odd_numbers_in_any_parameter_never_raise(rig: Rig) -> None:
    """NaN, infinite, -0, huge and tiny in each place of every command that is known; each is answered once."""
    for number in (400, 511, 512, 520, 420):
        for place in range(7):
            for odd in ODD:
                params = [1.0] * 7
                params[place] = odd
                heard = rig.command(number, *params)
                assert len(results(heard)) == 1
    for odd in ODD:
        (echo,) = [
            m
            for m in rig.call(common.MAVLink_param_set_message(*ME, b"P_SET", odd, 9))
            if m.get_type() == "PARAM_VALUE"
        ]
        assert -1.0 <= echo.param_value <= 0.9901


@pytest.mark.parametrize(
    "interval_us", [-1, 0, FASTEST_US, 1e6, FASTEST_US - 1, 1e11, NAN, math.inf, -math.inf, -5, 2.5e4]
)
def test_streams_come_as_often_as_they_are_asked_for(rig: Rig, interval_us: float) -> None:
    """-1 never, 0 as usual, an interval in its range; all else is denied with the reason, and changes nothing."""
    rig.beat()
    rig.poll()
    heard = rig.command(511, 2, interval_us)
    denied = interval_us not in (0, -1) and not FASTEST_US <= interval_us <= 1e10
    assert results(heard) == [words.DENIED if denied else words.ACCEPTED]
    assert ("STATUSTEXT" in kinds(heard)) == denied
    expected = 10.0 if denied or interval_us == 0 else max(0.0, 1e6 / interval_us)
    count = 0
    for turn in range(5000):
        rig.clock.ns += SECOND // 1000
        if turn % 2000 == 0:
            rig.beat()
        count += kinds(rig.poll()).count("SYSTEM_TIME")
    assert count == pytest.approx(5.0 * expected, abs=1.5)


# -- 6: parameters -------------------------------------------------------------------------------------------------


def test_the_list_of_parameters_is_complete_and_dense(rig: Rig) -> None:
    """All of them, indexes from 0, all REAL32; a gap is filled by index, and each is found by name."""
    heard = rig.call(common.MAVLink_param_request_list_message(*ME), 20)
    assert [message.param_index for message in heard] == list(range(41))
    assert {message.param_count for message in heard} == {41}
    assert {message.param_type for message in heard} == {common.MAV_PARAM_TYPE_REAL32}
    assert [message.param_value for message in heard] == [*range(40), 0.25]
    (again,) = rig.call(common.MAVLink_param_request_read_message(*ME, b"", 17))
    assert (again.param_id, again.param_value) == ("P_17", 17.0)
    (named,) = rig.call(common.MAVLink_param_request_read_message(*ME, b"P_3", -1))
    assert (named.param_index, named.param_value) == (3, 3.0)


def test_setting_a_parameter_echoes_what_is_stored(rig: Rig) -> None:
    """A value in range; one out of range, one that is refused and one that can only be read say so and echo the old one."""
    (echo,) = rig.call(common.MAVLink_param_set_message(*ME, b"P_SET", -0.75, 9))
    assert (echo.get_type(), echo.param_value, rig.value) == ("PARAM_VALUE", -0.75, -0.75)
    rig.call(common.MAVLink_param_set_message(*ME, b"P_SET", 0.99, 9))  # the end of the range, as a float has it
    assert rig.value == 0.99
    rig.call(common.MAVLink_param_set_message(*ME, b"P_SET", -0.75, 9))
    for name, value, error, stored in (
        (b"P_SET", 2.0, 2, -0.75),
        (b"P_SET", 0.5, 3, -0.75),
        (b"P_SET", NAN, 2, -0.75),
        (b"P_5", 1.0, 6, 5.0),
    ):
        heard = rig.call(common.MAVLink_param_set_message(*ME, name, value, 9))
        by_kind = {message.get_type(): message for message in heard}
        assert by_kind["PARAM_ERROR"].error == error
        assert by_kind["PARAM_VALUE"].param_value == stored
        assert name.decode() in by_kind["STATUSTEXT"].text


@pytest.mark.parametrize("name", [b"NOPE", b"", b"p_3", b"\xff\xfe\x00x", b"SIXTEEN_LETTERS_"])
def test_an_unknown_parameter_is_an_error(rig: Rig, name: bytes) -> None:
    """DOES_NOT_EXIST, for reading by name or by index and for setting."""
    for message in (
        common.MAVLink_param_request_read_message(*ME, name, -1),
        common.MAVLink_param_request_read_message(*ME, b"P_3", 41),
        common.MAVLink_param_set_message(*ME, name, 1.0, 9),
    ):
        (answer,) = rig.call(message)
        assert (answer.get_type(), answer.error) == ("PARAM_ERROR", 1)


def test_names_of_parameters_are_sound() -> None:
    """Each once, none empty or longer than the field."""
    for names in (["A", "A"], [""], ["x" * 17]):
        with pytest.raises(ConfigError):
            Parameters([Parameter(name, lambda: 0.0) for name in names])


# -- 7, 8: files, missions, time -----------------------------------------------------------------------------------


def test_files_are_refused_at_once(rig: Rig) -> None:
    """NAK, FileNotFound, the next sequence number and the opcode that was asked: 12 s that MAVProxy need not wait."""
    asked = struct.pack("<HBBBBBBI", 41, 3, 4, 5, 0, 0, 0, 77).ljust(251, b"x")
    (answer,) = rig.call(common.MAVLink_file_transfer_protocol_message(0, *ME, list(asked)))
    sequence, session, opcode, size, of = struct.unpack("<HBBBB", bytes(answer.payload[:6]))
    assert (sequence, session, opcode, size, of, answer.payload[12]) == (42, 3, 129, 1, 4, 10)
    assert (answer.target_system, answer.target_component) == (255, 190)
    refused = struct.pack("<HBBBBBBI", 41, 3, 129, 5, 0, 0, 0, 77).ljust(251, b"x")
    assert rig.call(common.MAVLink_file_transfer_protocol_message(0, *ME, list(refused))) == []


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_there_is_no_mission(rig: Rig, kind: int) -> None:
    """Nor fence nor rally points: a count of 0 of what was asked for."""
    (answer,) = rig.call(common.MAVLink_mission_request_list_message(*ME, kind))
    assert (answer.get_type(), answer.count, answer.mission_type) == ("MISSION_COUNT", 0, kind)


def test_time_is_told_to_who_asks(rig: Rig) -> None:
    """A request has tc1 0; an answer to somebody else's is none."""
    (answer,) = rig.call(common.MAVLink_timesync_message(0, 123456789))
    assert (answer.tc1, answer.ts1) == (rig.clock.ns, 123456789)
    assert rig.call(common.MAVLink_timesync_message(5, 6)) == []


# -- 10: texts -----------------------------------------------------------------------------------------------------


def test_long_texts_come_in_parts_that_fit_together(rig: Rig) -> None:
    """By id and number, as STATUSTEXT has it; also to one who asked and does not listen; not twice to one who does."""
    text = "wheel.2 loss, effectiveness 0.3 µ " * 5
    rig.component.say(words.WARNING, text, str(rig.directory / "g.sock"))
    parts = rig.poll()
    rig.beat()
    rig.poll()
    rig.component.say(words.WARNING, text, str(rig.directory / "g.sock"))
    for found in (parts, [m for m in rig.poll() if m.get_type() == "STATUSTEXT"]):
        assert [m.chunk_seq for m in found] == list(range(len(found)))
        assert len({m.id for m in found}) == 1
        assert found[0].id > 0
        assert b"".join(bytes(m._text_raw).rstrip(b"\0") for m in found).decode() == text


# -- 11: garbage ---------------------------------------------------------------------------------------------------


def test_garbage_is_counted_by_what_is_wrong_with_it(rig: Rig) -> None:
    """Noise, cut packets, a wrong checksum, an unknown message, MAVLink 1: none raises, and the next command is obeyed."""
    protocol = common.MAVLink(None, 255, 190)
    good = common.MAVLink_command_long_message(*ME, 400, 0, *[0.0] * 7).pack(protocol)
    old = common.MAVLink_command_long_message(*ME, 400, 0, *[0.0] * 7).pack(protocol, force_mavlink1=True)
    unknown = common.MAVLink_gps_raw_int_message(*[1] * 10).pack(protocol)
    counters = rig.endpoint.counters
    for data, name, count in (
        (b"", "garbage", 0), (b"\x00" * 40, "garbage", 1), (b"\xfd", "garbage", 2), (good[:-1], "garbage", 3),
        (good + b"tail", "garbage", 4), (good[:-1] + bytes([good[-1] ^ 1]), "bad_checksum", 1),
        (good[:2] + b"\x02" + good[3:], "bad_checksum", 2), (unknown, "unknown", 1), (old, "version_1", 1),
    ):  # fmt: skip
        rig.send_raw(data)
        rig.component.poll()
        assert getattr(counters, name) == count, data
    assert len(rig.done) == 2  # the one before the tail, and the one of version 1
    assert results(rig.command(400)) != []


def test_several_packets_in_one_datagram_are_all_taken(rig: Rig) -> None:
    """As serial bridges send them."""
    protocol = common.MAVLink(None, 255, 190)
    rig.send_raw(b"".join(common.MAVLink_command_long_message(*ME, n, 0, *[0.0] * 7).pack(protocol) for n in range(9)))
    assert [m.command for m in rig.poll()] == list(range(9))


# -- 12: sequence numbers ------------------------------------------------------------------------------------------


def test_sequence_numbers_are_dense_for_each_receiver(rig: Rig) -> None:
    """Two who hear different messages each see 0, 1, 2, ..., past 255."""
    other = rig.open_socket("o")
    numbers = [m.get_seq() for i in range(300) for m in rig.command(i)]
    assert numbers == [i % 256 for i in range(300)]
    rig.component.send_later(dialect.MAVLink_system_time_message(1, 1), str(rig.directory / "o.sock"))
    rig.component.poll()
    assert other.recv(100)[4] == 0
    other.close()


def test_one_that_was_dropped_leaves_a_gap(rig: Rig) -> None:
    """So that the receiver can count what it missed: a stream is not kept for one whose queue is full."""
    rig.beat()
    rig.poll()
    for i in range(100):
        rig.component.broadcast(MAVLink_statustext_message(words.INFO, b"%d" % i))
    assert rig.endpoint.counters.dropped > 0
    first = rig.hear()
    rig.component.broadcast(MAVLink_statustext_message(words.INFO, b"last"))
    (last,) = rig.hear()
    assert (last.get_seq() - first[-1].get_seq() - 1) % 256 == rig.endpoint.counters.dropped % 256


# -- 13: a bad ground never delays a loop --------------------------------------------------------------------------


def test_a_flood_is_taken_in_small_bites(rig: Rig) -> None:
    """At most so many datagrams a turn; the queue fills, and then it is the flooder who waits."""
    packed = common.MAVLink_command_long_message(*ME, 400, 0, *[0.0] * 7).pack(common.MAVLink(None, 255, 190))
    for _ in range(50):
        while True:
            try:
                rig.send_raw(packed)
            except BlockingIOError:
                break
        before = len(rig.done)
        rig.component.poll()
        assert len(rig.done) - before <= TAKEN
    assert sum(len(queue) for queue in rig.component._later.values()) <= LATER


def test_one_who_does_not_read_holds_up_nobody(rig: Rig) -> None:
    """Its own answers wait, then are dropped and counted; another is answered in the same turn, in little time."""
    other = rig.open_socket("o")
    protocol = common.MAVLink(None, 255, 191)
    for _ in range(50):
        rig.send(common.MAVLink_param_request_list_message(*ME))
        rig.component.poll()
    assert sum(len(queue) for queue in rig.component._later.values()) <= LATER
    other.sendto(common.MAVLink_timesync_message(0, 1).pack(protocol), str(rig.endpoint.path))
    rig.component.poll()
    assert other.recv(2000)[7] == 111
    dropped = rig.endpoint.counters.dropped
    rig.clock.ns += 3 * SECOND
    started = time.perf_counter()
    rig.poll(200)
    assert time.perf_counter() - started < 2.0
    assert rig.endpoint.counters.dropped > dropped
    assert not rig.component._later
    other.close()


def test_one_who_is_gone_costs_nothing(rig: Rig) -> None:
    """Answers to a socket that was closed are dropped and counted."""
    rig.send(common.MAVLink_param_request_list_message(*ME))
    rig.socket.close()
    for _ in range(10):
        rig.component.poll()
    assert rig.endpoint.counters.dropped == 41
    assert not rig.component._later
    rig.socket = rig.open_socket("again")


def test_the_base_never_waits() -> None:
    """Nothing in it sleeps or blocks: the sockets are non-blocking, and no call of a clock's waits."""
    import bus.mavlink.component as component
    import bus.mavlink.endpoint as endpoint

    text = inspect.getsource(component) + inspect.getsource(endpoint)
    assert "sleep" not in text
    assert "SOCK_NONBLOCK" in text


# -- endpoint, requests --------------------------------------------------------------------------------------------


def test_an_endpoint_is_private_and_cleans_up(tmp_path: Path) -> None:
    """Mode 0600, gone after close; a path that is taken, too long or nowhere is refused with words."""
    with tempfile.TemporaryDirectory(prefix="hs-", dir="/tmp") as name:
        path = Path(name) / "x.sock"
        first = Endpoint(path, 1, 1)
        assert os.stat(path).st_mode & 0o777 == 0o600
        with pytest.raises(UsageError, match="cannot make the command socket: Address already in use"):
            Endpoint(path, 1, 1)
        first.close()
        first.close()
        assert not path.exists()
        with pytest.raises(UsageError, match="set TMPDIR to a shorter directory"):
            Endpoint(Path(name) / ("y" * 120), 1, 1)
        with pytest.raises(UsageError, match="No such file or directory"):
            Endpoint(Path(name) / "z" / "x.sock", 1, 1)


def test_requests_are_remembered_for_some_and_not_for_all(rig: Rig) -> None:
    """The same token and text is handed on once; another text by that token is another request."""
    protocol = dialect.MAVLink(None, 255, 190)
    for what, token in (
        ({"do": "x"}, 1),
        ({"do": "x"}, 1),
        ({"do": "y"}, 1),
        *(({"do": "x"}, i) for i in range(2, 200)),
    ):
        for message in cut_request(what, token, *ME):
            rig.send_raw(message.pack(protocol))
        rig.component.poll()
    assert len(rig.asked) == 200
    assert len(rig.component._asked) == 64
    rig.asked[-1].reply("done", text="x" * 100_000)
    assert b'"refused"' in b"".join(bytes(message.text) for message in rig.asked[-1]._replies[0])


def test_what_waits_is_bounded_a_turn_and_in_all(rig: Rig) -> None:
    """So many messages a turn to one receiver, and so many in the queue; the oldest goes for the newest."""
    for i in range(LATER + 10):
        rig.component.send_later(dialect.MAVLink_system_time_message(i, 0), str(rig.directory / "g.sock"))
    assert rig.endpoint.counters.dropped == 10
    first = rig.poll()
    assert 0 < len(first) <= AT_ONCE
    assert first[0].time_unix_usec == 10
