"""From which start angles and rates an attitude law still settles (see docs/braking-profile.md).

    python -m tools.design.braking_reach
    python -m tools.design.braking_reach --law smc --faults

The satellite and the misaligned wheels of Zhang, Ye & Sun 2018, healthy unless --faults, at 30..180 deg about the eigenaxis
of the published start and 0..6 deg/s. Each start is flown with the rate along that axis, away from the target, and with the
rate across it. A cell is the settling time to 1 degree [s], the longer of the two; "-" where one of them has not settled by
--until. The mode is held at pointing: in flight the default settings damp the rate first, from 5 deg/s on.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace

from bus.linear import cross, scale
from bus.units import DEG, Vec3
from tools.design.braking_cases import Case, Conditions, Law, fly, read_cases
from tools.design.braking_study import BOUND_DEG, LAWS

ANGLES_DEG = (30, 60, 90, 120, 150, 180)
RATES_DEG_S = (0, 1, 2, 3, 4, 5, 6)
UNTIL_S = 600.0


def make_starts(base: Case, angle_deg: float, rate_deg_s: float, faults: bool) -> list[Case]:
    """Return the case turned to a start: its rate away from the target and, where it has one, across."""
    _, x, y, z = base.q0
    axis = scale((x, y, z), 1.0 / math.sqrt(x * x + y * y + z * z))
    across = cross(axis, (0.0, 0.0, 1.0))
    across = scale(across, 1.0 / math.sqrt(sum(v * v for v in across)))
    half = 0.5 * angle_deg * DEG
    turn = scale(axis, math.sin(half))
    directions: tuple[Vec3, ...] = (axis, across) if rate_deg_s else (axis,)
    return [
        replace(
            base, q0=(math.cos(half), *turn), omega0_rad_s=scale(direction, rate_deg_s * DEG),
            faults=base.faults if faults else (),
        )
        for direction in directions
    ]  # fmt: skip


def find_settling(
    law: Law, base: Case, angle_deg: float, rate_deg_s: float, conditions: Conditions, faults: bool
) -> str:
    """Return the longest settling time of the starts at this angle and rate [s] as a table cell; "-": not settled."""
    longest = 0.0
    for case in make_starts(base, angle_deg, rate_deg_s, faults):
        settled_s = fly(case, law, conditions)[BOUND_DEG]
        if settled_s is None:
            return "-"
        longest = max(longest, settled_s)
    return f"{longest:.0f}"


def main(arguments: list[str]) -> int:
    """Print one table for each law on stdout; 0 when done."""
    parser = argparse.ArgumentParser(prog="braking_reach", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--law", choices=sorted(LAWS), action="append", help="only this law (repeatable)")
    parser.add_argument("--faults", action="store_true", help="with the wheel faults of the published scenario")
    parser.add_argument("--momentum", action="store_true", help="with the wheels' momentum in plant and model")
    parser.add_argument("--until", type=float, default=UNTIL_S, metavar="S", help="how long a run is watched [s]")
    options = parser.parse_args(arguments)
    conditions = Conditions(momentum=options.momentum, until_s=options.until)
    base = read_cases()[0]
    for name in options.law or ("smc", "lyapunov", "adaptive"):
        print(f"\n| {name}: deg \\ deg/s | " + " | ".join(str(rate) for rate in RATES_DEG_S) + " |")
        print("|---" * (1 + len(RATES_DEG_S)) + "|")
        for angle in ANGLES_DEG:
            cells = [find_settling(LAWS[name], base, angle, rate, conditions, options.faults) for rate in RATES_DEG_S]
            print(f"| {angle} | " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
