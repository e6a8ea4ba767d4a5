"""The flight software as a MAVLink vehicle, with stock pymavlink as the ground: what it says, and what it obeys."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav

from bus.attitude import angle_between
from bus.units import DEG
from fsw.modes import Mode
from tools.log.mcap_reader import Run
from tools.replay.compare import compare_replay
from tools.replay.flight_again import FlightAgain

TURNED = [math.cos(2.5 * DEG), 0.0, 0.0, math.sin(2.5 * DEG)]  # 5 degrees about z


def of(messages: list[Any], *types: str) -> list[Any]:
    """The messages of these types."""
    return [message for message in messages if message.get_type() in types]


def texts(messages: list[Any]) -> str:
    """All words that were said, put together."""
    return "".join(("" if message.chunk_seq else "\n") + message.text for message in of(messages, "STATUSTEXT"))


# -- what the vehicle says ---------------------------------------------------------------------------------------------


def test_heartbeat_says_what_it_is_and_which_mode_once_a_second(vehicle: Any) -> None:
    """Type spacecraft, generic autopilot, armed and pointing; ten heartbeats in ten seconds of wall time."""
    vehicle.station.heard.clear()
    for _ in range(10):
        vehicle.station.heartbeat()
        vehicle.step(100)
    beats = of(vehicle.station.heard, "HEARTBEAT")
    assert len(beats) == 10
    last = beats[-1]
    assert (last.get_srcSystem(), last.get_srcComponent(), last.type, last.autopilot) == (1, 1, 45, 0)
    assert last.base_mode == mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_HIL_ENABLED | 128
    assert (last.custom_mode, last.system_status) == (Mode.POINT, mav.MAV_STATE_ACTIVE)


def test_nobody_there_is_said_nothing(make_vehicle: Any) -> None:
    """Without a heartbeat of the ground not one message is sent."""
    vehicle = make_vehicle()
    assert vehicle.step(300) == []
    assert vehicle.ground.component.endpoint.counters.sent == 0


def test_streams_carry_what_the_flight_knows(vehicle: Any) -> None:
    """Attitude, target and wheels as in the telemetry of the same bench, at the rates that are usual."""
    heard = vehicle.step(100)
    counts = {kind: len(of(heard, kind)) for kind in ("ATTITUDE_QUATERNION", "ESC_STATUS", "SYS_STATUS", "SYSTEM_TIME")}
    assert counts == {"ATTITUDE_QUATERNION": 10, "ESC_STATUS": 5, "SYS_STATUS": 1, "SYSTEM_TIME": 1}
    flight = vehicle.flight
    estimate, speeds = flight.detection.estimate, [wheel.speed_rad_s for wheel in flight.inputs.sensors.wheels]
    asked = {31: "ATTITUDE_QUATERNION", 83: "ATTITUDE_TARGET", 291: "ESC_STATUS", 2: "SYSTEM_TIME", 1: "SYS_STATUS"}
    for number in asked:
        vehicle.station.command(mav.MAV_CMD_REQUEST_MESSAGE, number, *[math.nan] * 6)
    heard = vehicle.step()
    attitude, target, wheels, time, status = [of(heard, name)[0] for name in asked.values()]
    assert [attitude.q1, attitude.q2, attitude.q3, attitude.q4] == pytest.approx(estimate.q_ib, abs=1e-7)
    assert attitude.yawspeed == pytest.approx(estimate.omega_bi_b_rad_s[2], rel=1e-6)
    assert list(target.q) == pytest.approx(flight.guidance.target.q_it, abs=1e-7)
    assert list(wheels.rpm) == [round(speed * 60.0 / (2.0 * math.pi)) for speed in speeds]
    assert time.time_boot_ms == (vehicle.bench.tick - 2) * 100  # of simulated time
    well = mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    assert status.onboard_control_sensors_health & well == well
    assert len(of(heard, "COMMAND_ACK")) == 5


def test_every_mode_is_listed_and_the_current_one_told(vehicle: Any) -> None:
    """AVAILABLE_MODES 1..5 with names as in the log; degraded cannot be chosen; CURRENT_MODE is the heartbeat's."""
    vehicle.station.command(mav.MAV_CMD_REQUEST_MESSAGE, 435, 0)
    modes = of(vehicle.step(2), "AVAILABLE_MODES")
    assert [(m.mode_index, m.number_modes, m.custom_mode) for m in modes] == [(i + 1, 5, i) for i in range(5)]
    assert [m.mode_name for m in modes] == ["standby", "detumble", "point", "safe", "degraded"]
    assert [m.properties for m in modes] == [0, 0, 0, 0, mav.MAV_MODE_PROPERTY_NOT_USER_SELECTABLE]
    vehicle.station.command(mav.MAV_CMD_REQUEST_MESSAGE, 435, 3)
    assert [m.custom_mode for m in of(vehicle.step(2), "AVAILABLE_MODES")] == [2]
    vehicle.station.command(mav.MAV_CMD_REQUEST_MESSAGE, 436)
    assert [m.custom_mode for m in of(vehicle.step(2), "CURRENT_MODE")] == [2]


