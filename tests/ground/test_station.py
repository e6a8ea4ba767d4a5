"""The conformance of the vehicle as ground programs need it: ways in, parameters, the bus, requests, and hostile grounds."""

from __future__ import annotations

import json
import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav

from bus.mavlink.json_parts import Assembler, cut_request
from bus.wire.frames import FRAME_SIZE
from fsw import tuning
from fsw.ground.can_forward import FRAMES_A_S
from fsw.modes import Mode
from tools.log.mcap_reader import FRAMES_AT
from tools.log.message_index import DATA_AT

ODD = (math.nan, math.inf, -math.inf, -0.0, 1e38, -1e38, 1e-45, 0.5, 65535.0, 2.0**31)


def of(messages: list[Any], *types: str) -> list[Any]:
    """The messages of these types."""
    return [message for message in messages if message.get_type() in types]


def texts(messages: list[Any]) -> str:
    """All words that were said, put together."""
    return "".join(("" if message.chunk_seq else "\n") + message.text for message in of(messages, "STATUSTEXT"))


# -- the way in --------------------------------------------------------------------------------------------------------


def test_the_connect_sequence_of_qgroundcontrol(vehicle: Any) -> None:
    """Version, modes, parameters, mission: in QGroundControl's order and with its empty values, each answered at once."""
    station = vehicle.station
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION, *[math.nan] * 6)
    (version,) = of(vehicle.step(2), "AUTOPILOT_VERSION")
    assert version.capabilities & mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert version.capabilities & mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    assert not version.capabilities & (
        mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    )
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, 435, 1)
    assert of(vehicle.step(2), "AVAILABLE_MODES")[0].number_modes == 5
    station.command(mav.MAV_CMD_REQUEST_MESSAGE, 397)  # COMPONENT_METADATA: there is none
    assert [ack.result for ack in of(vehicle.step(2), "COMMAND_ACK")] == [mav.MAV_RESULT_UNSUPPORTED]
    station.send(mav.MAVLink_param_request_list_message(1, 0))
    values = of(vehicle.step(10), "PARAM_VALUE")
    assert [value.param_index for value in values] == list(range(values[0].param_count))
    station.send(mav.MAVLink_mission_request_list_message(1, 1))
    (count,) = of(vehicle.step(2), "MISSION_COUNT")
    assert (count.count, count.target_system, count.target_component) == (0, 255, 190)


def test_mavlink_ftp_is_refused_at_once(vehicle: Any) -> None:
    """NAK FileNotFound to a request for the parameter file: MAVProxy then asks for parameters in the usual way."""
    payload = bytes([5, 0, 0, 4, 14, 0, 0, 0, 0, 0, 0, 0]) + b"@PARAM/param.pck"
    vehicle.station.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload.ljust(251, b"\0"))))
    (answer,) = of(vehicle.step(2), "FILE_TRANSFER_PROTOCOL")
    assert (answer.payload[3], answer.payload[5], answer.payload[12]) == (129, 4, 10)


# -- commands ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [176, 400, 420, 410, 511, 512, 520, 32000, 31000, 65535])
def test_odd_numbers_in_any_parameter_are_answered_once_and_never_raise(vehicle: Any, command: int) -> None:
    """NaN, infinities, huge and tiny numbers: one ACK each, and the flight goes on."""
    for odd in ODD:
        for place in range(7):
            params = [0.0] * 7
            params[place] = odd
            vehicle.ask(command, *params)
        vehicle.ask(command, *[odd] * 7)
    assert vehicle.flight.executive.cycles == vehicle.bench.tick


def test_a_command_that_is_repeated_is_done_once(vehicle: Any) -> None:
    """With a confirmation above 0 and the same parameters the answer is repeated, not the change of mode."""
    assert vehicle.ask(176, 1, 3) == mav.MAV_RESULT_ACCEPTED
    changes = vehicle.flight.modes.changes
    vehicle.step(5)
    assert vehicle.ask(176, 1, 3, confirmation=1) == mav.MAV_RESULT_ACCEPTED
    assert vehicle.flight.modes.changes == changes
    assert len([event for event in vehicle.events() if "command mode.safe" in event]) == 1


