"""Every sign and axis that the ICD states, measured on the running plant from its frames, beside the text that states it.

The oracle is mechanics: a torque on the body about an axis turns the body about it, and the rotor takes the reaction.
The text is that of the DBC; what is measured comes from the plant through its frames, read by cantools.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from struct import Struct
from typing import Any

import cantools
import numpy as np
import pytest

from bus.icd.codec import encode_CYCLE_DONE, encode_rw_cmds
from bus.icd.messages import IDS, dbc_path
from bus.settings import build
from plant_server.channel import Channel
from plant_server.config import PlantConfig
from plant_server.plant import Plant

DATABASE: Any = cantools.database.load_file(dbc_path())
FRAME = Struct("=IB3x8s")
TICK_S = 0.1
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [3**-0.5] * 3])
OFF, TORQUE = 0, 1
Frames = dict[str, dict[str, float]]


class Rig:
    """A plant at rest with four wheels and ideal units, driven and read through its frames only."""

    def __init__(self, **settings: Any) -> None:
        body = {"inertia_kgm2": [[50, 0, 0], [0, 40, 0], [0, 0, 30]], **settings.pop("body", {})}
        wheel = settings.pop("wheel", {})
        data = {
            "body": body,
            "wheels": [{"mount": mount, "max_torque_nm": 10.0, **wheel} for mount in ("x", "y", "z", "skew")],
            "star_tracker": {"rate_hz": 10.0, **settings.pop("star_tracker", {})},
            **settings,
        }
        self.server = Channel(Plant(build(PlantConfig, data, "test"), (), TICK_S, 1), TICK_S, 1)

    def tick(self, torque_nm: tuple[float, ...] = (), mode: int = TORQUE, behind: int = 0) -> Frames:
        """What the units say at this tick, after which the wheels get these commands (none: no frames)."""
        server = self.server
        said = {}
        for can_id, _, data in FRAME.iter_unpack(server.announce()):
            message = DATABASE.get_message_by_frame_id(can_id)
            said[message.name] = message.decode(data, decode_choices=False)
        if torque_nm:
            a, b, c, d = torque_nm
            counter, tick = server.tick % 15, server.tick
            batch = encode_rw_cmds(counter, (mode,) * 4, (a, b, c, d), (tick - behind) & 0xFF)
            server.accept(batch + encode_CYCLE_DONE(counter, 2, tick, 0))
        server.advance()
        return said

    def after(self, torque_nm: tuple[float, ...], **how: int) -> Frames:
        """What the units say after one tick of these commands."""
        self.tick(torque_nm, **how)
        return self.tick(torque_nm, **how)


def one(wheel: int, value: float) -> tuple[float, ...]:
    return tuple(value if k == wheel else 0.0 for k in range(4))


def rates(said: Frames) -> np.ndarray[Any, Any]:
    return np.array([said[f"FOG{axis}_RATE"]["RATE"] for axis in "XYZ"])


def measure_torque(wheel: int) -> None:
    """A positive command turns the body right-handed about the wheel's axis, by the torque over the inertia."""
    rate = rates(Rig().after(one(wheel, 0.05)))
    expected = np.linalg.solve(np.diag([50.0, 40.0, 30.0]), AXES[wheel] * 0.05 * TICK_S)
    assert rate == pytest.approx(expected, rel=0.01, abs=1e-8)
    assert rate @ AXES[wheel] > 0.0


def measure_speed(wheel: int) -> None:
    """The rotor takes the reaction: its speed falls by torque over rotor inertia (0.01), and carries momentum -H."""
    said = Rig().after(one(wheel, 0.05))
    speeds = [said[f"RW{k + 1}_TLM"]["SPEED"] for k in range(4)]
    assert speeds[wheel] == pytest.approx(-0.05 * TICK_S / 0.01, rel=0.01)
    assert max(abs(speeds[k]) for k in range(4) if k != wheel) < 0.002
    spun = Rig(wheel={"speed_rad_s": 100.0}).server
    assert np.array(spun.plant.truth().h_total_i_nms) == pytest.approx(
        AXES.sum(axis=0) * 0.01 * 100.0
    )  # right-handed, total


def measure_current(wheel: int) -> None:
    """Positive with the torque on the body: torque over the motor constant (0.05 N m/A), after either sign."""
    for torque_nm in (0.05, -0.05):
        assert Rig().after(one(wheel, torque_nm))[f"RW{wheel + 1}_TLM"]["CURRENT"] == round(torque_nm / 0.05 * 1000)


