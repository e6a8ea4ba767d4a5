"""Writes docs/faults.md and its pictures from the register of kinds: `python -P -m tools.design.fault_catalogue`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from bus.settings import NOTHING, find_unit, limits_of, strip_annotations
from plant_server.faults import PROFILES
from plant_server.faults.effects import Effect, WheelEffect
from plant_server.faults.fault import magnitudes_of, profiles_of
from tools.config.comments import comments_of, summary_of
from tools.config.fault_reference import UNITS_OF, list_variants
from tools.design.fault_pictures import PICTURES, SHOWN_FROM_S, SHOWN_TO_S, draw_picture, name_picture, show_fault

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "faults.md"
FAILURE_UNITS = {
    0: "SENSOR_GYRO", 6: "SENSOR_VIO (the star tracker)", 101: "SYSTEM_MOTOR", 106: "SYSTEM_ESC",
    109: "SYSTEM_BUS_CAN",
}  # fmt: skip
FAILURE_TYPES = {
    1: "OFF", 2: "STUCK", 3: "GARBAGE", 4: "WRONG", 5: "SLOW", 6: "DELAYED", 7: "INTERMITTENT", 8: "DRIFT",
}  # fmt: skip
TITLES = {"wheel": "Wheels", "gyro": "Gyro", "star_tracker": "Star tracker", "bus": "Bus"}

INTRODUCTION = """# Faults: the catalogue

Generated from the register of kinds by `python -P -m tools.design.fault_catalogue`. Do not edit this page: edit the
kinds in `plant_server/faults/kinds/`, their docstrings and comments, or the text in
`tools/design/fault_catalogue.py`, then run that.

A fault in a scenario, or in the command `fault.add`, is one flat mapping:

```yaml
faults:
  - {unit: wheel.1, kind: gain_kt, torque_gain: 0.6, at_s: 150}
  - {unit: wheel.2, kind: friction_coulomb, at_s: 60, rise_s: 60}
  - {unit: wheel.3, kind: jump, at_s: 10, rate_per_h: 120}
  - {unit: wheel.4, kind: runaway, at_s: 200, until_s: 260, latch: until_power_cycle}
  - {unit: bus, kind: loss, probability: 0.05, node: wheel.1, at_s: 30}
```

