"""Wheels with a motor of their own on the bus: slow telemetry, requests, current and speed commands, odd nodes.

What goes over the bus is read by cantools, which knows the DBC and not the code; the wheel behind it is a stub, whose
torques, temperatures and latches are plain numbers.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import cantools
import pytest

from bus.icd.codec import DECODERS, ENCODERS, encode_CYCLE_DONE, encode_rw_cmds
from bus.icd.e2e import REPEATED
from bus.icd.messages import IDS, dbc_path
from bus.settings import build
from bus.wheels import (
    CLEAR_LATCH,
    COMMAND_STALE,
    CURRENT,
    OFF,
    OVERSPEED,
    OVERTEMP,
    POWER_CYCLE,
    POWER_OFF,
    POWER_ON,
    RESET,
    SPEED,
    TORQUE,
)
from bus.wire.frames import FRAME, FRAME_SIZE
from fsw.config import FswConfig
from fsw.flight import Flight
from fsw.inputs import Inputs
from fsw.outputs import Outputs
from fsw.records import WheelCommands
from fsw.telemetry import make_diagnostics, read_internals
from fsw.vehicle import Vehicle
from plant_server.channel import Channel
from plant_server.config import PlantConfig
from plant_server.faults import Fault, make_fault
from plant_server.plant import Plant
from plant_server.wheels.bank import WheelBank
from tools.config.semantics import check_bus_load
from tools.run.bench import Bench

DATABASE: Any = cantools.database.load_file(dbc_path())
TICK_S = 0.1
TICKS_A_SECOND = 10
INERTIA = [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]
KT_NM_A = 0.05  # motor constant of a wheel, where its settings name none
ROTOR_KGM2 = 0.01
FSW = build(
    FswConfig,
    {
        "model": {"inertia_kgm2": INERTIA},
        "estimator": {"kind": "direct"},
        "observer": {"kind": "ilo"},
        "controller": {"kind": "smc"},
    },
    "test",
)
NONE = (0.0, 0.0, 0.0, 0.0)
STATE = (
    "speed_rad_s", "h_b_nms", "torque_nm", "torque_b_nm", "command_nm", "command_b_nm", "current_a", "status", "silent",
)  # fmt: skip


class MotorBank(WheelBank):
    """Ideal wheels that report, latch, can be switched, and know current and speed: a controller of 1 N m s/rad."""

    def __init__(self, ideal: WheelBank) -> None:
        self._ideal = ideal
        self.has_slow_telemetry = (True, True, True, True)
        self.temperature_c = (31.25, -12.34, 55.0, 20.01)
        self.ambient_c = 18.5
        self.bus_v = 27.654
        self.bus_current_a = (0.123, 0.2, 1.5, -0.4)
        self.latch = (OVERSPEED | OVERTEMP, 0, 0, 0)
        self.late_ticks = (0, 0, 0, 0)
        self.counter_frozen = (False, False, False, False)
        self.calls: list[tuple[Any, ...]] = []
        self._copy()

    def _copy(self) -> None:
        for name in STATE:
            setattr(self, name, getattr(self._ideal, name))

    def receive(self, commands_nm: Sequence[float | None]) -> None:
        self._ideal.receive(commands_nm)
        self._copy()

    def receive_modes(self, modes: tuple[int, int, int, int], setpoints: Sequence[float | None]) -> None:
        torques: list[float | None] = []
        for mode, value, speed in zip(modes, setpoints, self.speed_rad_s, strict=True):
            if value is None:
                torques.append(None)
            else:
                torques.append({CURRENT: value * KT_NM_A, SPEED: -(value - speed) * 0.1, TORQUE: value, OFF: 0.0}[mode])
        self.receive(torques)

    def clear_latch(self, wheel: int, mask: int) -> None:
        self.calls.append(("clear", wheel, mask))
        bits = list(self.latch)
        bits[wheel] &= ~mask
        self.latch = (bits[0], bits[1], bits[2], bits[3])

    def set_power(self, wheel: int, on: bool) -> None:
        self.calls.append(("power", wheel, on))

    def power_cycle(self, wheel: int) -> None:
        self.calls.append(("cycle", wheel))

    def drive(self, step: int) -> None:
        self._ideal.drive(step)
        self._copy()

    def advance(self, omega_bi_b_rad_s: Any, h_b_nms: Any) -> None:
        self._ideal.advance(omega_bi_b_rad_s, h_b_nms)
        self._copy()

    def sample_speed(self, step: int) -> Any:
        speed = self._ideal.sample_speed(step)
        self._copy()
        return speed

    def add_rotors(self, inertia_kgm2: Any) -> Any:
        return self._ideal.add_rotors(inertia_kgm2)

    def look_again(self) -> None:
        self._ideal.look_again()


def make_channel(motors: bool = True, faults: tuple[Fault, ...] = (), **settings: Any) -> tuple[Channel, Any]:
    """A plant at rest behind its frames, and its bank."""
    wheel = settings.pop("wheel", {})
    wheels = [{"mount": mount, **wheel} for mount in ("x", "y", "z", "skew")]
    data = {"step_s": TICK_S, "body": {"inertia_kgm2": INERTIA}, "wheels": wheels, **settings}
    plant = Plant(build(PlantConfig, data, "test"), faults, TICK_S, 1)
    if motors:
        plant._wheels = MotorBank(plant._wheels)
    return Channel(plant, TICK_S, 42), plant.wheels


def read(batch: bytes) -> Iterator[tuple[str, dict[str, Any]]]:
    for can_id, _, data in FRAME.iter_unpack(batch):
        message = DATABASE.get_message_by_frame_id(can_id)
        yield message.name, message.decode(data, decode_choices=False)


def commands(channel: Channel, torques: tuple[float, ...] = NONE, modes: tuple[int, ...] = (TORQUE,) * 4) -> bytes:
    a, b, c, d = torques
    return encode_rw_cmds(channel.tick % 15, modes, (a, b, c, d), channel.tick & 0xFF)  # type: ignore[arg-type]


def frame(name: str, counter: int, nibble: int, *values: Any) -> bytes:
    return ENCODERS[IDS[name]](counter, nibble, *values)


def fly(
    channel: Channel, *more: bytes, torques: tuple[float, ...] = NONE, modes: tuple[int, ...] = (TORQUE,) * 4
) -> bytes:
    """One tick, in which the wheels get these commands and frames; what the plant sent."""
    sent = channel.announce()
    done = encode_CYCLE_DONE(channel.tick % 15, 2, channel.tick, 0)
    assert channel.accept(commands(channel, torques, modes) + b"".join(more) + done)
    channel.advance()
    return sent


def ask(channel: Channel, wheel: int, action: int, mask: int = 0, counter: int = 0) -> bytes:
    return frame(f"RW{wheel + 1}_CTRL", counter, action, mask, channel.tick & 0xFF)


# -- slow telemetry ----------------------------------------------------------------------------------------------------


def test_slow_telemetry_carries_what_the_wheel_has() -> None:
    """Temperatures to 0.01 degC, voltage and current to 1 mV and 1 mA, the latch bit by bit; a current fed back reads 0."""
    channel, bank = make_channel()
    said = {name: values for _ in range(TICKS_A_SECOND) for name, values in read(fly(channel))}
    for wheel in range(4):
        temp, power = said[f"RW{wheel + 1}_TEMP"], said[f"RW{wheel + 1}_POWER"]
        assert temp["MOTOR_TEMP"] == pytest.approx(bank.temperature_c[wheel], abs=0.005)
        assert (temp["DRIVER_TEMP"], temp["BUS_VOLTAGE"]) == (18.5, 27654)
        assert power["BUS_CURRENT"] == max(0, round(bank.bus_current_a[wheel] * 1000))
        assert power["LATCH"] == bank.latch[wheel]
        assert (temp["RESERVED"], power["RESERVED"], power["UPTIME"]) == (0, 0, 0)


def test_slow_telemetry_comes_once_a_second_and_spread_out() -> None:
    """Each of the eight frames ten times in 10 s, at an even distance, counters in turn; never more than one a tick."""
    channel, _ = make_channel()
    ticks: dict[str, list[int]] = {}
    counters: dict[str, list[int]] = {}
    for tick in range(10 * TICKS_A_SECOND):
        slow = [(name, values) for name, values in read(fly(channel)) if name.endswith(("_TEMP", "_POWER"))]
        assert len(slow) <= 1
        for name, values in slow:
            ticks.setdefault(name, []).append(tick)
            counters.setdefault(name, []).append(values["COUNTER"])
    assert sorted(ticks) == sorted(f"RW{k}_{what}" for k in range(1, 5) for what in ("TEMP", "POWER"))
    for name, at in ticks.items():
        assert [b - a for a, b in itertools.pairwise(at)] == [TICKS_A_SECOND] * 9
        assert counters[name] == list(range(10))


def test_ideal_wheels_send_none_and_their_flights_keep_their_bytes() -> None:
    """Frames of a bank without motors: the ids of before, tick by tick; with motors the others are the same bytes."""
    (plain, _), (motors, _) = make_channel(False), make_channel()
    old = {0x190, 0x191, 0x192, 0x193, 0x1A0, 0x1A1, 0x1A2, 0x1B0, 0x1B1, 0x100, 0x701, 0x080}
    for _ in range(2 * TICKS_A_SECOND):
        frames, more = (fly(channel, torques=(0.01, 0.02, 0.0, -0.03)) for channel in (plain, motors))
        rows = list(FRAME.iter_unpack(frames))
        assert {row[0] for row in rows} <= old
        assert [row for row in FRAME.iter_unpack(more) if row[0] in old] == rows


def test_a_silent_wheel_sends_no_slow_telemetry() -> None:
    """Nor does one without power; the frames of the others go on."""
    channel, _ = make_channel()
    fly(channel, ask(channel, 2, POWER_OFF))
    names = {name for _ in range(TICKS_A_SECOND) for name, _ in read(fly(channel))}
    assert "RW3_TEMP" not in names
    assert "RW3_POWER" not in names
    assert {"RW1_TEMP", "RW2_POWER", "RW4_POWER"} < names


def make_inputs() -> Inputs:
    return Inputs(FSW.modes, Vehicle(FSW.model), TICK_S, 42)


def test_the_flight_software_reads_it_and_marks_it_when_stale() -> None:
    """Valid once both halves have come; held for three seconds without frames, and then said to be stale, wheel by wheel."""
    channel, _ = make_channel()
    inputs = make_inputs()
    power = inputs.sensors.powers[1]
    assert not power.valid
    for tick in range(TICKS_A_SECOND):
        inputs.receive(tick, fly(channel))
    assert power.valid
    assert (power.motor_c, power.driver_c, power.bus_v) == pytest.approx((-12.34, 18.5, 27.654), abs=1e-9)
    assert (power.bus_current_a, power.latch) == (pytest.approx(0.2), 0)
    assert inputs.sensors.powers[0].latch == OVERSPEED | OVERTEMP
    assert power.count_age_ticks(9) == 9 - 2  # slots 2 and 3 of 8 in ten ticks
    last = None
    for tick in range(TICKS_A_SECOND, 6 * TICKS_A_SECOND):
        frames = fly(channel)
        heard = b"".join(FRAME.pack(*row) for row in FRAME.iter_unpack(frames) if row[0] not in (0x291, 0x391))
        inputs.receive(tick, heard)
        if power.valid:
            last = tick
    assert last == 2 + 3 * TICKS_A_SECOND - 1
    assert inputs.sensors.powers[0].valid
    assert power.motor_c == pytest.approx(-12.34)
    assert (inputs.counters.foreign, inputs.counters.refused, inputs.count_rivals()) == (0, 0, 0)


def test_slow_telemetry_leaves_the_usual_way_alone() -> None:
    """Ticks with a frame of it are still taken at once: the links of the group know of no single frame."""
    channel, _ = make_channel()
    inputs = make_inputs()
    for tick in range(2):
        inputs.receive(tick, fly(channel))
    before = inputs._links[0x190].accepted
    for tick in range(2, 20):
        inputs.receive(tick, fly(channel))
    assert inputs._links[0x190].accepted == before
    assert inputs._links[0x290].accepted == 2
    assert inputs.links[0x190].accepted == 20


def test_wrong_slow_telemetry_is_refused_and_counted() -> None:
    """A flipped bit, a neighbour's frame under this id, a repeat: none is taken, each is counted."""
    inputs = make_inputs()
    good = frame("RW1_TEMP", 0, 0, 20.0, 20.0, 28000.0)
    flipped = good[:12] + bytes([good[12] ^ 4]) + good[13:]
    inputs.receive(0, flipped + FRAME.pack(0x291, 8, good[8:]) + FRAME.pack(0x290, 7, good[8:]))
    assert (inputs.counters.refused, inputs.sensors.powers[0].motor_c) == (3, 0.0)
    inputs.receive(1, good + good)
    assert (inputs.counters.refused, inputs.sensors.powers[0].motor_c) == (4, 20.0)