def measure_mode(wheel: int) -> None:
    """Off is zero torque, whatever TORQUE says."""
    said = Rig().after(one(wheel, 0.05), mode=OFF)
    assert (said[f"RW{wheel + 1}_TLM"]["SPEED"], said[f"RW{wheel + 1}_TLM"]["CURRENT"]) == (0, 0)


def measure_wheel_status(wheel: int) -> None:
    """0 with commands, 2 for want of them, 3 where the torque would take the rotor beyond its limit."""
    name = f"RW{wheel + 1}_TLM"
    assert Rig().after(one(wheel, 0.05))[name]["STATUS"] == 0
    assert Rig().after(())[name]["STATUS"] == 2
    fast = Rig(wheel={"speed_rad_s": 100.0, "max_speed_rad_s": 100.1})
    said = fast.after(one(wheel, -0.5))
    assert (said[name]["STATUS"], said[name]["CURRENT"]) == (3, 0)
    assert said[name]["SPEED"] == pytest.approx(100.0, abs=0.01)


def measure_rate(axis: int) -> None:
    """A body that turns right-handed about +axis has that rate."""
    turn = [0.0, 0.0, 0.0]
    turn[axis] = 2.0
    assert rates(Rig(body={"rate_deg_s": turn}).tick()) == pytest.approx(np.radians(turn), abs=1e-6)


def measure_mean(axis: int) -> None:
    """From rest at constant torque the mean over a tick is half the rate at its end, which the ideal gyro gives."""
    noise = dict.fromkeys(("arw_rad_sqrt_s", "bias_instability_rad_s", "rrw_rad_s_sqrt_s", "angle_lsb_rad"), 0.0)
    settings = {"preset": "space", "scale_factor": [0, 0, 0], **noise}
    ideal, real = (rates(Rig(gyro=gyro, step_s=0.01).after(one(axis, 0.05))) for gyro in ({}, settings))
    assert real[axis] == pytest.approx(ideal[axis] / 2, rel=0.01)


def measure_gyro_status(axis: int) -> None:
    """2 and the limit, with its sign, where the rate is beyond the range."""
    turn = [0.0, 0.0, 0.0]
    turn[axis] = -2.0
    rig = Rig(body={"rate_deg_s": turn}, gyro={"range_rad_s": 0.01})
    rig.tick()
    said = rig.tick()[f"FOG{'XYZ'[axis]}_RATE"]
    assert (said["STATUS"], said["RATE"]) == (2, pytest.approx(-0.01))
    calm = Rig()
    assert calm.tick()[f"FOG{'XYZ'[axis]}_RATE"]["STATUS"] == 0


def measure_quaternion(axis: int) -> None:
    """From identity, a turn by +theta about body axis k gives (cos, sin at k): v_i = R(q) v_b, scalar first.

    The right-hand rule: with theta = 90 deg about z, body x points along inertial y.
    """
    turn = [0.0, 0.0, 0.0]
    turn[axis] = 90.0
    rig = Rig(body={"rate_deg_s": turn}, gyro={"range_rad_s": 2.1})
    for _ in range(10):
        rig.tick()
    said = rig.tick()
    q = np.array([*(said["STR_QA"][k] for k in ("Q0", "Q1")), *(said["STR_QB"][k] for k in ("Q2", "Q3"))])
    expected = np.zeros(4)
    expected[0] = expected[1 + axis] = math.sqrt(0.5)
    assert q == pytest.approx(expected, abs=1e-4) or q == pytest.approx(-expected, abs=1e-4)
    w, v = q[0], q[1:]
    before, after = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]  # about x: y -> z
    assert before + 2 * np.cross(v, np.cross(v, before) + w * before) == pytest.approx(after, abs=1e-3)


def measure_age(_: int) -> None:
    """Ticks since the measurement: those of the latency; 15 while the tracker is blind."""
    late = Rig(star_tracker={"latency_s": 0.3})
    assert [late.tick() for _ in range(8)][-1]["STR_QA"]["AGE"] == 3
    blind = Rig(body={"rate_deg_s": [5, 0, 0]}, star_tracker={"max_rate_deg_s": 1.0})
    assert {blind.tick()["STR_QA"]["AGE"] for _ in range(3)} == {15}


def measure_sync_count(wheel: int) -> None:
    """Low byte of the tick, across the wrap; a command is taken with that of its data, not with an old one."""
    rig = Rig(command_max_age_ticks=2, command_timeout_ticks=1)
    for tick in range(260):
        said = rig.tick(one(wheel, 0.0))
        assert said["SYNC"]["TICK"] == tick
        assert said[f"RW{wheel + 1}_TLM"]["SYNC_CNT"] == said["FOGX_RATE"]["SYNC_CNT"] == tick % 256
    assert rig.after(one(wheel, 0.05), behind=2)[f"RW{wheel + 1}_TLM"]["CURRENT"] == 1000
    assert Rig(command_max_age_ticks=2).after(one(wheel, 0.05), behind=3)[f"RW{wheel + 1}_TLM"]["CURRENT"] == 0


