"""Pictures of the catalogue of faults: what each kind does to an observable over 60 s, acting from 10 s to 50 s.

They come from the timeline and the kind itself, without a plant: a wheel's record of what is disturbed, applied to a sine of
torque, speed or current where that is what it changes; samples of a gyro axis that turns to and fro; frames of a star
tracker.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from annotated_types import Ge, Gt, Le, Lt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bus.settings import NOTHING, find_unit, strip_annotations
from plant_server.faults import Fault, FaultTimeline, make_fault, parts_of
from plant_server.faults.effects import BusFrame, Effect, GyroSample, StarSample, WheelDisturbance
from plant_server.faults.fault import magnitudes_of
from plant_server.noise import open_normals
from tools.config.fault_reference import UNITS_OF

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "img" / "faults"
SHOWN_FROM_S, SHOWN_TO_S, LENGTH_S = 10.0, 50.0, 60.0
STEP_S = 0.1
SEED = 1
SIZES = {"N m": 0.01, "rad/s": 0.01, "rad/s^2": 2e-4}  # of a magnitude that is needed and has no limits, by unit

BUS_LABELS = {
    "lost": "frame arrives", "delay_s": "frame late by [s]", "copies": "copies", "swapped": "overtaken",
    "broken_bits": "bits turned", "dlc": "data bytes", "is_off": "frame is sent", "is_blocked": "frame is sent",
    "extra_hz": "frames more\na second", "forged": "second sender",
}  # fmt: skip
STAR_LABELS = {
    "lost": "frame sent", "frozen": "stands still", "random": "any attitude", "turn_b_rad": "turned by\n[deg]",
    "late_ticks": "late [ticks]",
}  # fmt: skip
Record = WheelDisturbance | GyroSample | StarSample | BusFrame
Trace = list[float]


def show_fault(cls: type[Effect]) -> Fault:
    """Return the fault of a kind that its picture shows: defaults, and something in range for what is needed."""
    needed = {key: _choose(kind) for key, (kind, default) in magnitudes_of(cls).items() if default is NOTHING}
    unit = UNITS_OF[cls.family][-1 if cls.family == "gyro" else 0]
    return make_fault(unit=unit, kind=cls.kind, at_s=SHOWN_FROM_S, until_s=SHOWN_TO_S, **needed)


def _choose(kind: Any) -> float:
    """Return a value in the middle of the range of a magnitude."""
    least = most = None
    for note in strip_annotations(kind)[1]:
        if isinstance(note, Ge | Gt):
            least = float(note.ge if isinstance(note, Ge) else note.gt)  # type: ignore[arg-type]
        if isinstance(note, Le | Lt):
            most = float(note.le if isinstance(note, Le) else note.lt)  # type: ignore[arg-type]
    if least is not None:
        return least + 2.0 if most is None else 0.5 * (least + most)
    return SIZES.get(find_unit(kind), 0.1)


def name_picture(cls: type[Effect]) -> str:
    """Return the file name of a kind's picture."""
    return f"{cls.family}-{cls.kind}.png"


def draw_picture(cls: type[Effect]) -> None:
    """Write the picture of a kind: grey without the fault, dark with it."""
    times, healthy, faulty, label = trace_fault(show_fault(cls))
    figure = Figure(figsize=(4.2, 1.5), dpi=80)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.2, 0.27, 0.77, 0.68))
    style = "steps-post" if _is_stepped(faulty) else "default"
    axes.plot(times, healthy, color="0.7", linewidth=1.0, drawstyle=style)
    axes.plot(times, faulty, color="#a01020", linewidth=1.0, drawstyle=style)
    axes.set_xlim(0.0, LENGTH_S)
    axes.set_xlabel("t [s]", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7)
    figure.savefig(PICTURES / name_picture(cls), metadata={"Software": None})


def _is_stepped(trace: Trace) -> bool:
    return len({value for value in trace if not math.isnan(value)}) < 30


def trace_fault(fault: Fault) -> tuple[Trace, Trace, Trace, str]:
    """Return times [s], an observable without and with a fault, and what it is; nan: nothing is sent."""
    timeline = FaultTimeline((fault,), step_s=STEP_S, steps_per_tick=1, seed=SEED)
    chain = timeline.chains[parts_of(fault.unit)[0]]
    times, before, after = [], [], []
    noise = open_normals(SEED, "picture")
    last = 0.0
    for step in range(round(LENGTH_S / STEP_S)):
        t_s = (step + 0.5) * STEP_S
        if step >= chain.next_edge:
            chain.refresh(step)
        record, plain = _make_record(fault.effect.family, t_s, noise(), last)
        for entry in chain.active:
            entry.bring_to(t_s, _turn(t_s))
            entry.draw_each()
            entry.effect.disturb(record, entry.now)  # type: ignore[attr-defined]
        times.append(t_s)
        before.append(plain)
        after.append(record)
        if isinstance(record, GyroSample) and not record.silent:
            last = record.rate_rad_s
    label, look = _find_observable(before, after)
    return times, _read(look, times, before), _read(look, times, after), label


