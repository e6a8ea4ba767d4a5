"""The wire between the two sides: what each fault of the bus makes of the frames, with and without real timing."""

from __future__ import annotations

import itertools
import json
from typing import Any

import pytest

from bus.errors import ConfigError
from bus.icd.batches import DECODERS, encode_CYCLE_DONE, encode_fogs, encode_rw_cmds, encode_rw_tlms, encode_SYNC
from bus.icd.e2e import checksum
from bus.icd.messages import MESSAGES
from bus.run import BusConfig, run_hash
from bus.wire.address import may_carry_error_frames
from bus.wire.frames import ERR_FLAG, FRAME, FRAME_SIZE
from plant_server.can_bus.counts import BUS, REASONS, TO_FSW, TO_PLANT
from plant_server.can_bus.frame_time import count_frame_bits
from plant_server.can_bus.wire import Wire
from plant_server.faults import KINDS, FaultTimeline, make_fault
from plant_server.faults.bus_nodes import PACING_IDS, ROUTES

TICK_NS = 10_000_000
TICK_S = 0.01
BITRATE = 500_000
TELEMETRY = tuple(range(0x190, 0x194)) + tuple(range(0x1A0, 0x1A3))
COMMANDS = tuple(range(0x110, 0x114))


def bus_fault(kind: str, **keys: Any) -> Any:
    return make_fault(**{"unit": "bus", "kind": kind, "at_s": 0.0, **keys})


class Rig:
    """A wire with both sides played: what each got on each tick."""

    def __init__(self, *faults: Any, timed: bool = False, seed: int = 5, **keys: Any) -> None:
        self.timeline = FaultTimeline(faults, step_s=TICK_S, steps_per_tick=1, seed=seed)
        self.wire = Wire(
            self.timeline, TICK_NS, keys.get("bitrate", BITRATE), timed=timed, reports=keys.get("reports", True)
        )
        self.tick = 0
        self.seen: list[bytes] = []
        self.got: list[bytes] = []

    def announce(self) -> bytes:
        k = self.tick
        tlms = encode_rw_tlms(k % 15, (0,) * 4, (1.0 + k, 2.0, 3.0, 4.0), (10.0, 20.0, 30.0, 40.0), k & 0xFF)
        return tlms + encode_fogs(k % 15, (0,) * 3, (0.1, 0.2, 0.3), k & 0xFF) + encode_SYNC(k % 15, 0, k)

    def command(self) -> bytes:
        k = self.tick
        return encode_rw_cmds(k % 15, (1,) * 4, (0.01, 0.02, 0.03, 0.04), k & 0xFF)

    def run(self, ticks: int) -> Rig:
        for _ in range(ticks):
            self.seen.append(self.wire.send(self.tick, self.tick, self.announce()))
            done = encode_CYCLE_DONE(self.tick % 15, 2, self.tick, 0)
            assert self.wire.hear(self.command() + done) == done
            self.got.append(self.wire.end())
            assert self.wire.counts.is_conserved(self.wire.waiting())
            self.tick += 1
        return self

    def values(self) -> dict[str, Any]:
        flat = iter(self.wire.values())
        found = {field.name: tuple(next(flat) for _ in range(field.count)) for field in BUS.fields}
        assert next(flat, None) is None
        return found


def ids(batch: bytes) -> list[int]:
    return [can_id for can_id, _, _ in FRAME.iter_unpack(batch)]


def frames(batches: list[bytes], can_id: int) -> list[tuple[int, bytes]]:
    """Tick and struct of every frame with an id."""
    return [
        (tick, batch[at : at + FRAME_SIZE])
        for tick, batch in enumerate(batches)
        for at in range(0, len(batch), FRAME_SIZE)
        if int.from_bytes(batch[at : at + 4], "little") == can_id
    ]


def events(rig: Rig) -> list[str]:
    return [event.phase for event in rig.timeline.take_events(1 << 40)]