def test_a_second_sender_of_slow_telemetry_is_noticed() -> None:
    """Two senders of RW1_TEMP, counters seven apart, for a minute."""
    inputs = make_inputs()
    for second in range(60):
        for counter in (second % 15, (second + 7) % 15):
            inputs.receive(second * TICKS_A_SECOND, frame("RW1_TEMP", counter, 0, 20.0 + counter, 20.0, 28000.0))
    assert inputs.list_rivals() == [0x290]


# -- requests ----------------------------------------------------------------------------------------------------------


def latch_of(channel: Channel, wheel: int) -> int:
    """LATCH as the wheel next reports it."""
    said = [
        values for _ in range(TICKS_A_SECOND) for name, values in read(fly(channel)) if name == f"RW{wheel + 1}_POWER"
    ]
    return int(said[0]["LATCH"])


@pytest.mark.parametrize("wheel", range(4))
def test_clear_latch_clears_the_bits_of_the_mask(wheel: int) -> None:
    """MASK says which, and only the wheel that was asked is touched."""
    channel, bank = make_channel()
    bank.latch = (OVERSPEED | OVERTEMP,) * 4
    fly(channel, ask(channel, wheel, CLEAR_LATCH, OVERTEMP))
    assert bank.calls == [("clear", wheel, OVERTEMP)]
    assert latch_of(channel, wheel) == OVERSPEED
    assert latch_of(channel, (wheel + 1) % 4) == OVERSPEED | OVERTEMP


