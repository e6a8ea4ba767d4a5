"""MAV_CMD_INJECT_FAILURE on the plant: what each unit and type stands for, instances, magnitudes, and every refusal."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from bus.clock import SystemClock
from bus.mavlink.endpoint import Endpoint
from bus.run import GroundConfig
from plant_server.faults import KINDS, make_fault
from plant_server.faults.effects import WheelDisturbance
from plant_server.faults.timeline import FaultTimeline
from plant_server.ground import open_ground
from plant_server.ground.catalogue import make_sample
from plant_server.ground.desk import NOT_ALLOWED
from plant_server.ground.failures import (
    BOTH,
    INSTANCES,
    SETTINGS,
    TABLE,
    TELEMETRY_KINDS,
    TYPE_NAMES,
    UNIT_NAMES,
)
from tools.design.mavlink_faults import PAGE, format_page
from tools.run.bench import Bench

BARE = ["duration_s=20", "faults=[]", "expect=[]"]
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
PLANT = (1, 25)
NAN = math.nan


class Stock:
    """A ground program that knows pymavlink's own common dialect and nothing of ours."""

    def __init__(self, directory: Path, bench: Bench) -> None:
        self.endpoint = Endpoint(directory / "stock.sock", 255, 190)
        self.bench = bench
        self._socket = self.endpoint._socket
        self._to = str(directory / "plant.sock")
        self._out, self._in = common.MAVLink(None, 255, 190), common.MAVLink(None)

    def send(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._out), self._to)
        self._out.seq = (self._out.seq + 1) % 256

    def hear(self) -> list[Any]:
        """Everything that has come and that the stock dialect knows."""
        found: list[Any] = []
        while True:
            try:
                datagram = self._socket.recv(65536)
            except BlockingIOError:
                return found
            found += self._in.parse_buffer(datagram) or []

    def inject(self, *params: float, confirmation: int = 0) -> tuple[list[int], str]:
        """Send 420 and run a tick; return the results that came, and what was said to it."""
        given = (*params, *[NAN] * (7 - len(params)))
        self.send(common.MAVLink_command_long_message(*PLANT, 420, confirmation, *given))
        self.bench.step()
        heard = self.hear()
        results = [m.result for m in heard if m.get_type() == "COMMAND_ACK"]
        return results, "".join(m.text for m in heard if m.get_type() == "STATUSTEXT")

    def set_parameter(self, name: str, value: float) -> float:
        """Set one; return what is echoed."""
        self.send(common.MAVLink_param_set_message(*PLANT, name.encode(), value, 9))
        self.bench.step()
        (echo,) = [m for m in self.hear() if m.get_type() == "PARAM_VALUE"]
        assert echo.param_id == name
        return float(echo.param_value)

    def list_faults(self) -> list[tuple[str, str, str]]:
        """Unit, kind and state of all faults."""
        return [(item.fault.unit, item.fault.kind, item.state) for item in self.bench.plant_node.plant.list_faults()]

    def list_active(self) -> list[tuple[str, str]]:
        return [(unit, kind) for unit, kind, state in self.list_faults() if state == "active"]


@contextmanager
def link(scenario: str = "zhang2018", overrides: tuple[str, ...] = (), *, inject: bool = True) -> Iterator[Stock]:
    """A stock ground program on the link of a bench's plant."""
    bench = Bench.open(scenario, [*BARE, *overrides], log="memory")
    with tempfile.TemporaryDirectory(prefix="hs-", dir="/tmp") as name:
        ground = open_ground(bench.plant_node, GroundConfig(socket=f"{name}/plant.sock", inject=inject), SystemClock())
        end = Stock(Path(name), bench)
        try:
            yield end
        finally:
            ground.close()
            end.endpoint.close()
            bench.close()


# -- the table -----------------------------------------------------------------------------------------------------


def test_numbers_are_those_of_the_stock_dialect() -> None:
    """Where pymavlink knows a unit or a type by name, it is the same name; newer ones it does not know."""
    for enum, prefix, names in (
        ("FAILURE_UNIT", "FAILURE_UNIT_", UNIT_NAMES),
        ("FAILURE_TYPE", "FAILURE_TYPE_", dict(enumerate(TYPE_NAMES))),
    ):
        known = common.enums[enum]
        for number, name in names.items():
            if number in known and not known[number].name.endswith("ENUM_END"):
                assert known[number].name == prefix + name