# -- modes -------------------------------------------------------------------------------------------------------------


def test_modes_are_commanded_and_told(vehicle: Any) -> None:
    """Safe, standby, point: each entered on the next tick, said in words, in the heartbeat, and back again."""
    assert vehicle.flight.modes.mode is Mode.POINT
    assert vehicle.ask(176, 1, 3) == mav.MAV_RESULT_ACCEPTED
    assert vehicle.flight.modes.mode is Mode.SAFE
    heard = vehicle.step(150)
    assert "mode safe: commanded" in texts(vehicle.station.heard)
    beat = of(heard, "HEARTBEAT")[-1]
    assert (beat.custom_mode, beat.system_status) == (3, mav.MAV_STATE_EMERGENCY)
    assert vehicle.ask(400, 0) == mav.MAV_RESULT_ACCEPTED
    assert vehicle.flight.modes.mode is Mode.STANDBY
    vehicle.station.heartbeat()
    beat = of(vehicle.step(120), "HEARTBEAT")[-1]
    assert (beat.base_mode & 128, beat.system_status) == (0, mav.MAV_STATE_STANDBY)
    assert vehicle.flight.wheel_commands.modes == (0, 0, 0, 0)
    assert vehicle.ask(400, 1) == mav.MAV_RESULT_ACCEPTED
    vehicle.step(2)
    assert vehicle.flight.modes.mode is Mode.POINT


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ((176, 1, 4), "mode 4 cannot be commanded"),
        ((176, 1, math.nan), "mode -1 cannot be commanded"),
        ((176, 0, 2), "DO_SET_MODE refused"),
        ((176, 1, 1e38), "cannot be commanded"),
        ((400, 0.5), "ARM_DISARM refused"),
    ],
)
def test_modes_that_there_are_not_are_denied_with_why(vehicle: Any, params: tuple[float, ...], words: str) -> None:
    """DENIED and a STATUSTEXT; the mode stays."""
    assert vehicle.ask(*params, ticks=2) == mav.MAV_RESULT_DENIED
    assert words in texts(vehicle.station.heard)
    assert vehicle.flight.modes.mode is Mode.POINT


def test_pointing_without_an_attitude_is_rejected_for_now(make_vehicle: Any) -> None:
    """Before the star tracker has spoken: TEMPORARILY_REJECTED, and the reason in words."""
    vehicle = make_vehicle("nominal", "fsw.modes.initial=standby")
    vehicle.station.heartbeat()
    vehicle.station.command(176, 1, 2)
    heard = vehicle.step(2)
    assert [m.result for m in of(heard, "COMMAND_ACK")] == [mav.MAV_RESULT_TEMPORARILY_REJECTED]
    assert "there is no attitude to point with" in texts(heard)


def test_failures_are_not_the_vehicles_business(vehicle: Any) -> None:
    """MAV_CMD_INJECT_FAILURE to the flight software: UNSUPPORTED."""
    assert vehicle.ask(420, 101, 1, 1) == mav.MAV_RESULT_UNSUPPORTED


# -- targets -----------------------------------------------------------------------------------------------------------


def point(mask: int, q: list[float], rate: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    """SET_ATTITUDE_TARGET."""
    return mav.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, *rate, 0.0)


def test_an_attitude_is_slewed_to_at_the_rate_of_the_parameter(vehicle: Any) -> None:
    """5 degrees about z at 0.2 deg/s and 0.01 deg/s2 take 5/0.2 + 0.2/0.01 = 45 s; repeated all the time, no longer."""
    for _ in range(46):
        vehicle.station.send(point(7, TURNED))
        vehicle.station.heartbeat()
        vehicle.step(10)
    target = vehicle.flight.guidance.target
    assert target.at_rest
    assert angle_between(target.q_it, tuple(TURNED)) < 1e-6
    vehicle.step(1000)
    assert vehicle.bench.truth.error_deg < 0.05
    assert len([e for e in vehicle.events() if "command target.slew (ground) obeyed" in e]) == 1