def test_reset_clears_all_and_starts_the_uptime() -> None:
    """ACTION 2: no bit is left, UPTIME counts from there."""
    channel, bank = make_channel()
    for _ in range(3 * TICKS_A_SECOND):
        fly(channel)
    fly(channel, ask(channel, 0, RESET))
    assert bank.latch[0] == 0
    uptime = [v["UPTIME"] for _ in range(20) for name, v in read(fly(channel)) if name == "RW1_POWER"]
    others = [v["UPTIME"] for _ in range(20) for name, v in read(fly(channel)) if name == "RW2_POWER"]
    assert uptime == [0, 1]
    assert others == [5, 6]


@pytest.mark.parametrize("motors", [True, False])
def test_power_off_makes_the_wheel_coast_until_power_on(motors: bool) -> None:
    """No torque on the body whatever is commanded, speed kept, NO_COMMAND; the others work; power on, and it does again."""
    channel, bank = make_channel(motors)
    torques = (0.01, 0.02, 0.03, 0.04)
    fly(channel, torques=torques)
    fly(channel, ask(channel, 1, POWER_OFF), torques=torques)
    assert channel.plant.truth().tau_rw_true_nm == pytest.approx((0.01, 0.0, 0.03, 0.04))
    speed = bank.speed_rad_s[1]
    for _ in range(5):
        fly(channel, torques=torques)
    assert bank.speed_rad_s[1] == pytest.approx(speed, abs=2e-3)  # the body turns under it, which is all
    assert bank.status[1] == 2
    fly(channel, ask(channel, 1, POWER_ON, counter=1), torques=torques)
    assert channel.plant.truth().tau_rw_true_nm == pytest.approx(torques)
    if motors:
        assert bank.calls == [("power", 1, False), ("power", 1, True)]