@pytest.mark.parametrize("timed", [False, True])
def test_a_sound_bus_carries_everything_on_its_tick(timed: bool) -> None:
    """Nothing lost, SYNC last; without timing the very bytes, with it in the order of the ids."""
    rig = Rig(timed=timed)
    for _ in range(30):
        announced, command = rig.announce(), rig.command()
        rig.run(1)
        seen, got = rig.seen[-1], rig.got[-1]
        assert seen == announced  # here sorted by id already
        assert got == command
    assert rig.values()["delivered"] == (210.0, 120.0)


@pytest.mark.parametrize("timed", [False, True])
def test_pacing_frames_are_left_alone_by_everything(timed: bool) -> None:
    """SYNC on every tick and last, with its own bytes, whatever is wrong with the bus; CYCLE_DONE at once (in `run`)."""
    wrong = [
        bus_fault("loss", probability=1.0), bus_fault("dominant"), bus_fault("bus_off", node="all"),
        bus_fault("delay", delay_s=1.0), bus_fault("babble", rate_hz=20000.0, can_id=0), bus_fault("wrong_dlc"),
    ]  # fmt: skip
    for fault in wrong:
        rig = Rig(fault, timed=timed).run(20)
        for tick, seen in enumerate(rig.seen):
            assert seen[-FRAME_SIZE:] == encode_SYNC(tick % 15, 0, tick), fault.kind
            assert ids(seen).count(0x080) == 1


@pytest.mark.parametrize("timed", [False, True])
def test_loss_takes_its_share_of_every_direction(timed: bool) -> None:
    """5 % of 7000 and 4000 frames, within 5 sigma; the others are what was sent."""
    rig = Rig(bus_fault("loss", probability=0.05), timed=timed).run(1000)
    values = rig.values()
    for way, count in ((TO_FSW, 7000), (TO_PLANT, 4000)):
        assert values["sent"][way] == count
        assert abs(values["lost_loss"][way] - 0.05 * count) < 5 * (count * 0.05 * 0.95) ** 0.5
        assert values["delivered"][way] == count - values["lost_loss"][way]
    assert events(rig) == ["onset", "effect"]


def test_one_faults_chance_does_not_depend_on_another() -> None:
    """Which frames of the gyro are lost is the same with a second fault on the wheels and a third on the gyro itself."""
    one = bus_fault("loss", node="gyro", probability=0.3)
    alone = Rig(one).run(300)
    both = Rig(one, bus_fault("loss", node="wheel.1", probability=0.5), bus_fault("delay", node="gyro", delay_s=0.02))
    both.run(302)
    assert [frame for _, frame in frames(alone.seen, 0x1A0)] == [frame for _, frame in frames(both.seen, 0x1A0)][
        : len(frames(alone.seen, 0x1A0))
    ]


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize(("delay_s", "ticks"), [(0.006, 1), (0.015, 1), (0.02, 2), (0.1, 10)])
def test_a_delay_is_whole_ticks_from_half_of_one_on(delay_s: float, ticks: int, timed: bool) -> None:
    """A frame is late by the ticks whose middle (telemetry) or end (commands) it misses; only those of its node are."""
    rig = Rig(bus_fault("delay", node="wheel.1", delay_s=delay_s), timed=timed).run(30)
    assert {tick - DECODERS[0x190](frame[8:])[4] for tick, frame in frames(rig.seen, 0x190)} == {
        ticks + timed_extra(delay_s, timed)
    }
    assert {tick - frame[14] for tick, frame in frames(rig.got, 0x110)} == {ticks + timed_extra(delay_s, timed)}
    assert {tick - DECODERS[0x191](frame[8:])[4] for tick, frame in frames(rig.seen, 0x191)} == {0}
    assert {tick - frame[14] for tick, frame in frames(rig.got, 0x111)} == {0}


def timed_extra(delay_s: float, timed: bool) -> int:
    """With timing, a frame that is put on the bus just at the border has its own length to go beyond it."""
    return 1 if timed and delay_s == 0.015 else 0


