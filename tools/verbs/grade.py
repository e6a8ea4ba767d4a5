"""`hilsat grade LOG...`: grade logs, each against the scenario it carries.

Every requirement passes, fails or is not executed, because the log lacks what it takes to tell. Exit codes: 0 when all
pass and something was asked; 1 when not, that is FAIL and NOT EXECUTED alike; 3 when a log cannot be graded at all.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bus.errors import HilsatError
from tools.grading.grade import Grade, format_grade, grade_file, to_json
from tools.log.outputs import create


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("grade", help="grade logs", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="MCAP file of a run")
    parser.add_argument(
        "-r", "--requirements", type=Path, action="append", default=[], metavar="FILE",
        help="requirements beside those of the scenario: a YAML file, see docs/grading.md; repeatable",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object a log on stdout")
    parser.add_argument(
        "--junit", type=Path, metavar="FILE", help="write the verdicts as JUnit XML too, for a CI system"
    )
    parser.add_argument("-f", "--force", action="store_true", help="replace the file of --junit when it is there")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Print the grades; return 0 when all pass, 1 when one does not, 3 when one cannot be graded."""
    grades: list[tuple[Path, Grade]] = []
    code = 0
    for log in args.logs:
        try:
            grade = grade_file(log, args.requirements)
        except HilsatError as error:
            if len(args.logs) == 1:
                raise
            print(f"hilsat grade: {error}", file=sys.stderr)
            code = max(code, error.exit_code)
            continue
        if args.requirements and not grade.added:
            names = ", ".join(map(str, args.requirements))
            print(f"hilsat grade: {log}: no requirement of {names} applies to {grade.scenario}", file=sys.stderr)
        grades.append((log, grade))
        code = max(code, 0 if grade.passed else 1)
        print(to_json(grade) if args.json else format_grade(grade))
    if args.junit is not None:
        from tools.grading.junit import make_junit

        with create(args.junit, args.logs[0], args.force) as path:
            path.write_bytes(make_junit(grades))
    return code