def test_power_cycle_is_the_banks_business() -> None:
    """ACTION 5 reaches the bank once and leaves its commands alone."""
    channel, bank = make_channel()
    fly(channel, ask(channel, 3, POWER_CYCLE), torques=(0.0, 0.0, 0.0, 0.04))
    assert bank.calls == [("cycle", 3)]
    assert channel.plant.truth().tau_rw_true_nm[3] == pytest.approx(0.04)


class Heard:
    """A fault timeline that notes who is reset and cycled."""

    def __init__(self, timeline: Any) -> None:
        self._timeline = timeline
        self.heard: list[tuple[str, str, int]] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._timeline, name)

    def reset_unit(self, unit: str, step: int) -> None:
        self.heard.append(("reset", unit, step))

    def power_cycle_unit(self, unit: str, step: int) -> None:
        self.heard.append(("cycle", unit, step))


def test_faults_hear_of_resets_and_power_cycles() -> None:
    """Unit and step; off and on again is a power cycle when power comes back, on alone is none."""
    channel, _ = make_channel()
    plant: Any = channel.plant
    try:
        plant._timeline = timeline = Heard(plant._timeline)
    except TypeError:
        pytest.skip("compiled, the timeline is of its class and no other")
    fly(channel, ask(channel, 0, RESET))
    fly(channel, ask(channel, 1, POWER_CYCLE))
    fly(channel, ask(channel, 2, POWER_ON))
    fly(channel, ask(channel, 2, POWER_OFF, counter=1))
    fly(channel, ask(channel, 2, POWER_ON, counter=2))
    assert timeline.heard == [("reset", "wheel.1", 0), ("cycle", "wheel.2", 1), ("cycle", "wheel.3", 4)]