def test_what_is_for_others_is_left_alone(vehicle: Any) -> None:
    """Another component or system: no answer and no change; component 0 is for all."""
    vehicle.station.command(176, 1, 3, component=25)
    vehicle.station.send(mav.MAVLink_command_long_message(2, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0))
    assert of(vehicle.step(2), "COMMAND_ACK") == []
    assert vehicle.flight.modes.mode is Mode.POINT
    assert vehicle.ask(176, 1, 3, component=0) == mav.MAV_RESULT_ACCEPTED


# -- parameters --------------------------------------------------------------------------------------------------------


def test_parameters_are_listed_read_set_and_refused(vehicle: Any) -> None:
    """Every name once, REAL32; a set one is echoed as stored at once; unknown, read-only and wild ones are refused."""
    station = vehicle.station
    station.send(mav.MAVLink_param_request_list_message(1, 1))
    values = of(vehicle.step(10), "PARAM_VALUE")
    names = [value.param_id for value in values]
    assert names[: len(tuning.BY_NAME)] == list(tuning.BY_NAME)
    assert {"TICK_HZ", "INERTIA_XX", "WHEEL4_MAX_NM", "LAW_K1"} <= set(names)
    assert len(set(names)) == len(names) == values[0].param_count
    assert {value.param_type for value in values} == {mav.MAV_PARAM_TYPE_REAL32}
    station.send(mav.MAVLink_param_request_read_message(1, 1, b"", 3))
    assert of(vehicle.step(2), "PARAM_VALUE")[0].param_id == names[3]
    station.send(mav.MAVLink_param_set_message(1, 1, b"SLEW_MAX_DEG_S", 0.3, 9))
    (echo,) = of(vehicle.step(2), "PARAM_VALUE")
    assert (echo.param_id, echo.param_value) == ("SLEW_MAX_DEG_S", pytest.approx(0.3))
    assert vehicle.flight.slew_rate_deg_s == 0.3  # the decimal number that was meant, not its 32-bit neighbour
    for name, value, error in (
        (b"NO_SUCH", 1.0, 1), (b"SLEW_MAX_DEG_S", 11.0, 2), (b"SLEW_MAX_DEG_S", math.nan, 2), (b"STALE_TICKS", 2.5, 3),
        (b"POINT_DEG_S", 7.0, 3), (b"LAW_K1", -1.0, 3), (b"TICK_HZ", 5.0, 6),
    ):  # fmt: skip
        station.send(mav.MAVLink_param_set_message(1, 1, name, value, 9))
        heard = [m for m in vehicle.step(3) if m.get_msgId() == 345]
        assert [m.error for m in heard] == [error], name
    assert vehicle.flight.slew_rate_deg_s == 0.3


# -- the bus -----------------------------------------------------------------------------------------------------------


def test_the_bus_is_forwarded_to_who_asked_until_the_requests_end(vehicle: Any) -> None:
    """Every frame of the bus in its order, as in the log; after 5 s without a request no more, and the sum is told."""
    station = vehicle.station
    station.send(mav.MAVLink_command_long_message(1, 1, 32000, 0, 1, 0, 0, 0, 0, 0, 0))
    begin = vehicle.bench.tick
    heard = []
    for _ in range(10):
        heard += of(vehicle.step(), "CAN_FRAME")
    logged = b"".join(
        record.data[FRAMES_AT - DATA_AT :]
        for _, record in vehicle.bench.log.iterate_topics("/can/bus0")
        if begin <= record.sequence < begin + 10
    )
    frames = [logged[at : at + FRAME_SIZE] for at in range(0, len(logged), FRAME_SIZE)]
    sent = [f.id.to_bytes(4, "little") + bytes([f.len, 0, 0, 0]) + bytes(f.data) for f in heard]
    assert sent == [bytes([*f[:5], 0, 0, 0, *f[8:]]) for f in frames]
    assert len(sent) > 100
    assert {f.bus for f in heard} == {0}
    station.send(mav.MAVLink_can_filter_modify_message(1, 1, 1, mav.CAN_FILTER_REPLACE, 2, [0x190, 0x080, *[0] * 14]))
    vehicle.step()
    assert {f.id for f in of(vehicle.step(5), "CAN_FRAME")} == {0x190, 0x080}
    station.heartbeat()
    vehicle.step(480)
    assert of(vehicle.step(), "CAN_FRAME")
    vehicle.step(30)
    assert of(vehicle.step(20), "CAN_FRAME") == []
    assert "CAN forward ends, no request for 5 s" in texts(station.heard)


