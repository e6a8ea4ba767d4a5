"""Short closed-loop flights on the Python bench: what the flight software does, and what it says about it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from bus.attitude import angle_between
from bus.commands import Command
from bus.units import DEG
from bus.wire.frames import FRAME_SIZE
from fsw.flight import Flight
from fsw.flight_log import SAFE_ASKED
from fsw.modes import Mode
from tools.log.mcap_reader import Run, read_run
from tools.run.bench import Bench

FSW_IDS = {0x081, 0x110, 0x111, 0x112, 0x113, 0x702}
WITHOUT_FAULTS = ["faults=[]", "expect=[]"]
ISOLATING = [*WITHOUT_FAULTS, "fsw.wheel_health={kind: torque_monitor, reaction: isolate}"]


def read_inputs(path: Path) -> list[Any]:
    """The records of /fsw/input, as an outside decoder reads them."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [content for _, _, _, content in reader.iter_decoded_messages(topics=["/fsw/input"])]


def disturb(bench: Bench, kind: str) -> None:
    """Commands on the way, and with `trouble` units that say nothing or nonsense for a while."""
    bench.retarget("slew", at_tick=120, target_q=[0.9, 0.1, 0.3, 0.3], max_rate_deg_s=0.3)
    bench.retarget("track", at_tick=350, rate_deg_s=[0.0, 0.3, 0.1])
    if kind == "trouble":
        bench.inject(at_tick=100, unit="gyro.x", kind="dead", until_s=1.5)
        bench.inject(at_tick=180, unit="wheel.2", kind="silent", until_s=2.5)
        bench.inject(at_tick=220, unit="star_tracker", kind="dropout", until_s=4.0)


@pytest.mark.parametrize("kind", ["undisturbed", "trouble"])
def test_the_recorded_inputs_reproduce_every_frame(kind: str, tmp_path: Path) -> None:
    """A fresh flight, fed with /fsw/input of a run cycle by cycle, sends what was sent, bit for bit."""
    path = tmp_path / "run.mcap"
    with Bench.open("zhang2018-flight", WITHOUT_FAULTS, log=path) as bench:
        disturb(bench, kind)
        bench.step(500)
    again = Flight(bench.resolved.scenario.fsw, bench.tick_s, bench.resolved.run_hash)
    answers, commanded = b"", 0
    inputs = read_inputs(path)
    assert len(inputs) == 500
    for tick, record in enumerate(inputs):
        commands = [Command.from_json(line) for line in record.commands.splitlines()]
        commanded += len(commands)
        again.executive.slips = record.slips
        answers += again.cycle(tick, bytes(record.frames), commands, bool(record.flags & SAFE_ASKED))
    assert commanded == 2
    assert again.inputs.counters == bench.flight.inputs.counters
    assert len(answers) >= 500 * 5 * FRAME_SIZE
    assert answers == b"".join(pack_frames(read_run(path)))


def pack_frames(log: Run) -> list[bytes]:
    """The frames of the flight software as they were on the bus, in order."""
    frames = log.frames()
    return [
        int(can_id).to_bytes(4, "little") + bytes([dlc, 0, 0, 0]) + bytes(data)
        for can_id, dlc, data in zip(frames["id"].tolist(), frames["dlc"].tolist(), frames["data"], strict=True)
        if can_id in FSW_IDS
    ]


def test_a_dead_wheel_is_isolated_and_the_rest_point() -> None:
    """Wheel 2 gives nothing from 5 s on: alarm, then no torque and OFF for it for good, and the error still settles."""
    with Bench.open("zhang2018-flight", ISOLATING, log="memory") as bench:
        bench.inject(at_tick=500, unit="wheel.2", kind="loss", effectiveness=0.0)
        bench.step(500)
        assert bench.flight.health.available == (True, True, True, True)
        bench.step(11500)
        log = bench.log
        health, control = log.signals("/fsw/wheel_health"), log.signals("/fsw/control")
        lost = np.flatnonzero(health["available"][:, 1] == 0.0)
        assert lost.size > 0
        assert log.t_ns("/fsw/wheel_health")[lost[0]] < 15e9
        assert (np.diff(lost) == 1).all()
        assert (control["tau_rw_cmd_nm"][lost, 1] == 0.0).all()
        assert np.abs(control["tau_rw_cmd_nm"][: lost[0], 1]).max() > 0.01
        assert (health["available"][:, [0, 2, 3]] == 1.0).all()
        commands = log.decoded("RW2_CMD")
        after = commands["t_ns"] > log.t_ns("/fsw/wheel_health")[lost[0]]
        assert set(commands["MODE"][after].tolist()) == {0}
        assert 1 in commands["MODE"][~after].tolist()
        assert bench.truth.error_deg < 0.25  # 0.13 measured; 42 deg at the onset