def test_delays_that_change_nothing_are_refused() -> None:
    """Up to half a tick, by a scenario and by a command."""
    short = bus_fault("delay", delay_s=0.005)
    with pytest.raises(ConfigError, match=r"delay_s 0.005 s has no effect: .* half a tick late, 0.005 s"):
        Rig(short)
    with pytest.raises(ConfigError, match="jitter_s"):
        Rig().timeline.add(bus_fault("jitter", jitter_s=0.001), 0)


@pytest.mark.parametrize("timed", [False, True])
def test_jitter_keeps_the_order_of_an_id(timed: bool) -> None:
    """Up to 5 ticks late, by different ticks, and never behind a later one."""
    rig = Rig(bus_fault("jitter", jitter_s=0.05), timed=timed).run(300)
    for can_id in TELEMETRY:
        sent = [DECODERS[can_id](frame[8:])[0] for _, frame in frames(rig.seen, can_id)]
        assert all((b - a) % 15 == 1 for a, b in itertools.pairwise(sent)), hex(can_id)
    assert 0.5 * 2100 < rig.values()["late"][TO_FSW] < 2100


@pytest.mark.parametrize("timed", [False, True])
def test_a_duplicate_follows_its_frame(timed: bool) -> None:
    """With probability 1 each frame comes twice, the same bytes."""
    rig = Rig(bus_fault("duplicate", probability=1.0), timed=timed).run(10)
    assert len(frames(rig.seen, 0x190)) == 20
    assert all(a == b for a, b in zip(*[iter(frames(rig.seen, 0x190))] * 2, strict=True))
    assert rig.values()["duplicated"] == (70.0, 40.0)


@pytest.mark.parametrize("timed", [False, True])
def test_a_swapped_frame_comes_behind_the_next(timed: bool) -> None:
    """One that is overtaken arrives a tick later, behind the frame of that tick, and nothing else moves."""
    rig = Rig(bus_fault("reorder", probability=0.2, can_id=0x190), timed=timed).run(200)
    sent = [int(DECODERS[0x190](frame[8:])[2]) - 1 for _, frame in frames(rig.seen, 0x190)]
    assert len(set(sent)) == len(sent)
    assert set(range(199)) <= set(sent)
    assert any(a > b for a, b in itertools.pairwise(sent))
    assert all(abs(place - tick) <= 2 for place, tick in enumerate(sent))
    assert [tick for tick, _ in frames(rig.seen, 0x191)] == list(range(200))


def test_bit_errors_reach_the_receiver_broken_where_the_bus_has_no_timing() -> None:
    """Exactly `bits` bits of the data are another, and the checksum of the frame is wrong by that."""
    rig = Rig(bus_fault("bit_errors", probability=1.0, bits=3, node="wheel.2"))
    for _ in range(50):
        sent = {frame[:4]: frame for frame in (rig.announce()[at : at + 16] for at in range(0, 112, 16))}
        rig.run(1)
        (seen,) = [frame for tick, frame in frames(rig.seen, 0x191) if tick == rig.tick - 1]
        turned = int.from_bytes(sent[seen[:4]][8:], "little") ^ int.from_bytes(seen[8:], "little")
        assert turned.bit_count() == 3
        assert DECODERS[0x191](seen[8:]) is None
    assert rig.values()["broken"] == (50.0, 50.0)


def test_bit_errors_cost_an_attempt_where_the_bus_has_timing() -> None:
    """CAN's own checksum sees them: nothing arrives broken, the failed attempts are sent again and load the bus."""
    rig = Rig(bus_fault("bit_errors", probability=0.1), timed=True).run(300)
    values = rig.values()
    assert values["broken"] == (0.0, 0.0)
    attempts = values["delivered"][0] + values["delivered"][1] + values["attempts_failed"][0]
    assert abs(values["attempts_failed"][0] / attempts - 0.1) < 5 * (0.09 / attempts) ** 0.5
    assert values["delivered"][TO_FSW] == 2100
    assert values["error_frames"][0] > 100


def test_a_wrong_length_is_cut_and_seen() -> None:
    """dlc and no data behind it."""
    rig = Rig(bus_fault("wrong_dlc", node="wheel.3", dlc=4)).run(3)
    for _, frame in frames(rig.seen, 0x192):
        assert (frame[4], frame[12:]) == (4, bytes(4))
    assert all(frame[4] == 8 for _, frame in frames(rig.seen, 0x193))