def test_each_pair_stands_for_one_kind() -> None:
    """No two kinds claim one unit and type, none claims a unit of another family, and each claim is honoured."""
    claims = [(pair, cls) for kinds in KINDS.values() for cls in kinds.values() for pair in cls.failures]
    assert len({pair for pair, _ in claims}) == len(claims)
    assert {pair: failure.effect for pair, failure in TABLE.items()} == dict(claims)
    named = {given for f in TABLE.values() for given in f.magnitudes.values() if isinstance(given, str)}
    assert named <= {setting.name for setting in SETTINGS}


@pytest.mark.parametrize("kind", KINDS["wheel"])
def test_a_wheels_kinds_are_of_the_motor_or_of_the_telemetry(kind: str) -> None:
    """By what they change of a wheel: telemetry kinds what it reports, the others what it does, one both."""
    magnitudes = {key: v for key, v in vars_of(make_sample(KINDS["wheel"][kind])).items() if v is not None}
    timeline = FaultTimeline(
        (make_fault(unit="wheel.1", kind=kind, at_s=0.0, **magnitudes),), step_s=0.1, steps_per_tick=1, seed=1
    )
    chain = timeline.chains["wheel.1"]
    chain.refresh(0)
    changed = set()
    for step in range(300):
        wheel, healthy = WheelDisturbance(), WheelDisturbance()
        chain.active[0].bring_to((step + 0.5) * 0.1, 10.0)
        chain.active[0].effect.disturb(wheel, chain.active[0].now)
        changed |= {name for name in WheelDisturbance.__slots__ if getattr(wheel, name) != getattr(healthy, name)}
    reports = {
        name
        for name in changed
        if name.startswith(("speed_", "current_", "late_", "counter_")) or name in ("silent", "tlm_random", "half_rate")
    }
    assert changed
    assert bool(reports) == (kind in TELEMETRY_KINDS)
    assert bool(changed - reports) == (kind not in TELEMETRY_KINDS or kind in BOTH)


def vars_of(effect: Any) -> dict[str, Any]:
    return {name: getattr(effect, name) for name in effect.__dataclass_fields__}


@pytest.mark.parametrize("pair", sorted(TABLE), ids=lambda pair: f"{pair[0]}-{pair[1]}")
def test_every_pair_acts_on_the_tick_before_which_it_came(pair: tuple[int, int]) -> None:
    """By default magnitudes and as MAVSDK sends it (NaN behind the instance): one ACK, one fault, its onset on that tick.

    It really changes something of its unit within the ten seconds after, on a bench whose wheels have motors.
    """
    with link("ithaco-hold") as end:
        end.bench.step(10)
        assert end.inject(*pair, 1) == ([ACCEPTED], "")
        end.bench.step(100)
        records = [record for record in end.bench.log.faults if record["phase"] in ("onset", "effect")]
        first = INSTANCES[pair[0]][0]
        assert [(r["unit"], r["fault"], r["phase"]) for r in records] == [
            (first, TABLE[pair].effect.kind, phase) for phase in ("onset", "effect")
        ]
        assert records[0]["tick"] == 10
        (said,) = [e["message"] for e in end.bench.log.events if e["message"].startswith("fault.add")]
        assert "fault.add by MAVLink 255/190 at tick 10: command[0]" in said


def test_what_is_not_implemented_is_unsupported_and_said() -> None:
    """Every other pair of small numbers, and numbers that are none; nothing is set by any of them."""
    pairs: list[tuple[float, float]] = [
        (unit, type)
        for unit in (*range(12), *range(99, 113), 255, 1e9)
        for type in (*range(1, 12), 99)
        if (unit, type) not in TABLE
    ]
    pairs += [(NAN, 1), (101, NAN), (101.5, 1), (101, 1.5), (math.inf, 1), (-1, 1), (101, -1), (-0.5, 0), (3, 0)]
    with link() as end:
        for pair in pairs:
            results, said = end.inject(*pair, 1)
            assert results == [UNSUPPORTED]
            assert said.startswith("420: ")
            assert "not implemented here" in said
        assert end.list_faults() == []