@pytest.mark.parametrize("action", [0, 6, 15])
def test_an_unknown_action_does_nothing(action: int) -> None:
    """It is taken as a frame, and that is all."""
    channel, bank = make_channel()
    fly(channel, ask(channel, 0, action, 0xFFFF))
    assert (bank.calls, channel.counters.refused, channel.counters.accepted) == ([], 0, 6)


def test_a_request_acts_once_and_only_while_fresh() -> None:
    """The same frame again is a repeat; with a SYNC_CNT of three ticks ago it is too old; a flipped bit is refused."""
    channel, bank = make_channel(command_max_age_ticks=2)
    for _ in range(5):
        fly(channel)
    once = ask(channel, 0, CLEAR_LATCH, 1)
    fly(channel, once)
    fly(channel, once)
    old = frame("RW1_CTRL", 1, CLEAR_LATCH, 1, channel.tick - 3)
    fly(channel, old)
    bad = bytearray(ask(channel, 0, POWER_OFF, counter=2))
    bad[10] ^= 1
    fly(channel, bytes(bad))
    assert bank.calls == [("clear", 0, 1)]
    assert (channel.counters.refused, channel.counters.too_old) == (2, 1)


def test_requests_leave_the_usual_way_alone() -> None:
    """A request between commands and CYCLE_DONE does not send the batch frame by frame."""
    channel, bank = make_channel()
    for number in range(5):
        fly(channel, ask(channel, 0, CLEAR_LATCH, 1, counter=number))
    assert channel._links[0x110].accepted == 1  # the first of a run
    assert len(bank.calls) == 5


# -- current and speed -------------------------------------------------------------------------------------------------


def setpoint(channel: Channel, wheel: int, mode: int, value: float, behind: int = 0) -> bytes:
    kind = {CURRENT: "CURRENT", SPEED: "SPEED"}[mode]
    return frame(f"RW{wheel + 1}_{kind}_CMD", channel.tick % 15, 0, value, (channel.tick - behind) & 0xFF)


def with_mode(wheel: int, mode: int) -> tuple[int, ...]:
    return tuple(mode if k == wheel else TORQUE for k in range(4))


@pytest.mark.parametrize("wheel", range(4))
def test_current_mode_has_the_sign_and_size_of_the_telemetered_current(wheel: int) -> None:
    """0.6 A give 0.03 N m on the body and read back as 600 mA; TORQUE in the command is not looked at."""
    comment = DATABASE.get_message_by_name(f"RW{wheel + 1}_CURRENT_CMD").get_signal_by_name("CURRENT").comment
    assert "positive turns the body right-handed about the wheel axis and makes SPEED fall" in comment
    channel, _ = make_channel()
    for _ in range(2):
        sent = fly(
            channel, setpoint(channel, wheel, CURRENT, 0.6), torques=(0.09,) * 4, modes=with_mode(wheel, CURRENT)
        )
    torque = channel.plant.truth().tau_rw_true_nm
    assert torque == pytest.approx([0.03 if k == wheel else 0.09 for k in range(4)])
    said = dict(read(sent))[f"RW{wheel + 1}_TLM"]
    assert (said["CURRENT"], said["STATUS"]) == (600, 0)
    assert said["SPEED"] < 0.0


@pytest.mark.parametrize("wheel", range(4))
def test_speed_mode_brings_the_rotor_there(wheel: int) -> None:
    """12.5 rad/s, right-handed about the axis, as RWi_TLM reports it after ten seconds."""
    comment = DATABASE.get_message_by_name(f"RW{wheel + 1}_SPEED_CMD").get_signal_by_name("SPEED").comment
    assert "positive right-handed about the wheel axis" in comment
    channel, _ = make_channel(wheel={"max_torque_nm": 0.1})
    for _ in range(200):
        sent = fly(channel, setpoint(channel, wheel, SPEED, 12.5), modes=with_mode(wheel, SPEED))
    assert dict(read(sent))[f"RW{wheel + 1}_TLM"]["SPEED"] == pytest.approx(12.5, abs=0.01)


def test_without_a_fresh_setpoint_the_wheel_has_no_command() -> None:
    """Held for command_timeout_ticks, then none: NO_COMMAND, and COMMAND_STALE latched until it is cleared."""
    channel, bank = make_channel(command_timeout_ticks=3)
    modes = with_mode(0, CURRENT)
    fly(channel, setpoint(channel, 0, CURRENT, 0.6), modes=modes)
    torque = []
    for _ in range(4):
        fly(channel, modes=modes)
        torque.append(channel.plant.truth().tau_rw_true_nm[0])
    assert torque == pytest.approx([0.03, 0.03, 0.0, 0.0])
    assert bank.status == (2, 0, 0, 0)
    assert channel.counters.timeouts == 2
    bank.latch = (0, 0, 0, 0)
    assert latch_of(channel, 0) == COMMAND_STALE  # back in torque mode meanwhile
    fly(channel, ask(channel, 0, CLEAR_LATCH, COMMAND_STALE))
    assert latch_of(channel, 0) == 0