@pytest.mark.parametrize("timed", [False, True])
def test_a_silent_node_still_hears(timed: bool) -> None:
    """No frame of wheel 1 is seen; its commands arrive."""
    rig = Rig(bus_fault("silent", node="wheel.1"), timed=timed).run(5)
    assert frames(rig.seen, 0x190) == []
    assert len(frames(rig.got, 0x110)) == 5
    assert rig.values()["lost_silent"] == (5.0, 0.0)


@pytest.mark.parametrize("timed", [False, True])
def test_a_node_goes_off_with_its_32nd_attempt_and_comes_back(timed: bool) -> None:
    """TEC 256; deaf and mute until 128 times 11 recessive bits after the end, which fit into a tick here."""
    rig = Rig(bus_fault("bus_off", node="wheel.2", until_s=0.2), timed=timed).run(20)
    values = rig.values()
    assert (values["tec"][1], values["state"][1], values["attempts_failed"][0]) == (256.0, 2.0, 32.0)
    assert frames(rig.seen, 0x191) == []
    rig.run(5)
    assert rig.values()["state"][1] == 0.0
    assert [tick for tick, _ in frames(rig.seen, 0x191)] == [21, 22, 23, 24]
    assert [tick for tick, _ in frames(rig.got, 0x111)][-4:] == [21, 22, 23, 24]
    assert events(rig) == ["onset", "effect", "end"]


def test_a_slow_bus_takes_longer_to_go_off_and_to_come_back() -> None:
    """At 125 kbit/s a tick has 1250 bits: 32 attempts of some 150 take four ticks. The bus is full then, and the only
    recessive sequences stand behind its frames, 10 to 14 a tick: 128 of them take 10 to 13 ticks.
    """
    rig = Rig(bus_fault("bus_off", node="wheel.2", until_s=0.2), bitrate=125_000)
    states = [rig.run(1).values()["state"][1] for _ in range(40)]
    assert states[2] < 2.0 <= states[6]
    assert states[20] == 2.0
    assert 20 + 9 <= states.index(0.0, 20) <= 20 + 13


def test_a_node_that_nobody_restarts_stays_off() -> None:
    """auto_recovery: false, to the end of the run."""
    rig = Rig(bus_fault("bus_off", node="gyro", until_s=0.1, auto_recovery=False)).run(100)
    assert rig.values()["state"][4] == 2.0
    assert frames(rig.seen, 0x1A0) == []


@pytest.mark.parametrize("timed", [False, True])
def test_a_flight_computer_that_is_off_hears_sync_and_its_own_controller(timed: bool) -> None:
    """Error frames (warning, off, later restarted) and SYNC are all that it sees, and no command arrives."""
    rig = Rig(bus_fault("bus_off", node="fsw", until_s=0.3), timed=timed).run(40)
    assert all(set(ids(seen)) <= {0x080, *(i for i in ids(seen) if i & ERR_FLAG)} for seen in rig.seen[3:30])
    assert rig.got[3:30] == [b""] * 27
    classes = [can_id & ~ERR_FLAG for seen in rig.seen for can_id in ids(seen) if can_id & ERR_FLAG]
    assert 0x240 in classes
    assert 0x304 in classes
    assert len(rig.got[35]) == 4 * FRAME_SIZE


def test_error_frames_do_not_go_to_real_adapters() -> None:
    """The same run without them, and the addresses on which they are left out."""
    fault = bus_fault("bus_off", node="fsw", until_s=0.3)
    quiet = Rig(fault, reports=False).run(40)
    assert not any(can_id & ERR_FLAG for seen in quiet.seen for can_id in ids(seen))
    assert [may_carry_error_frames(a) for a in ("hub:", "memory:x", "socketcan:vcan0", "socketcan:vcan12")] == [
        True
    ] * 4
    assert [may_carry_error_frames(a) for a in ("socketcan:can0", "pcan:PCAN_USBBUS1", "virtual:x")] == [False] * 3


