"""`hilsat check`: says whether scenarios can be run, and what they amount to, without running them."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bus.errors import ConfigError
from bus.icd.load import bus_load
from plant_server.wheels.bank import has_slow_telemetry
from tools.config.loader import Examination, examine
from tools.config.scenario import Resolved

Paths = str | Path | Sequence[str | Path]


def check(
    paths: Paths,
    overrides: Sequence[str] = (),
    *,
    as_json: bool = False,
    check_other: Callable[[Path, bool], dict[str, Any] | None] | None = None,
) -> int:
    """Exit code for a file or several: 0 when all can be run, else that of ConfigError.

    check_other : reports on a file that is no scenario, and prints that unless it is for JSON; None for a scenario

    Prints a summary of each sound file to stdout and every problem of the others to stderr; as JSON, one object to
    stdout.
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    reports = []
    for path in files:
        if (report := check_other(Path(path), as_json) if check_other is not None else None) is not None:
            reports.append(report)
            continue
        examination = examine(path, overrides)
        if examination.resolved is not None:
            reports.append({"file": os.fspath(path), "ok": True, **summarise(examination.resolved), "problems": []})
        else:
            problems = [finding.as_dict() for finding in examination.findings]
            more = {"unlisted_problems": examination.unlisted} if examination.unlisted else {}
            reports.append({"file": os.fspath(path), "ok": False, "problems": problems, **more})
        if not as_json:
            _print(examination)
    passed = all(report["ok"] for report in reports)
    if as_json:
        print(json.dumps({"ok": passed, "files": reports}, ensure_ascii=False))
    return 0 if passed else ConfigError.exit_code


def summarise(resolved: Resolved) -> dict[str, Any]:
    """What a scenario amounts to, in JSON types."""
    scenario = resolved.scenario
    tick_hz = scenario.clock.tick_hz
    motor_wheels = sum([has_slow_telemetry(getattr(wheel, "model", None)) for wheel in scenario.plant.wheels])
    load = bus_load(tick_hz, scenario.plant.star_tracker.rate_hz, scenario.bus.bitrate_bps, motor_wheels)
    return {
        "name": scenario.name,
        "title": scenario.title,
        "duration_s": scenario.duration_s,
        "ticks": resolved.ticks,
        "tick_hz": tick_hz,
        "control_hz": tick_hz / scenario.fsw.executive.control_divider,
        "clock": scenario.clock.mode,
        "bus_load_percent": round(100 * load, 1),
        "bitrate_bps": scenario.bus.bitrate_bps,
        "run_hash": f"{resolved.run_hash:#010x}",
        "faults": list_timeline(resolved),
        "expectations": len(scenario.expect),
        "graded": bool(scenario.expect or scenario.faults),
    }


def list_timeline(resolved: Resolved) -> list[dict[str, Any]]:
    """Faults in the order of their onset: what, where, from when, until when."""
    end_s = resolved.scenario.duration_s
    rows = []
    for index, fault in enumerate(resolved.scenario.faults):
        until_s = end_s if fault.ends_s is None else min(fault.ends_s, end_s)
        rows.append({"fault": index, "unit": fault.unit, "kind": fault.kind, "at_s": fault.at_s, "until_s": until_s})
    return sorted(rows, key=lambda row: (row["at_s"], row["fault"]))


def _print(examination: Examination) -> None:
    if examination.resolved is not None:
        _print_summary(examination.path, summarise(examination.resolved))
        return
    for finding in examination.findings:
        print(finding, file=sys.stderr)
    if examination.unlisted:
        print(f"and {examination.unlisted} more", file=sys.stderr)
    count = len(examination.findings) + examination.unlisted
    print(f"{examination.path}: {count} problem{'s' if count != 1 else ''}", file=sys.stderr)


def _print_summary(path: str, facts: dict[str, Any]) -> None:
    print(f"{path}: OK: {facts['name']}{': ' + facts['title'] if facts['title'] else ''}")
    print(
        f"  {facts['duration_s']:g} s, {facts['ticks']} ticks at {facts['tick_hz']} Hz, control at "
        f"{facts['control_hz']:g} Hz, {facts['clock']}"
    )
    print(f"  bus load {facts['bus_load_percent']:g} % of {facts['bitrate_bps'] / 1000:g} kbit/s, worst case")
    for row in facts["faults"]:
        print(f"  {row['at_s']:8.2f} .. {row['until_s']:8.2f} s  {row['unit']:<12} {row['kind']}")
    print(f"  {facts['expectations']} expectations, {len(facts['faults'])} faults, run hash {facts['run_hash']}")
    if not facts["graded"]:
        print("  nothing will be graded: there is neither an expectation nor a fault")