def test_a_setpoint_too_old_or_broken_is_not_taken() -> None:
    """SYNC_CNT of three ticks ago, a flipped bit: no command, both counted."""
    channel, bank = make_channel(command_max_age_ticks=2)
    modes = with_mode(1, SPEED)
    fly(channel, setpoint(channel, 1, SPEED, 5.0, behind=3), modes=modes)
    bad = bytearray(setpoint(channel, 1, SPEED, 5.0))
    bad[11] ^= 8
    fly(channel, bytes(bad), modes=modes)
    assert bank.status[1] == 2
    assert (channel.counters.too_old, channel.counters.refused) == (1, 1)


def test_modes_come_as_late_as_commands() -> None:
    """With two ticks of latency a current of tick 0 acts in tick 2, and torque mode after it as late again."""
    channel, _ = make_channel(command_latency_ticks=2)
    torque = []
    for tick in range(5):
        if tick < 2:
            fly(channel, setpoint(channel, 0, CURRENT, 0.6), modes=with_mode(0, CURRENT))
        else:
            fly(channel, torques=(0.01, 0.0, 0.0, 0.0))
        torque.append(channel.plant.truth().tau_rw_true_nm[0])
    assert torque == pytest.approx([0.0, 0.0, 0.03, 0.03, 0.01])


@pytest.mark.parametrize("mode", [CURRENT, SPEED])
def test_an_ideal_wheel_does_not_know_these_modes(mode: int) -> None:
    """It has no command: no torque, NO_COMMAND; and torque mode works again at once."""
    channel, bank = make_channel(False)
    fly(channel, setpoint(channel, 0, mode, 0.5), torques=(0.05,) * 4, modes=with_mode(0, mode))
    assert bank.status == (2, 0, 0, 0)
    assert channel.plant.truth().tau_rw_true_nm == pytest.approx((0.0, 0.05, 0.05, 0.05))
    fly(channel, torques=(0.05,) * 4)
    assert channel.plant.truth().tau_rw_true_nm == pytest.approx((0.05,) * 4)


# -- what the flight software sends ------------------------------------------------------------------------------------

DRIVE = WheelCommands((TORQUE,) * 4, (0.01, 0.02, 0.03, 0.04), 0)


def send(outputs: Outputs, tick: int) -> list[tuple[str, dict[str, Any]]]:
    return list(read(outputs.commands(tick, tick & 0xFF, DRIVE, 2, 0)))


def test_requests_go_out_one_a_tick_in_turn() -> None:
    """In the order asked for, CYCLE_DONE last; nothing waits twice, masks of clear_latch are joined."""
    outputs = Outputs(1, 10)
    for wheel, action, mask in [(0, CLEAR_LATCH, 1), (2, POWER_OFF, 0), (0, CLEAR_LATCH, 4), (2, POWER_OFF, 0)]:
        outputs.control_wheel(wheel, action, mask)
    seen = []
    for tick in range(1, 5):
        said = send(outputs, tick)
        assert said[-1][0] == "CYCLE_DONE"
        seen.append([(name, v["ACTION"], v["MASK"], v["SYNC_CNT"]) for name, v in said if name.endswith("_CTRL")])
    assert seen == [[("RW1_CTRL", CLEAR_LATCH, 5, 1)], [("RW3_CTRL", POWER_OFF, 0, 2)], [], []]
    assert outputs.requests_sent == 2


@pytest.mark.parametrize(("wheel", "action"), [(4, RESET), (-1, RESET), (0, 0), (0, 6)])
def test_a_request_that_cannot_be_is_refused_at_once(wheel: int, action: int) -> None:
    """A wheel or an action that there is not."""
    with pytest.raises(ValueError, match="cannot be asked for"):
        Outputs(1, 10).control_wheel(wheel, action)