WHEELS = {k: f"RW{k + 1}" for k in range(4)}
# signal -> what its comment says of sign, axis and meaning, and how that is measured
STATEMENTS: list[tuple[dict[int, str], str, str, Callable[[int], None]]] = [
    ({k: f"{w}_CMD" for k, w in WHEELS.items()}, "TORQUE", "Torque on the body about the wheel axis: positive turns the "
     "body right-handed about the axis", measure_torque),
    ({k: f"{w}_CMD" for k, w in WHEELS.items()}, "TORQUE", "and makes SPEED fall", measure_speed),
    ({k: f"{w}_CMD" for k, w in WHEELS.items()}, "MODE", "off is zero torque, whatever TORQUE says", measure_mode),
    ({k: f"{w}_CMD" for k, w in WHEELS.items()}, "SYNC_CNT", "Low byte of the tick", measure_sync_count),
    ({k: f"{w}_TLM" for k, w in WHEELS.items()}, "SPEED", "relative to the body, positive right-handed about the wheel "
     "axis; positive TORQUE makes it fall", measure_speed),
    ({k: f"{w}_TLM" for k, w in WHEELS.items()}, "CURRENT", "positive while the motor torque on the body is positive",
     measure_current),
    ({k: f"{w}_TLM" for k, w in WHEELS.items()}, "STATUS", "no_command gives no motor torque for want of a fresh command, "
     "speed_limit holds back a torque that would take the rotor beyond its limit", measure_wheel_status),
    ({k: f"{w}_TLM" for k, w in WHEELS.items()}, "SYNC_CNT", "Low byte of the tick", measure_sync_count),
    ({k: f"FOG{a}_RATE" for k, a in enumerate("XYZ")}, "RATE", "with respect to inertial about this body axis, positive "
     "right-handed", measure_rate),
    ({k: f"FOG{a}_RATE" for k, a in enumerate("XYZ")}, "RATE", "mean over the last tick; of the ideal gyro, the rate at "
     "its end", measure_mean),
    ({k: f"FOG{a}_RATE" for k, a in enumerate("XYZ")}, "STATUS", "out_of_range sends the limit of the gyro in place of a "
     "rate beyond it", measure_gyro_status),
    ({0: "STR_QA", 1: "STR_QB", 2: "STR_QB"}, "Q{}", "body in inertial space (v_i = R(q) v_b, Hamilton, scalar first), "
     "vector part", measure_quaternion),
    ({0: "STR_QA"}, "Q0", "scalar part", measure_quaternion),
    ({0: "STR_QA", 1: "STR_QB"}, "AGE", "Ticks since the measurement was taken", measure_age),
]  # fmt: skip
CASES = [
    pytest.param(
        message, signal.format(k + 1), text, measure, k, id=f"{message}.{signal.format(k + 1)}-{measure.__name__}"
    )
    for messages, signal, text, measure in STATEMENTS
    for k, message in messages.items()
]


@pytest.mark.parametrize(("message", "signal", "text", "measure", "unit"), CASES)
def test_what_the_icd_says_is_what_the_plant_does(
    message: str, signal: str, text: str, measure: Callable[[int], None], unit: int
) -> None:
    """The comment in the DBC has the statement, and the plant does it; either alone would let the other drift."""
    comment = DATABASE.get_message_by_name(message).get_signal_by_name(signal).comment
    assert text in comment
    measure(unit)


def test_every_signal_of_a_unit_is_in_the_table() -> None:
    """A signal added to wheels, gyro or star tracker needs its meaning measured too."""
    covered = {(case.values[0], case.values[1]) for case in CASES}
    elsewhere = (
        "_CURRENT_CMD",
        "_SPEED_CMD",
        "_TEMP",
        "_CTRL",
        "_POWER",
    )  # measured in tests/unit/test_wheel_frames.py
    units = [name for name in IDS if name.startswith(("RW", "FOG", "STR")) and not name.endswith(elsewhere)]
    signals = {(name, s.name) for name in units for s in DATABASE.get_message_by_name(name).signals[2:]}
    assert signals - covered == {(f"FOG{axis}_RATE", "SYNC_CNT") for axis in "XYZ"}  # measured with the wheels'