def test_the_logged_pointing_error_is_the_one_of_the_moving_target() -> None:
    """error_deg of every truth record is the angle between true q_ib and the q_it that guidance logged for that tick.

    The target turns at 0.5 deg/s and jumps once: an error taken against the target of another tick would show. 4500 ticks
    are several chunks of the log.
    """
    with Bench.open("zhang2018-flight", WITHOUT_FAULTS, log="memory") as bench:
        bench.retarget("track", at_tick=100, rate_deg_s=[0.0, 0.5, 0.0])
        bench.retarget("hold", at_tick=3000, target_q=[1.0, 0.0, 0.0, 0.0])
        bench.step(4500)
        log = bench.log
        attitude, truth = log.signals("/fsw/attitude"), log.signals("/truth/attitude")
        assert log.t_ns("/fsw/attitude").tolist() == log.t_ns("/truth/attitude").tolist()
        expected = [
            angle_between(tuple(q_it), tuple(q_ib)) / DEG
            for q_it, q_ib in zip(attitude["q_it"].tolist(), truth["q_ib"].tolist(), strict=True)
        ]
        assert truth["error_deg"] == pytest.approx(expected, abs=1e-9)
        moved = angle_between(tuple(attitude["q_it"][100].tolist()), tuple(attitude["q_it"][2999].tolist())) / DEG
        assert moved == pytest.approx(14.495, abs=0.01)


def test_a_target_that_turns_is_followed() -> None:
    """With feed-forward the error behind a target at 0.5 deg/s goes to nothing, and the rate becomes the target's."""
    with Bench.open("zhang2018-flight", [*WITHOUT_FAULTS, "fsw.target_q=[0.85, 0.25, -0.3, 0.35]"]) as bench:
        bench.retarget("track", at_tick=100, rate_deg_s=[0.0, 0.3, 0.0], rise_s=30.0)
        bench.step(12000)
        assert bench.truth.error_deg < 0.1
        assert math.dist((0.0, 0.0, 0.0), bench.truth.omega_bi_b_rad_s) == pytest.approx(0.3 * DEG, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("initial", ["point", "detumble", "safe"])
def test_a_fast_start_is_damped_on_the_gyro_alone(initial: str) -> None:
    """Off the launcher at 6.4 deg/s, the star tracker blind above 5 deg/s: damped, then pointed where that is the aim."""
    overrides = [*WITHOUT_FAULTS, "plant.body.rate_deg_s=[4, 3, 4]", "duration_s=150", f"fsw.modes.initial={initial}"]
    with Bench.open("zhang2018-flight", overrides, log="memory") as bench:
        bench.step(15000)
        log = bench.log
        rate = np.linalg.norm(log.signals("/truth/attitude")["omega_bi_b_rad_s"], axis=1)
        assert rate[14000:].max() < 0.01
        modes = log.signals("/fsw/executive")["mode"]
        assert modes[100] == (Mode.SAFE if initial == "safe" else Mode.DETUMBLE)
        assert modes[-1] == {"point": Mode.POINT, "detumble": Mode.DETUMBLE, "safe": Mode.SAFE}[initial]
        words = [event["message"] for event in log.events]
        assert any("rate good, no attitude yet" in word for word in words)
        if initial != "safe":
            assert "mode detumble waits for the rate to fall" in words


def test_a_mode_that_waits_says_for_what_after_a_second() -> None:
    """No star tracker and a slow body: standby says after 1 s what it waits for, and damps after star_stale_after_s."""
    overrides = [*WITHOUT_FAULTS, "plant.body.rate_deg_s=[0.5, 0.3, 0.4]"]
    with Bench.open("zhang2018-flight", overrides, log="memory") as bench:
        bench.inject(at_tick=0, unit="star_tracker", kind="dropout")
        bench.step(800)
        said = [(e["timestamp"]["sec"] + e["timestamp"]["nsec"] * 1e-9, e["message"]) for e in bench.log.events]
        told = {message: t_s for t_s, message in reversed(said) if message.startswith("mode")}
        assert told["mode standby waits for an attitude from the star tracker"] == pytest.approx(1.0, abs=0.1)
        assert told["mode detumble: rate good, no attitude yet"] == pytest.approx(5.0, abs=0.1)
        assert told["mode detumble waits for an attitude from the star tracker"] == pytest.approx(6.0, abs=0.3)
        assert bench.flight.modes.mode is Mode.DETUMBLE


def test_a_bench_may_be_closed_more_than_once_and_its_log_stays() -> None:
    """`run_to_end` inside `with` closes it twice; the log is read before, between and after."""
    with Bench.open("nominal", ["duration_s=2", "expect=[]"], log="memory") as bench:
        bench.run_to_end()
        assert len(bench.log.ticks("/truth/attitude")) == 20
    bench.close()
    assert len(bench.log.ticks("/truth/attitude")) == 20