def test_no_more_is_forwarded_than_a_tick_can_bear(vehicle: Any) -> None:
    """A bench at a thousand ticks a second has more frames than FRAMES_A_S: the rest is counted."""
    vehicle.ask(32000, 1)
    heard = 0
    for _ in range(1000):
        vehicle.clock.ns += 1_000_000
        vehicle.bench.step()
        heard += len(of(vehicle.station.listen(), "CAN_FRAME"))
    forward = vehicle.ground.forward
    assert forward.sent == pytest.approx(heard, abs=40)
    assert FRAMES_A_S * 0.9 < heard < FRAMES_A_S * 1.2
    assert forward.left_out > 5000
    assert vehicle.ask(32000, 0) == mav.MAV_RESULT_ACCEPTED
    assert not forward.on
    assert vehicle.ask(32000, 2) == mav.MAV_RESULT_DENIED


# -- requests in JSON --------------------------------------------------------------------------------------------------


def request(vehicle: Any, what: dict[str, Any], token: int = 7) -> dict[str, Any]:
    """Ask in JSON; the answer."""
    for message in cut_request(what, token, 1, 1):
        vehicle.station.send(message)
    assembler = Assembler()
    found = [assembler.add(m) for m in vehicle.step(4) if m.get_type() == "HILSAT_REPLY" and m.token == token]
    (answer,) = [reply for reply in found if reply is not None]
    return answer


def test_a_command_is_given_exactly_with_its_tick(vehicle: Any) -> None:
    """By verb, for a later tick; the answer says which, and on that tick it is obeyed."""
    at = vehicle.bench.tick + 50
    what = {"do": "command", "verb": "target.hold", "arguments": {"target_q": [0.6, 0.0, 0.8, 0.0]}, "at_tick": at}
    assert request(vehicle, what) == {"state": "accepted", "tick": at, "final": True}
    while vehicle.bench.tick < at:
        vehicle.step()
        assert vehicle.flight.guidance.target.q_it != (0.6, 0.0, 0.8, 0.0)
    vehicle.step()
    assert vehicle.flight.guidance.target.q_it == (0.6, 0.0, 0.8, 0.0)
    early = request(vehicle, {"do": "command", "verb": "mode.safe", "at_tick": 3}, token=8)
    assert early["state"] == "accepted"
    assert early["tick"] > at


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ({"do": "dance"}, "do: there are: command, status"),
        ({"do": "command"}, "a command has verb"),
        ({"do": "command", "verb": "mode.safe", "at_tick": 1.5}, "a command has verb"),
        ({"do": "command", "verb": "mode.safe", "arguments": {"now": True}}, "takes no arguments"),
        ({"do": "command", "verb": "mode.degraded"}, "mode.degraded is not known; there are: target.hold"),
        ({"do": "command", "verb": "target.hold", "arguments": {"target_q": [0, 0, 0, 0]}}, "is no attitude"),
        ({"do": "command", "verb": "target.hold", "arguments": {"target_q": "x" * 2000}}, "no command is that long"),
        ({"do": "command", "verb": "x" * 50}, "no command is that long"),
        (
            {"do": "command", "verb": "param.set", "arguments": {"name": "STALE_TICK", "value": 3}},
            "did you mean STALE_TICKS",
        ),
        (
            {"do": "command", "verb": "param.set", "arguments": {"name": "STALE_TICKS", "value": True}},
            "true is not a number",
        ),
        ({"do": "command", "verb": "param.set", "arguments": {"name": [], "value": 1}}, "is not known"),
        ({"do": "command", "verb": "param.set", "arguments": {"value": 1}}, "takes name and value"),
    ],
)
def test_requests_that_cannot_be_done_are_refused_with_reasons(vehicle: Any, what: dict[str, Any], words: str) -> None:
    """One answer, final, with why."""
    answer = request(vehicle, what)
    assert (answer["state"], answer["final"]) == ("refused", True)
    assert words in answer["reasons"][0]