@pytest.mark.parametrize("timed", [False, True])
def test_nobody_gets_through_a_dominant_bus(timed: bool) -> None:
    """Nothing arrives, every node is error passive at once and none is off; they are back with the first good frames."""
    rig = Rig(bus_fault("dominant", until_s=0.2), timed=timed).run(20)
    values = rig.values()
    assert values["delivered"] == (0.0, 0.0)
    assert values["state"] == (1.0,) * 8
    assert values["load"] == (1.0,)
    rig.run(40)
    assert rig.values()["state"] == (0.0,) * 8
    assert set(TELEMETRY) <= set(ids(rig.seen[-1]))


def test_a_low_id_starves_the_rest_where_the_bus_has_timing() -> None:
    """Id 0 at the rate that fills the bus: telemetry stays away; the same at a high id hurts nobody."""
    rate_hz = 1.2 * BITRATE / count_frame_bits(FRAME.pack(0, 8, bytes(8)))
    low = Rig(bus_fault("babble", rate_hz=rate_hz, can_id=0), timed=True).run(60)
    assert frames(low.seen[10:], 0x1A2) == []
    assert low.values()["load"][0] > 0.98
    assert low.values()["lost_overflow"][0] > 0
    high = Rig(bus_fault("babble", rate_hz=rate_hz, can_id=0x7FF), timed=True).run(60)
    assert len(frames(high.seen, 0x1A2)) == 60


def test_babble_comes_at_its_rate() -> None:
    """1234 Hz over 2 s, evenly: 2468 frames, 12 or 13 a tick."""
    rig = Rig(bus_fault("babble", rate_hz=1234.0)).run(200)
    counts = [ids(seen).count(0x010) for seen in rig.seen]
    assert sum(counts) == 2468
    assert set(counts) == {12, 13}
    assert rig.values()["inserted"] == (2468.0, 0.0)


@pytest.mark.parametrize("content", ["stale", "foreign"])
def test_a_masquerading_node_sends_good_frames_with_a_counter_of_its_own(content: str) -> None:
    """Right checksum of the forged id, a counter that runs, and the content that was asked for."""
    rig = Rig(bus_fault("masquerade", at_s=0.05, content=content)).run(20)
    pairs = [[frame for tick, frame in frames(rig.seen, 0x190) if tick == k] for k in range(6, 20)]
    counters = []
    for true, forged in pairs:
        assert checksum(0x190, forged[9:16]) == forged[8]
        counters.append(forged[9] & 0x0F)
        assert forged[9] & 0x0F != true[9] & 0x0F
    assert all((b - a) % 15 == 1 for a, b in itertools.pairwise(counters))
    speeds = {DECODERS[0x190](forged[8:])[2] for _, forged in pairs}
    assert speeds == ({2.0} if content == "foreign" else {6.0})  # wheel 2 turns at 2; wheel 1 did at 6 rad/s on tick 5


def test_arbitration_is_by_id_and_first_come_within_one() -> None:
    """Frames that wait at all nodes go lowest id first, whoever sends them and in which order they came."""
    rig = Rig(bus_fault("delay", delay_s=0.02, node="gyro"), timed=True).run(10)
    assert ids(rig.seen[5]) == [*sorted(ids(rig.seen[5])[:-1]), 128]


def test_load_is_the_share_of_busy_bits() -> None:
    """On a sound bus: the bits of the frames of a tick over those of the tick, with and without timing."""
    for timed in (False, True):
        rig = Rig(timed=timed).run(5)
        rig.tick -= 1
        batch = rig.announce() + rig.command() + encode_CYCLE_DONE(4, 2, 4, 0)
        bits = sum(count_frame_bits(batch[at : at + FRAME_SIZE]) for at in range(0, len(batch), FRAME_SIZE))
        assert rig.values()["load"][0] == pytest.approx(bits / (BITRATE * TICK_S))