def test_setpoints_are_sent_while_a_wheel_follows_one() -> None:
    """Mode in RWi_CMD, the setpoint beside it on every tick; the other wheels as before; and back to the very bytes."""
    outputs, plain = Outputs(1, 10), Outputs(1, 10)
    outputs.follow_current(1, -0.25)
    outputs.follow_speed(3, 100.0)
    for tick in range(1, 4):
        said = dict(send(outputs, tick))
        assert [said[f"RW{k}_CMD"]["MODE"] for k in range(1, 5)] == [TORQUE, CURRENT, TORQUE, SPEED]
        assert said["RW2_CURRENT_CMD"]["CURRENT"] == -0.25
        assert said["RW4_SPEED_CMD"]["SPEED"] == 100.0
        assert said["RW2_CURRENT_CMD"]["COUNTER"] == said["RW4_SPEED_CMD"]["COUNTER"] == tick - 1
        send(plain, tick)
    outputs.follow_torque(1)
    outputs.follow_torque(3)
    assert outputs.commands(4, 4, DRIVE, 2, 0) == plain.commands(4, 4, DRIVE, 2, 0)


def test_outputs_and_channel_understand_each_other() -> None:
    """Setpoints and requests of the flight software's own encoder, through to the wheels."""
    channel, bank = make_channel()
    outputs = Outputs(42, 10)
    outputs.follow_current(0, 0.4)
    outputs.control_wheel(0, CLEAR_LATCH, OVERSPEED)
    for tick in range(3):
        channel.announce()
        assert channel.accept(outputs.commands(tick, tick, DRIVE, 2, 0))
        channel.advance()
    assert channel.plant.truth().tau_rw_true_nm == pytest.approx((0.02, 0.02, 0.03, 0.04))
    assert bank.calls == [("clear", 0, OVERSPEED)]
    assert (channel.counters.refused, channel.counters.foreign, channel.counters.timeouts) == (0, 0, 0)