def test_without_a_rate_limit_an_attitude_is_a_step(vehicle: Any) -> None:
    """SLEW_MAX_DEG_S 0: the target is there on the tick of the command."""
    vehicle.station.send(mav.MAVLink_param_set_message(1, 1, b"SLEW_MAX_DEG_S", 0.0, 9))
    vehicle.step()
    vehicle.station.send(point(7, TURNED))
    vehicle.step()
    assert angle_between(vehicle.flight.guidance.target.q_it, tuple(TURNED)) < 1e-6


def test_a_rate_is_turned_at_and_stopped(vehicle: Any) -> None:
    """0.002 rad/s about x, masked axes count as zero; then zero rate: the target rests where it is."""
    vehicle.station.send(point(128 | 2 | 4, [math.nan] * 4, (0.002, math.nan, 7.0)))
    vehicle.step(600)
    target = vehicle.flight.guidance.target
    assert target.omega_ti_t_rad_s == pytest.approx((0.002, 0.0, 0.0), abs=1e-9)
    assert vehicle.flight.detection.estimate.omega_bi_b_rad_s[0] == pytest.approx(0.002, abs=2e-4)
    vehicle.station.send(point(128, [1, 0, 0, 0]))
    vehicle.step(300)
    assert vehicle.flight.guidance.target.at_rest


def test_an_attitude_with_a_rate_is_a_track(vehicle: Any) -> None:
    """From that attitude on the target turns at that rate."""
    vehicle.station.send(point(0, TURNED, (0.0, 0.001, 0.0)))
    vehicle.step()
    assert angle_between(vehicle.flight.guidance.target.q_it, tuple(TURNED)) < 1e-6
    assert vehicle.flight.guidance.target.omega_ti_t_rad_s == pytest.approx((0.0, 0.001, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (point(7, [math.nan, 0, 0, 0]), "the quaternion is not of unit length"),
        (point(7, [0, 0, 0, 0]), "the quaternion is not of unit length"),
        (point(7, [1, 1, 0, 0]), "the quaternion is not of unit length"),
        (point(7, [3e38, 3e38, 0, 0]), "the quaternion is not of unit length"),
        (point(128, [1, 0, 0, 0], (math.inf, 0, 0)), "a rate is no number"),
        (point(128, [1, 0, 0, 0], (0.1, 0, 0)), "5.73 deg/s is above modes.detumble_above_deg_s = 5 deg/s"),
        (point(128, [1, 0, 0, 0], (3e38, 0, 0)), "is out of reach"),
        (point(135, [1, 0, 0, 0]), "its mask leaves nothing to do"),
    ],
)
def test_targets_that_cannot_be_are_refused_in_words(vehicle: Any, message: Any, words: str) -> None:
    """The target stays, and the reason is said."""
    before = vehicle.flight.guidance.target.q_it
    vehicle.station.send(message)
    vehicle.step(3)
    assert words in texts(vehicle.station.heard)
    assert vehicle.flight.guidance.target.q_it == before


# -- determinism -------------------------------------------------------------------------------------------------------


def test_what_the_ground_said_is_replayed(vehicle: Any) -> None:
    """A flight with modes, targets and numbers from the ground, flown again from its log: not one bit differs."""
    station = vehicle.station
    station.send(point(7, TURNED))
    vehicle.step(200)
    station.send(mav.MAVLink_param_set_message(1, 1, b"STALE_TICKS", 9.0, 9))
    vehicle.step(50)
    vehicle.ask(176, 1, 3)
    vehicle.step(100)
    vehicle.ask(176, 1, 2)
    station.send(mav.MAVLink_param_set_message(1, 1, b"LAW_K1", 5.0, 9))
    vehicle.step(100)
    station.send(point(128, [1, 0, 0, 0], (0.001, 0.0, 0.001)))
    vehicle.step(300)
    bench = vehicle.bench
    run: Run = bench.log
    again = FlightAgain(bench.resolved.scenario.fsw, bench.tick_ns, bench.resolved.run_hash)
    outcome = compare_replay(run, again, bench.tick_ns)
    assert outcome.first is None
    assert outcome.ticks == bench.tick
    assert again.feeder.flight.inputs.hold_ticks == 9