def test_a_full_queue_drops_the_newest() -> None:
    """64 frames wait at a node that cannot send; more are lost as overflow."""
    rig = Rig(bus_fault("dominant"), timed=True).run(100)
    values = rig.values()
    assert values["waiting"] == (4 * 64.0 + 64.0, 64.0)
    assert values["lost_overflow"] == (400 + 300 - 320.0, 400 - 64.0)


@pytest.mark.parametrize(
    ("kind", "keys", "words"),
    [
        ("loss", {"can_id": 0x080}, "0x080 paces the run"), ("babble", {"can_id": 0x081}, "0x081 paces the run"),
        ("loss", {"can_id": 0x555}, "0x555 is sent by no node"),
        ("delay", {"node": "gyro", "can_id": 0x190}, "0x190 is sent by wheel.1 to fsw"),
        ("silent", {"node": "fsw", "can_id": 0x190}, "0x190 is sent by wheel.1 to fsw"),
        ("masquerade", {"node": "wheel.1"}, "own id"), ("masquerade", {"can_id": 0x555}, "sent by no node"),
        ("masquerade", {"node": "all"}, "takes one node"), ("babble", {"node": "all"}, "takes one node"),
    ],
)  # fmt: skip
def test_what_can_have_no_effect_is_refused(kind: str, keys: dict[str, Any], words: str) -> None:
    """With the reason, at the kind."""
    with pytest.raises(ConfigError, match=words):
        bus_fault(kind, **keys)


def test_every_kind_stands_for_a_mavlink_failure_or_is_reached_by_name() -> None:
    """Types 1 to 7 of FAILURE_UNIT 109 each have a kind; each kind reads back from its own definition."""
    types = [kind for cls in KINDS["bus"].values() for _, kind in cls.failures]
    assert sorted(set(types)) == [1, 2, 3, 4, 5, 6, 7]
    assert all(unit == 109 for cls in KINDS["bus"].values() for unit, _ in cls.failures)
    for kind in KINDS["bus"]:
        fault = bus_fault(kind)
        assert make_fault(**json.loads(fault.definition)) == fault


def test_the_value_of_an_event_is_a_number_with_a_point() -> None:
    """Whole numbers and switches are no other kind of number in the log: both builds write the same."""
    rig = Rig(bus_fault("bus_off", auto_recovery=False), bus_fault("babble", rate_hz=500.0), bus_fault("wrong_dlc"))
    values = [event.value for event in rig.timeline.take_events(1)]
    assert values == [0.0, 500.0, 1.0]
    assert all(type(value) is float for value in values)


def test_routes_are_those_of_the_interface() -> None:
    """Sender and receiver of every id as the DBC has them, SYNC and CYCLE_DONE apart."""
    names = {
        "FSW": "fsw",
        "PLANT": "plant",
        "GYRO": "gyro",
        "STR": "star_tracker",
        **{f"RW{i}": f"wheel.{i}" for i in range(1, 5)},
    }
    assert set(ROUTES) | set(PACING_IDS) == set(MESSAGES)
    for can_id, (sender, receiver) in ROUTES.items():
        assert names[MESSAGES[can_id].sender] == sender
        assert receiver in [names[node] for node in MESSAGES[can_id].receivers]


def test_timing_counts_in_the_run_hash_only_where_it_is_real() -> None:
    """A scenario without it keeps its number; with it, the bit rate counts too."""
    resolved = {"seed": 1, "duration_s": 1, "plant": {}, "faults": [], "fsw": {}, "clock": {"tick_hz": 10}}
    plain = {"address": "hub:", "bitrate_bps": 500_000, "timing": "none"}
    base = run_hash(resolved)
    assert run_hash({**resolved, "bus": plain}) == run_hash({**resolved, "bus": {**plain, "bitrate_bps": 1}}) == base
    real = {run_hash({**resolved, "bus": {**plain, "timing": "real", "bitrate_bps": rate}}) for rate in (1, 2)}
    assert len(real | {base}) == 3
    assert BusConfig().timing == "none"


def test_every_reason_has_a_field() -> None:
    """The topic has a pair of numbers for each."""
    assert {f"lost_{reason}" for reason in REASONS} <= {field.name for field in BUS.fields}