def _read(look: Callable[[float, Any], float], times: Trace, records: list[Any]) -> Trace:
    """Return the observable of every record; one that is held keeps the value before."""
    trace: Trace = []
    for t_s, record in zip(times, records, strict=True):
        value = look(t_s, record)
        trace.append(trace[-1] if value == math.inf else value)
    return trace


def _make_record(family: str, t_s: float, noise: float, last: float) -> tuple[Any, Any]:
    """Return what the faults are to change at a moment, and the same untouched."""
    if family == "wheel":
        return WheelDisturbance(), WheelDisturbance()
    if family == "gyro":
        white = 1e-3 * noise
        rate = 0.02 * math.sin(math.pi * t_s / 15.0) + white
        return GyroSample(rate, white, last), GyroSample(rate, white, last)
    if family == "bus":
        return BusFrame(), BusFrame()
    return StarSample(), StarSample()


# -- observables ---------------------------------------------------------------------------------------------------


def _turn(t_s: float) -> float:
    """Return the speed of the wheel that is shown [rad/s]; its telemetry is shown at a tenth of it."""
    return 120.0 * math.cos(math.pi * t_s / 20.0 + 0.7)


def _look_at_torque(t_s: float, record: WheelDisturbance) -> float:
    return record.gain * 0.02 * math.sin(math.pi * t_s / 10.0 + 0.7) + record.offset_nm


def _look_at_speed(t_s: float, record: WheelDisturbance) -> float:
    if record.speed_frozen:
        return math.inf
    return _round(0.1 * _turn(t_s) * record.speed_gain + record.speed_offset_rad_s, record.speed_lsb_rad_s)


def _look_at_current(t_s: float, record: WheelDisturbance) -> float:
    if record.current_frozen:
        return math.inf
    current = 0.2 * math.sin(math.pi * t_s / 10.0 + 0.7)
    return _round(current * record.current_gain + record.current_offset_a, record.current_lsb_a)


def _round(value: float, lsb: float) -> float:
    return round(value / lsb) * lsb if lsb else value


def _look_at_rate(t_s: float, record: GyroSample) -> float:
    return math.nan if record.silent else record.rate_rad_s


def _look_at_star(record: StarSample, name: str) -> float:
    value = getattr(record, name)
    if name == "lost":
        return 0.0 if value else 1.0
    if name == "turn_b_rad":
        return math.degrees(math.hypot(*value))
    return float(value) if isinstance(value, bool | int) else 0.0 if value is None else 1.0


def _look_at_bus(record: BusFrame, name: str) -> float:
    value = getattr(record, name)
    if name in ("lost", "is_off", "is_blocked"):
        return 0.0 if value else 1.0
    return float(len(value) if isinstance(value, tuple) else 8 if name == "dlc" and value < 0 else value)


def _find_observable(before: list[Any], after: list[Any]) -> tuple[str, Callable[[float, Any], float]]:
    """Return what is shown of the records, and how to read it from one."""
    if isinstance(after[0], GyroSample):
        return "rate [rad/s]", _look_at_rate
    changed = [
        name
        for name in type(after[0]).__slots__
        if any(getattr(a, name) != getattr(b, name) for a, b in zip(before, after, strict=True))
    ]
    if isinstance(after[0], StarSample):
        return STAR_LABELS[changed[0]], lambda t_s, record: _look_at_star(record, changed[0])
    if isinstance(after[0], BusFrame):
        return BUS_LABELS[changed[0]], lambda t_s, record: _look_at_bus(record, changed[0])
    if any(name.startswith("speed_") for name in changed):
        return "speed reported\n[rad/s]", _look_at_speed
    if any(name.startswith("current_") for name in changed):
        return "current reported\n[A]", _look_at_current
    own = [name for name in changed if name not in ("gain", "offset_nm", "is_stuck", "has_bus", "silent")]
    if not own and ("gain" in changed or "offset_nm" in changed):
        return "torque [N m]", _look_at_torque
    if "bus_v" in own:
        return "bus_v", lambda t_s, record: record.bus_v if record.has_bus else math.nan
    name = (own or changed)[0]
    return name, lambda t_s, record: float(getattr(record, name))
