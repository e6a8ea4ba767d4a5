"""What MAVLink's own command for breaking things means here: MAV_CMD_INJECT_FAILURE (420).

Unit and type are raw numbers of common.xml's FAILURE_UNIT and FAILURE_TYPE, as of July and August 2026 (mavlink#2524, #2543,
#2562); libraries know fewer of them. Which kind of fault stands for a pair is said by the kind itself (`failures` in
plant_server/faults/kinds); here stands what the command cannot say: the magnitudes, each a number or a parameter FLT_*.
docs/mavlink-faults.md is generated from this.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from bus.settings import NOTHING
from plant_server.faults import GYRO_AXES, KINDS, STAR_TRACKER, UNITS, WHEELS
from plant_server.faults.effects import Effect
from plant_server.faults.fault import magnitudes_of

GYRO, TRACKER, MOTOR, ESC, BUS = 0, 6, 101, 106, 109
OK, OFF, STUCK, GARBAGE, WRONG, SLOW, DELAYED, INTERMITTENT, DRIFT = range(9)
UNIT_NAMES: Final = {
    GYRO: "SENSOR_GYRO", TRACKER: "SENSOR_VIO", MOTOR: "SYSTEM_MOTOR", ESC: "SYSTEM_ESC", BUS: "SYSTEM_BUS_CAN",
}  # fmt: skip
TYPE_NAMES: Final = ("OK", "OFF", "STUCK", "GARBAGE", "WRONG", "SLOW", "DELAYED", "INTERMITTENT", "DRIFT")
# the units of ours that are instances 1, 2, ... of a unit of MAVLink
INSTANCES: Final = {
    GYRO: GYRO_AXES,
    TRACKER: (STAR_TRACKER,),
    MOTOR: WHEELS,
    ESC: WHEELS,
    BUS: tuple(unit for unit in UNITS if unit == "bus"),
}
FAMILY_OF: Final = {GYRO: "gyro", TRACKER: "star_tracker", MOTOR: "wheel", ESC: "wheel", BUS: "bus"}
# kinds of a wheel's fault that change what it reports; the others change what it does, one does both
TELEMETRY_KINDS: Final = frozenset(
    name
    for name, cls in KINDS["wheel"].items()
    if name == "silent" or cls.__module__.endswith((".wheel_node", ".wheel_telemetry"))
)
BOTH: Final = frozenset({"total_failure"})


@dataclass(frozen=True, slots=True)
class Setting:
    """One parameter: a magnitude of faults that are commanded by 420."""

    name: str
    value: float  # until it is set
    unit: str
    low: float
    high: float
    text: str


SETTINGS: Final = (
    Setting("FLT_WRONG", 0.6, "1", 0.0, 0.99, "share of its torque that a wrong motor gives"),
    Setting("FLT_STUCK_NM", 0.015, "N m", -1.0, 1.0, "torque that a stuck motor gives"),
    Setting("FLT_FRICTION_NM", 0.003, "N m", 0.0002, 0.01, "more friction of a slow motor"),
    Setting("FLT_WEAK", 0.0, "1", 0.0, 0.99, "share of its torque that an intermittent motor gives while it fails"),
    Setting("FLT_PERIOD_S", 4.0, "s", 0.1, 1000.0, "period of an intermittent motor, which fails for half of it"),
    Setting("FLT_DRIFT_NM", 0.01, "N m", -1.0, 1.0, "torque that a drifting motor adds in the end"),
    Setting("FLT_RISE_S", 60.0, "s", 0.0, 10000.0, "how long a drift of a motor or of its telemetry takes"),
    Setting("FLT_SCALE", 0.9, "1", -10.0, 10.0, "wrong telemetry: factor on the speed"),
    Setting(
        "FLT_DRIFT_RAD_S", 5.0, "rad/s", -1000.0, 1000.0, "drifting telemetry: what the speed is off by in the end"
    ),
    Setting("FLT_DELAY_TICKS", 5.0, "ticks", 1.0, 100.0, "delay of a wheel's telemetry, a whole number"),
    Setting("FLT_DELAY_S", 0.1, "s", 0.001, 10.0, "delay on the bus"),
    Setting("FLT_PROB", 0.5, "1", 0.001, 1.0, "share of frames or samples that an intermittent or garbled unit loses"),
    Setting("FLT_GYRO_RAD_S", 0.1, "rad/s", -2.0, 2.0, "what a wrong gyro adds; size of the spikes of a garbled one"),
    Setting("FLT_GYRO_RAMP", 0.001, "rad/s^2", -1.0, 1.0, "slope of a drifting gyro"),
)
# what 420 does not say, by unit and type: a number, or the parameter that has it; the rest is as the kind has it
MAGNITUDES: Final[dict[tuple[int, int], dict[str, float | str]]] = {
    (MOTOR, STUCK): {"torque_nm": "FLT_STUCK_NM"},
    (MOTOR, WRONG): {"effectiveness": "FLT_WRONG"},
    (MOTOR, SLOW): {"friction_nm": "FLT_FRICTION_NM"},
    (MOTOR, INTERMITTENT): {"effectiveness": "FLT_WEAK", "period_s": "FLT_PERIOD_S", "duty": 0.5},
    (MOTOR, DRIFT): {"torque_nm": "FLT_DRIFT_NM", "rise_s": "FLT_RISE_S"},
    (ESC, WRONG): {"factor": "FLT_SCALE"},
    (ESC, DELAYED): {"ticks": "FLT_DELAY_TICKS"},
    (ESC, INTERMITTENT): {"probability": "FLT_PROB"},
    (ESC, DRIFT): {"speed_rad_s": "FLT_DRIFT_RAD_S", "rise_s": "FLT_RISE_S"},
    (GYRO, GARBAGE): {"rate_rad_s": "FLT_GYRO_RAD_S", "probability": "FLT_PROB"},
    (GYRO, WRONG): {"rate_rad_s": "FLT_GYRO_RAD_S"},
    (GYRO, INTERMITTENT): {"probability": "FLT_PROB"},
    (GYRO, DRIFT): {"slope_rad_s2": "FLT_GYRO_RAMP"},
    (TRACKER, OFF): {"probability": 1.0},
    (TRACKER, INTERMITTENT): {"probability": "FLT_PROB"},
    (BUS, INTERMITTENT): {"probability": "FLT_PROB"},
    (BUS, DELAYED): {"delay_s": "FLT_DELAY_S"},
}


@dataclass(frozen=True, slots=True)
class Failure:
    """What one pair of unit and type stands for."""

    unit: int
    failure: int
    effect: type[Effect]
    magnitudes: dict[str, float | str]

    def make_fault(self, part: str, values: dict[str, float]) -> dict[str, Any]:
        """Return the fault on a unit of ours, keys as in a scenario; values: of the parameters."""
        fault: dict[str, Any] = {"unit": part, "kind": self.effect.kind}
        for key, given in self.magnitudes.items():
            value = values[given] if isinstance(given, str) else given
            fault[key] = round(value) if key == "ticks" else value
        return fault


def _collect() -> dict[tuple[int, int], Failure]:
    """Return the table: every pair that a registered kind stands for, and whose magnitudes are all known."""
    table: dict[tuple[int, int], Failure] = {}
    for family, kinds in KINDS.items():
        for cls in kinds.values():
            needed = {key for key, (_, default) in magnitudes_of(cls).items() if default is NOTHING}
            for pair in cls.failures:
                magnitudes = MAGNITUDES.get(pair, {})
                if pair not in table and FAMILY_OF.get(pair[0]) == family and needed <= magnitudes.keys():
                    table[pair] = Failure(*pair, cls, magnitudes)
    return table


TABLE: Final = _collect()


def concerns(unit: int, kind: str) -> bool:
    """Return whether a kind of fault on one of a MAVLink unit's instances belongs to that unit: wheels are two of them."""
    if unit not in (MOTOR, ESC) or kind in BOTH:
        return True
    return (kind in TELEMETRY_KINDS) == (unit == ESC)


def name_failure(unit: int | None, type: int | None) -> str:
    """Return unit and type in words."""
    first = UNIT_NAMES.get(-1 if unit is None else unit, "unit")
    second = TYPE_NAMES[type] if type is not None and 0 <= type < len(TYPE_NAMES) else "type"
    return f"{unit} {first}, {type} {second}"