# -- the gate, instances -------------------------------------------------------------------------------------------


def test_a_run_that_takes_no_faults_denies_all_and_says_why() -> None:
    """Whatever is asked, clearing too; the parameter that tells is 0 and cannot be set."""
    with link(overrides=("faults=[{unit: wheel.1, kind: dead, at_s: 0}]",), inject=False) as end:
        for params in ((101, 1, 1), (101, 0, 0), (101, 99, 0), (3, 1, 0)):
            assert end.inject(*params) == ([DENIED], f"420: {NOT_ALLOWED}")
        assert end.list_active() == [("wheel.1", "dead")]
        assert end.set_parameter("FLT_ENABLE", 1.0) == 0.0
        assert end.inject(101, 1, 1)[0] == [DENIED]
    with link() as end:
        assert end.set_parameter("FLT_ENABLE", 0.0) == 1.0


@pytest.mark.parametrize(
    ("params", "wheels"),
    [
        ((0,), (1, 2, 3, 4)), ((0, NAN), (1, 2, 3, 4)), ((-0.0,), (1, 2, 3, 4)), ((NAN, NAN), (1, 2, 3, 4)), ((3,), (3,)),
        ((4, 1), (4,)), ((NAN, 1), (1,)), ((NAN, 10), (2, 4)), ((NAN, 15), (1, 2, 3, 4)),
    ],
)  # fmt: skip
def test_instances_are_counted_from_1_and_a_mask_counts_where_there_is_none(
    params: tuple[float, ...], wheels: tuple[int, ...]
) -> None:
    """Parameter 3: 0 is all; parameter 4, bit 0 the first, only where parameter 3 is NaN."""
    with link() as end:
        assert end.inject(101, 1, *params)[0] == [ACCEPTED]
        assert end.list_active() == [(f"wheel.{i}", "dead") for i in wheels]


@pytest.mark.parametrize(
    "params",
    [
        (5,),
        (-1,),
        (1.5,),
        (1e38,),
        (math.inf,),
        (-math.inf,),
        (NAN, 0),
        (NAN, 16),
        (NAN, 1.5),
        (NAN, -1),
        (NAN, math.inf),
    ],
)
def test_an_instance_that_is_not_there_is_denied_and_said(params: tuple[float, ...]) -> None:
    """With how many there are."""
    with link() as end:
        results, said = end.inject(101, 1, *params)
        assert results == [DENIED]
        assert said.endswith("no such instance; there are 1 to 4, 0 for all")
        assert end.list_faults() == []


def test_by_command_int_as_well() -> None:
    """The same command in the other message."""
    with link() as end:
        end.send(common.MAVLink_command_int_message(*PLANT, 0, 420, 0, 0, 0, 2, 3, NAN, 0, 0, NAN))
        end.bench.step()
        assert [m.result for m in end.hear() if m.get_type() == "COMMAND_ACK"] == [ACCEPTED]
        assert end.list_active() == [("gyro.z", "stuck")]


# -- clearing, replacing -------------------------------------------------------------------------------------------


def test_ok_clears_what_is_of_that_unit_whoever_set_it() -> None:
    """101 the faults of the wheel's torque, 106 those of its telemetry; those of other wheels and units stay."""
    faults = "faults=[{unit: wheel.1, kind: bias_torque, at_s: 0}, {unit: gyro.x, kind: dead, at_s: 5}]"
    with link(overrides=(faults,)) as end:
        for params in ((101, 4, 1), (106, 2, 1), (101, 1, 2), (0, 1, 2)):
            assert end.inject(*params)[0] == [ACCEPTED]
        end.bench.inject(unit="wheel.1", kind="total_failure")
        end.bench.step()
        assert end.inject(101, 0, 1)[0] == [ACCEPTED]
        assert end.list_active() == [("wheel.1", "tach_freeze"), ("wheel.2", "dead"), ("gyro.y", "dead")]
        assert end.inject(106, 0, 1)[0] == [ACCEPTED]
        assert end.inject(0, 0, 0)[0] == [ACCEPTED]
        assert end.list_active() == [("wheel.2", "dead")]
        assert ("gyro.x", "dead", "over") in end.list_faults()  # one that waited
        assert end.inject(0, 0, 0)[0] == [ACCEPTED]