def test_a_request_is_logged() -> None:
    """An event with the wheel, the action and its mask, at the tick on which the frame went out."""
    bench = Bench.open("zhang2018", log="memory").step(3)
    bench.flight.outputs.control_wheel(1, CLEAR_LATCH, 5)
    bench.flight.outputs.control_wheel(3, POWER_CYCLE)
    bench.step(3)
    said = [(e["t_ns"] // bench.tick_ns, e["message"]) for e in bench.log.events if "asked" in e["message"]]
    assert said == [(3, "wheel.2 asked to clear_latch 0x0005"), (4, "wheel.4 asked to power_cycle")]


def test_slow_telemetry_is_logged_where_a_wheel_has_a_motor() -> None:
    """/fsw/wheel_power is there then and only then, so that the logs of all others keep their bytes; -1 before it came."""
    flight = Flight(FSW, TICK_S, 42)
    assert "/fsw/wheel_power" not in {topic.name for topic in make_diagnostics(flight)}
    flight.vehicle.has_motors = True
    (topic,) = (topic for topic in make_diagnostics(flight) if topic.name == "/fsw/wheel_power")
    assert {field.name: field.count for field in topic.fields} == dict.fromkeys(
        ("motor_c", "driver_c", "bus_v", "bus_current_a", "latch", "uptime_s", "age_s", "valid"), 4
    )
    power: Any = read_internals(flight)["/fsw/wheel_power"]
    assert (power.age_s, power.valid) == ((-1.0,) * 4, (False,) * 4)
    channel, _ = make_channel()
    for tick in range(TICKS_A_SECOND):
        flight.cycle(tick, fly(channel))
    power = read_internals(flight)["/fsw/wheel_power"]
    assert power.valid == (True,) * 4
    assert power.motor_c == pytest.approx((31.25, -12.34, 55.0, 20.01))
    assert power.age_s == pytest.approx((0.9, 0.7, 0.4, 0.2))


# -- nodes that send oddly ---------------------------------------------------------------------------------------------


def run_odd(
    late: int, ticks: int, frozen: bool = False, onset: int = 20
) -> tuple[Inputs, list[bool], list[float], Channel]:
    """Wheel 2 becomes late or its counter stands at the onset: what the flight software holds of it, tick by tick."""
    channel, bank = make_channel()
    inputs = make_inputs()
    valid, speeds = [], []
    for tick in range(ticks):
        if tick == onset:
            bank.late_ticks = (0, late, 0, 0)
            bank.counter_frozen = (False, frozen, False, False)
        sensors = inputs.receive(tick, fly(channel, torques=(0.0, 0.02, 0.0, 0.0)))
        valid.append(sensors.wheels[1].valid)
        speeds.append(sensors.wheels[1].speed_rad_s)
        assert sensors.wheels[0].valid
        assert sensors.wheels[2].valid
    return inputs, valid, speeds, channel


@pytest.mark.parametrize("late", [1, 3, 5])
def test_late_telemetry_within_the_hold_time_is_used_as_what_it_is(late: int) -> None:
    """The speed of so many ticks ago, which falls by 0.2 rad/s a tick; still valid, nothing refused, no second sender."""
    inputs, valid, speeds, _ = run_odd(late, 60)
    assert all(valid)
    assert speeds[50] == pytest.approx(-0.02 * TICK_S / ROTOR_KGM2 * (50 - late), rel=1e-3)
    assert (inputs.counters.refused, inputs.counters.too_old, inputs.count_rivals()) == (0, 0, 0)


@pytest.mark.parametrize("late", [6, 8, 14, 15, 16, 30, 100])
def test_late_telemetry_beyond_the_hold_time_is_stale(late: int) -> None:
    """By SYNC_CNT, also where the alive counter has gone round whole turns: never valid again, and counted."""
    onset = 20
    inputs, valid, speeds, _ = run_odd(late, 200, onset=onset)
    assert valid == [tick < onset + 5 for tick in range(200)]  # K = 5 ticks held
    assert speeds[-1] == speeds[onset - 1]
    assert inputs.counters.too_old == 200 - onset - late


def test_telemetry_that_is_late_no_longer_is_used_again() -> None:
    """On the tick after the end of the fault; what was kept back is gone, and the batch is taken at once again."""
    channel, bank = make_channel()
    inputs = make_inputs()
    for tick in range(100):
        bank.late_ticks = (0, 0, 0, 8 if 20 <= tick < 60 else 0)
        frames = fly(channel)
        assert [row[0] for row in FRAME.iter_unpack(frames)].count(0x193) == (0 if 20 <= tick < 28 else 1)
        inputs.receive(tick, frames)
    assert inputs.sensors.wheels[3].valid
    assert inputs._group.expected == 100 % 15
    assert inputs.count_rivals() == 0


def test_a_counter_that_stands_is_refused_as_repeated() -> None:
    """Every frame from the onset on; the wheel goes stale after K ticks; nobody takes it for a second sender."""
    inputs, valid, _, channel = run_odd(0, 100, frozen=True)
    assert valid == [tick < 25 for tick in range(100)]
    assert inputs.links[0x191].faults[REPEATED] == 80
    assert inputs.links[0x291].faults[REPEATED] == inputs.links[0x391].faults[REPEATED] == 8
    assert inputs.count_rivals() == 0
    assert not inputs.sensors.powers[1].valid
    assert channel._nodes.are_odd


def test_a_counter_that_stood_goes_on_with_the_others() -> None:
    """After the fault the frame has the tick's counter again and its checksum is right throughout."""
    channel, bank = make_channel()
    for tick in range(40):
        bank.counter_frozen = (10 <= tick < 20, False, False, False)
        rows = {row[0]: row[2] for row in FRAME.iter_unpack(fly(channel))}
        values = DECODERS[0x190](rows[0x190])
        assert values is not None
        assert values[0] == (9 if 10 <= tick < 20 else tick % 15)
        assert values[4] == tick
    assert not channel._nodes.are_odd


def test_a_wheel_that_is_silent_and_late_sends_nothing() -> None:
    """Silence wins; batches keep their order otherwise."""
    channel, bank = make_channel(faults=(make_fault(unit="wheel.3", kind="silent", at_s=0),))
    bank.late_ticks = (2, 0, 0, 0)
    seen = [[row[0] for row in FRAME.iter_unpack(fly(channel)[: 4 * FRAME_SIZE])][:3] for _ in range(4)]
    assert seen[0] == seen[1] == [0x191, 0x193, 0x1A0]
    assert seen[2] == seen[3] == [0x190, 0x191, 0x193]


# -- the bus must carry it ---------------------------------------------------------------------------------------------


def test_a_scenario_whose_bus_cannot_carry_slow_telemetry_is_refused() -> None:
    """108 Hz on 250 kbit/s: fits with ideal wheels, is refused with four that have a model with a motor."""
    parts: dict[Any, Any] = {
        ("clock", "tick_hz"): 108, ("bus", "bitrate_bps"): 250_000, ("plant", "star_tracker", "rate_hz"): 10.0,
    }  # fmt: skip
    assert not list(check_bus_load(parts))
    parts |= {("plant", "wheels", index, "model"): "ideal" for index in range(4)}
    assert not list(check_bus_load(parts))
    parts |= {("plant", "wheels", index, "model"): "ithaco" for index in range(4)}
    (problem,) = check_bus_load(parts)
    assert "slow telemetry of 4 wheels" in problem.message
