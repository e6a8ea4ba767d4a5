"""Whatever is wrong with the bus: no frame goes without a reason, none comes from nowhere, and a run repeats itself."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from bus.icd.batches import DECODERS, encode_CYCLE_DONE, encode_fogs, encode_rw_cmds, encode_rw_tlms, encode_SYNC
from bus.wire.frames import ERR_FLAG, FRAME, FRAME_SIZE
from plant_server.can_bus.controller import AFTER_PASSIVE, Controller, State
from plant_server.can_bus.wire import Wire
from plant_server.faults import Fault, FaultTimeline, make_fault

TICK_S = 0.01
TICKS = 40
PROBABILITY = st.floats(0.05, 1.0)
NODE = st.sampled_from(["all", "wheel.1", "wheel.3", "gyro", "fsw"])
ONE = st.sampled_from(["wheel.1", "wheel.3", "gyro", "plant", "fsw"])
KINDS = st.one_of(
    st.fixed_dictionaries({"kind": st.sampled_from(["loss", "duplicate", "reorder", "bit_errors", "wrong_dlc"]),
                           "probability": PROBABILITY, "node": NODE}),
    st.fixed_dictionaries({"kind": st.just("delay"), "delay_s": st.floats(0.006, 0.08), "node": NODE}),
    st.fixed_dictionaries({"kind": st.just("jitter"), "jitter_s": st.floats(0.006, 0.08), "node": NODE}),
    st.fixed_dictionaries({"kind": st.sampled_from(["silent", "bus_off"]), "node": NODE}),
    st.just({"kind": "dominant"}),
    st.fixed_dictionaries({"kind": st.just("babble"), "node": ONE, "rate_hz": st.floats(50.0, 8000.0),
                           "can_id": st.sampled_from([0x010, 0x112, 0x192, 0x7FF])}),
    st.fixed_dictionaries({"kind": st.just("masquerade"), "node": st.just("star_tracker"),
                           "can_id": st.sampled_from([0x110, 0x190, 0x1A0]),
                           "content": st.sampled_from(["stale", "foreign"])}),
)  # fmt: skip
SPANS = st.tuples(st.integers(0, 20), st.integers(1, 20))
FAULTS = st.lists(st.tuples(KINDS, SPANS), min_size=1, max_size=4)


def make_faults(drawn: list[Any]) -> tuple[Fault, ...]:
    return tuple(
        make_fault(unit="bus", at_s=on * TICK_S, until_s=(on + length) * TICK_S, **keys) for keys, (on, length) in drawn
    )


def fly(faults: tuple[Fault, ...], timed: bool, cut: int) -> tuple[list[bytes], list[bytes]]:
    """What both sides got on each tick; the flight software's frames come in parts of `cut` bytes."""
    wire = Wire(FaultTimeline(faults, step_s=TICK_S, steps_per_tick=1, seed=3), 10_000_000, 500_000, timed=timed)
    seen, got = [], []
    for k in range(TICKS):
        tlms = encode_rw_tlms(k % 15, (0,) * 4, (1.0 + k,) * 4, (0.0,) * 4, k & 0xFF)
        fogs = encode_fogs(k % 15, (0,) * 3, (0.1, 0.2, 0.3), k & 0xFF)
        seen.append(wire.send(k, k, tlms + fogs + encode_SYNC(k % 15, 0, k)))
        batch = encode_rw_cmds(k % 15, (1,) * 4, (1e-3 * k,) * 4, k & 0xFF) + encode_CYCLE_DONE(k % 15, 2, k, 0)
        passed = b"".join(wire.hear(batch[at : at + cut]) for at in range(0, len(batch), cut))
        assert passed == batch[-FRAME_SIZE:]
        got.append(wire.end())
        assert wire.counts.is_conserved(wire.waiting())
        heard = sum(not can_id & ERR_FLAG and can_id != 0x080 for can_id, _, _ in FRAME.iter_unpack(b"".join(seen)))
        assert heard == wire.counts.delivered[0]
        assert len(b"".join(got)) // FRAME_SIZE == wire.counts.delivered[1]
    return seen, got


@settings(max_examples=max(15, settings.default.max_examples // 4))
@given(FAULTS, st.booleans(), st.sampled_from([16, 48, 80]))
def test_frames_are_conserved_and_runs_repeat(drawn: list[Any], timed: bool, cut: int) -> None:
    """On every tick, in each direction, for any faults together; and another run, its frames cut otherwise, is the same."""
    faults = make_faults(drawn)
    assert fly(faults, timed, cut) == fly(faults, timed, 80)


@settings(max_examples=max(10, settings.default.max_examples // 8))
@given(FAULTS, st.booleans())
def test_frames_of_an_id_keep_their_order(drawn: list[Any], timed: bool) -> None:
    """Unless a fault reorders or forges them: speed and torque, which rise with every tick here, never go back."""
    faults = tuple(
        fault for fault in make_faults(drawn)
        if fault.kind not in ("reorder", "masquerade", "babble", "wrong_dlc", "bit_errors")
    )  # fmt: skip
    seen, got = fly(faults, timed, 80)
    for can_id, batches in ((0x190, seen), (0x193, seen), (0x110, got), (0x113, got)):
        said = [
            DECODERS[can_id](data)[2] for batch in batches for i, _, data in FRAME.iter_unpack(batch) if i == can_id
        ]
        assert said == sorted(said), hex(can_id)


STEPS = st.lists(
    st.sampled_from(["sent", "heard", "send_error", "hear_error", "unacknowledged", "dominant", "recessive"]),
    max_size=400,
)


@given(STEPS)
def test_a_controller_keeps_the_rules_of_the_standard(steps: list[str]) -> None:
    """After any history: its state is the one of its counters, and each event changes them by what the standard says."""
    node = Controller()
    for step in steps:
        tec, rec, state = node.tec, node.rec, node.state
        if step == "sent":
            node.note_sent()
            change = (-1 if tec else 0, 0)
        elif step == "heard":
            node.note_heard()
            change = (0, AFTER_PASSIVE - rec if rec > 127 else -1 if rec else 0)
        elif step == "send_error":
            node.note_send_error()
            change = (8, 0)
        elif step == "unacknowledged":
            node.note_send_error(only_unacknowledged=True)
            change = (0 if state is State.PASSIVE else 8, 0)
        elif step == "hear_error":
            node.note_hear_error()
            change = (0, min(255, rec + 1) - rec)
        elif step == "dominant":
            node.note_dominant(4)
            change = (0, min(255, rec + 32) - rec)
        else:
            back = node.note_recessive(100)
            change = (-tec, -rec) if back else (0, 0)
            assert not back or state is State.OFF
        if state is State.OFF and step != "recessive":
            change = (0, 0)
        assert (node.tec - tec, node.rec - rec) == change, step
        if state is State.OFF and node.tec:
            assert node.is_off
        else:
            expected = (
                State.OFF if node.tec >= 256 else State.PASSIVE if max(node.tec, node.rec) >= 128 else State.ACTIVE
            )
            assert node.state is expected