def test_a_fault_of_all_axes_is_not_cleared_on_one_of_them() -> None:
    """It is one fault: FAILED with what to do; with all axes it goes."""
    with link(overrides=("faults=[{unit: gyro, kind: dead, at_s: 0}]",)) as end:
        results, said = end.inject(0, 0, 1)
        assert results == [FAILED]
        assert "faults[0] is on gyro.x, gyro.y, gyro.z as one; clear them together, with instance 0" in said
        assert end.inject(0, 0, 0)[0] == [ACCEPTED]
        assert end.list_active() == []


def test_a_failure_takes_the_place_of_the_one_before_it() -> None:
    """Of the same unit and instance and by this command: a motor is stuck or weak, not both; all other faults stay."""
    with link(overrides=("faults=[{unit: wheel.1, kind: bias_torque, at_s: 0}]",)) as end:
        for params in ((101, 4, 1), (101, 2, 1), (106, 1, 1), (101, 2, 1)):
            assert end.inject(*params)[0] == [ACCEPTED]
        assert end.list_active() == [("wheel.1", "bias_torque"), ("wheel.1", "silent"), ("wheel.1", "stuck_torque")]
        assert len(end.list_faults()) == 5


def test_a_command_repeated_for_want_of_the_answer_is_answered_and_not_done_again() -> None:
    """confirmation above 0 with the same parameters, NaN and all."""
    with link() as end:
        assert end.inject(101, 1, 1)[0] == [ACCEPTED]
        for confirmation in (1, 2):
            assert end.inject(101, 1, 1, confirmation=confirmation)[0] == [ACCEPTED]
        assert len(end.list_faults()) == 1


# -- magnitudes ----------------------------------------------------------------------------------------------------


def test_parameters_have_the_magnitudes() -> None:
    """Each that the table names changes the fault that is set next, and nothing that is there."""
    for setting in SETTINGS:
        pairs = [pair for pair, failure in TABLE.items() if setting.name in failure.magnitudes.values()]
        if not pairs:
            continue
        (key,) = [key for key, given in TABLE[pairs[0]].magnitudes.items() if given == setting.name]
        value = 7.0 if setting.name == "FLT_DELAY_TICKS" else 0.25 * setting.high + 0.001
        with link() as end:
            assert end.inject(*pairs[0], 1)[0] == [ACCEPTED]
            assert end.set_parameter(setting.name, value) == pytest.approx(value, rel=1e-6)
            assert end.inject(*pairs[0], 1)[0] == [ACCEPTED]
            before, after = (item.fault.plain_settings()[key] for item in end.bench.plant_node.plant.list_faults())
            assert before == setting.value
            assert after == pytest.approx(value, rel=1e-6)


def test_a_magnitude_that_changes_nothing_is_refused_with_the_reason() -> None:
    """A drift to 0 N m: FAILED, all instances or none; a value out of range is not stored."""
    with link() as end:
        assert end.set_parameter("FLT_DRIFT_NM", 0.0) == 0.0
        results, said = end.inject(101, 8, 0)
        assert results == [FAILED]
        assert said.startswith("420: 101 SYSTEM_MOTOR, 8 DRIFT: kind: a bias of 0 N m has no effect")
        assert end.list_faults() == []
        assert end.set_parameter("FLT_DELAY_TICKS", 1.5) == 5.0  # a whole number, as its text says
        assert end.set_parameter("FLT_WRONG", 1.0) == pytest.approx(0.6)


# -- page ----------------------------------------------------------------------------------------------------------


def test_the_page_is_up_to_date() -> None:
    """docs/mavlink-faults.md is what `python -P -m tools.design.mavlink_faults` writes."""
    assert PAGE.read_text(encoding="utf-8") == format_page()