def test_the_state_of_the_vehicle_is_told(vehicle: Any) -> None:
    """Mode, attitude, numbers, and the names of what DEBUG_FLOAT_ARRAY carries, one for each of its numbers in use."""
    answer = request(vehicle, {"do": "status"})
    assert (answer["mode"], answer["intended"], answer["state"]) == ("point", "point", "done")
    assert answer["q_ib"] == pytest.approx(vehicle.flight.detection.estimate.q_ib, abs=1e-2)
    assert answer["numbers"]["STALE_TICKS"] == 5.0
    fields = answer["observer_fields"]
    assert fields[:3] == ["tau_fault_hat_b_nm[0]", "tau_fault_hat_b_nm[1]", "tau_fault_hat_b_nm[2]"]
    vehicle.station.command(mav.MAV_CMD_REQUEST_MESSAGE, 350)
    array = of(vehicle.step(2), "DEBUG_FLOAT_ARRAY")[0]
    assert array.name == "observer"
    assert array.data[fields.index("error_deg")] == pytest.approx(vehicle.flight.error_deg, rel=0.1)
    assert not any(array.data[len(fields) :])


# -- what was found ----------------------------------------------------------------------------------------------------


def test_what_the_flight_finds_is_said(make_vehicle: Any) -> None:
    """Every line of the flight software in /events is a STATUSTEXT as well, word for word: of a gyro's fault, for one."""
    drift = "faults=[{unit: gyro.y, kind: constant, rate_rad_s: 0.02, at_s: 10}]"
    vehicle = make_vehicle("gyro-drift-flight", drift)
    for _ in range(20):
        vehicle.station.heartbeat()
        vehicle.step(100)
    vehicle.step(20)
    records = [json.loads(record.data) for _, record in vehicle.bench.log.iterate_topics("/events")]
    logged = [record["message"] for record in records if record["name"] == "fsw"]
    said = texts(vehicle.station.heard).strip().split("\n")
    assert any("gyro.y: fault" in line for line in logged), logged
    assert said == logged[-len(said) :]
    assert len(said) >= len(logged) - 1


# -- hostile grounds ---------------------------------------------------------------------------------------------------


def test_garbage_is_counted_and_never_raises(vehicle: Any) -> None:
    """Random bytes, cut and changed packets, MAVLink 1, empty datagrams: the flight goes on, and nothing was obeyed."""
    chance = random.Random(1)
    good = mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(vehicle.station.protocol)
    commands = vehicle.events()
    for _ in range(300):
        changed = bytearray(good)
        changed[chance.randrange(len(good))] ^= 1 << chance.randrange(8)
        if changed[0] == 0xFD and changed[5:] != good[5:]:
            vehicle.station.send_bytes(bytes(changed))
        vehicle.station.send_bytes(chance.randbytes(chance.randrange(300)))
        vehicle.station.send_bytes(good[: chance.randrange(len(good))])
        vehicle.step()
    counters = vehicle.ground.component.endpoint.counters
    assert counters.garbage + counters.bad_checksum + counters.unknown > 600
    assert vehicle.events() == commands


def test_a_flood_takes_a_tick_no_more_than_so_many_packets(vehicle: Any) -> None:
    """Datagrams of 200 packets each: 16 packets a tick are read, and a command behind them still gets its answer."""
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(vehicle.station.protocol)
    counters = vehicle.ground.component.endpoint.counters
    before = counters.received
    for _ in range(5):
        vehicle.station.send_bytes(beat * 200)
    vehicle.station.command(400, 0)
    for tick in range(1, 62):
        heard = vehicle.step()
        assert counters.received <= before + 16 * tick
        if tick < 62:
            assert of(heard, "COMMAND_ACK") == []
    assert [ack.result for ack in of(vehicle.step(3), "COMMAND_ACK")] == [mav.MAV_RESULT_ACCEPTED]


def test_a_ground_that_does_not_listen_is_not_waited_for(vehicle: Any) -> None:
    """Its queue fills up, what does not fit is counted, and what is computed stays the same, bit for bit."""
    other = type(vehicle.bench).open("nominal", log="memory")
    other.step(vehicle.bench.tick)
    for _ in range(30):
        vehicle.station.heartbeat()
        vehicle.station.send(mav.MAVLink_param_request_list_message(1, 1))
        for _ in range(10):
            vehicle.clock.ns += 100_000_000
            vehicle.bench.step()
            other.step()
    assert vehicle.ground.component.endpoint.counters.dropped > 100
    for topic in ("/fsw/attitude", "/fsw/control", "/fsw/input", "/can/bus0"):
        one, two = ([r.data for _, r in bench.log.iterate_topics(topic)] for bench in (vehicle.bench, other))
        assert one == two
    other.close()