Torques are those on the body about the wheel's axis, as everywhere in this project; friction and seizure oppose the
rotor's motion, and the momentum that they take from the rotor goes to the body. Symbols of equations are those of the
wheel's model ([wheels.md](wheels.md)). A value out of its range, a key that the kind does not take, and a fault that
can do nothing on this plant (a motor's fault on an ideal wheel, a factor of 1, three times no friction) are refused
with the reason.

Two names for two things that are both called "stuck": `stuck_torque` is a constant torque (Zhang, Ye & Sun 2018),
`seize` a rotor that cannot turn. Names that mean the same: the effectiveness e of that paper is `loss`; `bias_torque`
is `bias` but for the order (below); `dead` is a motor without torque for good, `idle` one that a reset of the wheel
heals.

## What becomes of a fault

`onset`, `effect` (the first time that it really changes something), `end` and `cleared` are logged on `/faults`, each
with the whole fault. A fault ends at `until_s`, when its profile is over, when the test bench clears it
(`fault.clear`, always), when its unit is reset or power-cycled (below), or when it has healed by itself
(`low_speed_friction`).

## Profiles

What a fault changes is base + a(t) (value - base), with a from 0, not there, to 1, fully there, over the time since
the onset. The window from `at_s` to `until_s` stands around every profile.

{profiles}

`profile` may be left out: it is then the first of these that takes all the keys given, and without any of them what
is usual for the kind. Profiles that fall by chance draw from a stream that belongs to the fault alone (seed of the
run, unit, kind, and how many of that kind the unit has before it), in simulated time: the course is the same to the
bit whatever the integration step and whatever else is in the scenario. The levels of a wheel's fault are taken in the
middle of each integration step, those of a sensor's at its samples. A kind that is there or not (a frozen reading)
takes no profile with a slope.

## Several faults on one unit

They act one after the other in the order of their onset, and none replaces another. `noise` of a gyro acts ahead of
all; `bias_torque`, `jump`, `drag_burst`, `torque_noise`, `tach_garbage`, `tach_dropout` and `current_dropout` behind
all. So, for a wheel:

- Gains and factors multiply: C_t, C_d, k_c, k_v, the scale of readings.
- Torques and friction add: tau_fe, tau_s, tau_seize, tau_bias, tau_spike; offsets of readings and ticks of delay as
  well.
- Of currents and bus voltages that are put in place of others the last one stands. `runaway` also takes the place of
  a torque that an earlier fault holds (`stuck_torque`, `dead`); a later one of those takes its.
- `loss`, `bias`, `stuck_torque` and `dead` are maps of the motor's torque, tau = e tau_c + b, and compose as such: a
  loss scales a bias that was there before it, a later bias on a dead wheel is a stuck torque.
- A wheel's fault with a later onset can mask an earlier one; it has no effect then, and is not said to have one.

## Latches

`latch` (wheels) makes a fault stay when its profile or `until_s` would end it. It keeps the highest level that it has
reached.

| `latch` | what ends it |
|---|---|
| left out | `until_s`, or the end of its profile |
| `until_reset` | a reset or a power cycle of the wheel, by its command |
| `until_power_cycle` | a power cycle of the wheel |
| `true` | nothing, to the end of the run; no `until_s` beside it |

With `until_s`, or a profile that ends, the cause is there until then: a reset or a power cycle before that helps
nothing, one after it heals. Without, the first one heals. A fault that comes again by itself (`intermittent`,
`poisson`) falls back to where its profile stands and is caught anew by the next spell: latch-ups that strike at
random and each need a power cycle. Without a latch, of all kinds, `idle` alone is healed by a reset. Each healing is
a `cleared` event that says by what.
"""


def format_page() -> str:
    """Text of docs/faults.md."""
    lines = [INTRODUCTION.replace("{profiles}", "\n".join(_format_profiles())), *_format_overview()]
    family = ""
    for name, cls in list_variants():
        if name != family:
            family = name
            units = ", ".join(f"`{unit}`" for unit in UNITS_OF[family])
            lines += ["", f"## {TITLES.get(family, family)}", "", f"On {units}."]
        lines += _format_kind(cls)
    return "\n".join(lines) + "\n"


def _format_profiles() -> list[str]:
    lines = ["| `profile` | how the fault comes on | keys |", "|---|---|---|"]
    for name, cls in PROFILES.items():
        keys = "; ".join(_describe_key(cls, key) for key in magnitudes_of(cls))
        lines.append(f"| `{name}` | {summary_of(cls)} | {keys} |")
    return [line.replace("<", "&lt;") for line in lines]


def _describe_key(cls: type, key: str) -> str:
    kind, default = magnitudes_of(cls)[key]
    unit, limits = find_unit(kind), _limits_of(kind)
    given = "" if default is NOTHING else f"default {default:g}"
    words = ", ".join(word for word in (unit, limits, given, comments_of(cls)[key]) if word)
    return f"`{key}` ({words})" if words else f"`{key}`"


def _limits_of(kind: Any) -> str:
    return limits_of(strip_annotations(kind)[1])


def _format_overview() -> list[str]:
    """One line for each kind, with where it is in the model and in MAVLink."""
    lines = ["## All kinds", "", "| unit | kind | changes | MAVLink failure |", "|---|---|---|---|"]
    for family, cls in list_variants():
        link = f"[`{cls.kind}`](#{_anchor(cls)})"
        lines.append(f"| {family} | {link} | {_mask(cls.equation)} | {_format_failures(cls, short=True)} |")
    lines += [
        "",
        "MAVLink failures are `MAV_CMD_INJECT_FAILURE` (420), unit and type by number; [its page](mavlink-faults.md) has",
        "the magnitudes, which that command cannot say. Kinds without a number are reached by name alone.",
    ]
    return lines


def _anchor(cls: type[Effect]) -> str:
    return f"{cls.family}-{cls.kind}"


def _mask(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


def _format_failures(cls: type[Effect], *, short: bool) -> str:
    if short:
        return ", ".join(f"{unit}/{kind}" for unit, kind in cls.failures)
    words = [
        f"{unit} {FAILURE_UNITS.get(unit, '')}, {kind} {FAILURE_TYPES.get(kind, '')}" for unit, kind in cls.failures
    ]
    return "; ".join(words) or "none: by name alone"


def _format_kind(cls: type[Effect]) -> list[str]:
    """Section of one kind."""
    picture = f"img/faults/{name_picture(cls)}"
    shown = show_fault(cls)
    source: type = cls
    lines = ["", f'### <a id="{_anchor(cls)}"></a>`{cls.kind}`', "", f"{_mask(_start_sentence(summary_of(cls)))}.", ""]
    lines += [f"![{cls.family} {cls.kind} over 60 s]({picture})", ""]
    magnitudes = magnitudes_of(cls)
    if magnitudes:
        lines += ["| key | unit | default | range | |", "|---|---|---|---|---|"]
        for key, (kind, default) in magnitudes.items():
            given = "needed" if default is NOTHING else "none" if default is None else _say(default)
            cells = (f"`{key}`", find_unit(kind) or "1", given, _limits_of(kind) or "any", comments_of(source)[key])
            lines.append("| " + " | ".join(_mask(cell) for cell in cells) + " |")
        lines.append("")
    lines += [f"- In the model: {cls.equation}" if cls.equation else "- In the model: as above"]
    lines += [f"- Seen in: {cls.seen_in}"] if cls.seen_in else []
    lines += [f"- MAVLink: {_format_failures(cls, short=False)}", f"- Profiles: {_say_profiles(cls)}"]
    if cls.resettable:
        lines.append("- A reset or a power cycle of the unit heals it")
    if issubclass(cls, WheelEffect) and cls.needs_motor:
        lines.append("- Refused on an ideal wheel, which has no such part")
    lines.append(f"- Shown: `{shown.definition}`")
    return lines


def _start_sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _say(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, int | float) else str(value)


def _say_profiles(cls: type[Effect]) -> str:
    profiles = profiles_of(cls)
    if not profiles:
        return "none: it is there from its onset to its end"
    usual = next(name for name, profile in PROFILES.items() if type(cls.usual) is profile)
    keys = ", ".join(f"`{key}` {_say(getattr(cls.usual, key))}" for key in magnitudes_of(type(cls.usual)))
    which = "all" if len(profiles) == len(PROFILES) else ", ".join(f"`{name}`" for name in profiles)
    return f"{which}; usual `{usual}`" + (f" with {keys}" if keys else "")


def main() -> int:
    """Write page and pictures; return the exit code."""
    PAGE.write_text(format_page(), encoding="utf-8")
    print(PAGE)
    PICTURES.mkdir(parents=True, exist_ok=True)
    variants = [cls for _, cls in list_variants()]
    for old in set(PICTURES.glob("*.png")) - {PICTURES / name_picture(cls) for cls in variants}:
        old.unlink()
    for cls in variants:
        draw_picture(cls)
    print(f"{PICTURES}: {len(variants)} pictures, each from {SHOWN_FROM_S:g} s to {SHOWN_TO_S:g} s of its fault")
    return 0


if __name__ == "__main__":
    sys.exit(main())
