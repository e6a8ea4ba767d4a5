"""Writes docs/mavlink-faults.md from the table of failures: `python -P -m tools.design.mavlink_faults`."""

from __future__ import annotations

import sys
from pathlib import Path

from bus.mavlink import words
from plant_server.ground.desk import MOST_FAULTS, NOT_ALLOWED
from plant_server.ground.failures import INSTANCES, SETTINGS, TABLE, TYPE_NAMES, UNIT_NAMES, Failure

PAGE = Path(__file__).resolve().parents[2] / "docs" / "mavlink-faults.md"
OURS = {
    0: "an axis of the gyro",
    6: "the star tracker",
    101: "a wheel's motor",
    106: "a wheel's telemetry",
    109: "the bus",
}

INTRODUCTION = f"""# Faults by MAVLink's own command

Generated from the table in `plant_server/ground/failures.py` by `python -P -m tools.design.mavlink_faults`. Do not edit this
page: edit the table, then run that.

The plant is a component of the system on the link: system {words.SYSTEM_ID}, component {words.PLANT_COMPONENT}
(MAV_COMP_ID_USER1). Any ground program can break it by `MAV_CMD_INJECT_FAILURE` (420), by COMMAND_LONG or COMMAND_INT.
What it sets is a fault like any other: it goes the way that a fault of the scenario goes, acts on the tick before which the
command came, and is logged with that tick as `fault.add by MAVLink 255/190`. Onset, first effect and end of every fault,
whoever set it, are said as STATUSTEXT to all who listen.

| parameter | |
|---|---|
| 1 | FAILURE_UNIT, a number |
| 2 | FAILURE_TYPE, a number |
| 3 | instance: 0 is all, 1 the first |
| 4 | only where parameter 3 is NaN: instances as bits, bit 0 the first |
| 5 to 7 | not used, NaN will do |

Numbers and not names count: libraries know fewer of them than the command has.

| result | when |
|---|---|
| ACCEPTED | done |
| DENIED | "{NOT_ALLOWED}" (parameter `FLT_ENABLE` is 0); or no such instance |
| UNSUPPORTED | this unit, or this type of it, is not in the table below |
| FAILED | the fault could have no effect on this plant, or {MOST_FAULTS} faults have been set in the run |

Whatever is not accepted is said with the reason as STATUSTEXT, to who asked as well. Of several instances all fail or none.
A failure takes the place of the one that 420 had put on the same instance before; faults from elsewhere stay beside it. Type
0 (OK) ends all that is on the instance and of that unit, whoever set it: of a wheel, 101 what changes its torque, 106 what
changes its telemetry. A fault that is on all axes of the gyro as one ends with instance 0 alone.
"""


def format_page() -> str:
    """Text of docs/mavlink-faults.md."""
    lines = [INTRODUCTION, "## What stands for what", "", "| MAVLink | here | instances | types |", "|---|---|---|---|"]
    for unit, name in UNIT_NAMES.items():
        count = len(INSTANCES[unit])
        types = ", ".join(str(number) for u, number in sorted(TABLE) if u == unit)
        lines.append(f"| {unit} {name} | {OURS[unit]} | {'1' if count == 1 else f'1 to {count}'} | 0, {types} |")
    lines += [
        "", "MAVLink has no unit for a star tracker; the one that tells a vehicle where it is by looking out stands for it.",
        "", "| unit | type | kind of fault | with |", "|---|---|---|---|",
    ]  # fmt: skip
    for pair in sorted(TABLE):
        lines.append(_format_failure(TABLE[pair]))
    missing = [
        f"{unit} {UNIT_NAMES[unit]}: {', '.join(f'{n} {TYPE_NAMES[n]}' for n in numbers)}"
        for unit in UNIT_NAMES
        if (numbers := [n for n in range(1, len(TYPE_NAMES)) if (unit, n) not in TABLE])
    ]
    lines += ["", f"Unsupported: {'; '.join(missing)}; and all other units."] if missing else []
    lines += [
        "", "## Magnitudes", "",
        "The command has none. They are parameters of the plant, REAL32, and act on what is set after them:", "",
        "| parameter | default | unit | range | |", "|---|---|---|---|---|",
        "| `FLT_ENABLE` | as the run has it | 1 | 0 or 1 | 1: faults are taken. Cannot be set |",
    ]  # fmt: skip
    for setting in SETTINGS:
        limits = f"{setting.low:g} to {setting.high:g}"
        lines.append(f"| `{setting.name}` | {setting.value:g} | {setting.unit} | {limits} | {setting.text} |")
    return "\n".join(lines) + "\n"


def _format_failure(failure: Failure) -> str:
    effect = failure.effect
    link = f"[`{effect.kind}`](faults.md#{effect.family}-{effect.kind})"
    given = ", ".join(
        f"`{key}` {'from `' + value + '`' if isinstance(value, str) else f'{value:g}'}"
        for key, value in failure.magnitudes.items()
    )
    unit, kind = failure.unit, failure.failure
    return f"| {unit} {UNIT_NAMES[unit]} | {kind} {TYPE_NAMES[kind]} | {effect.family} {link} | {given or 'its defaults'} |"


def main() -> int:
    """Write the page; return the exit code."""
    PAGE.write_text(format_page(), encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
