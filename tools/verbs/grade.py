"""`hilsat grade LOG... [REQUIREMENTS.yaml...]`: grade logs, each against the scenario it carries.

Requirement files (.yaml, .yml) add to what the scenario expects; `--against LOG2` gives the log that expectations with
`check: matches` compare with. Every requirement passes, fails or is not executed, because the log lacks what it takes to
tell. Exit codes: 0 when all pass and something was asked; 1 when not, that is FAIL and NOT EXECUTED alike; 3 when a log
cannot be graded at all.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

from bus.errors import HilsatError, UsageError
from tools.grading.grade import Grade, format_grade, grade_file, to_json
from tools.log.mcap_reader import read_run
from tools.log.outputs import create

YAML: Final = (".yaml", ".yml")


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("grade", help="grade logs", description=__doc__)
    parser.add_argument(
        "files", type=Path, nargs="+", metavar="LOG|REQUIREMENTS", help="MCAP files of runs, YAML files of requirements"
    )
    parser.add_argument(
        "-r", "--requirements", type=Path, action="append", default=[], metavar="FILE",
        help="requirements beside those of the scenario: a YAML file, whatever it is called; repeatable",
    )  # fmt: skip
    parser.add_argument("--against", type=Path, metavar="LOG2", help="log of a run that `check: matches` compares with")
    parser.add_argument("--json", action="store_true", help="print one JSON object a log on stdout")
    parser.add_argument(
        "--junit", type=Path, metavar="FILE", help="write the verdicts as JUnit XML too, for a CI system"
    )
    parser.add_argument("-f", "--force", action="store_true", help="replace the file of --junit when it is there")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Print the grades; return 0 when all pass, 1 when one does not, 3 when one cannot be graded."""
    logs = [path for path in args.files if path.suffix.lower() not in YAML]
    files = [*args.requirements, *(path for path in args.files if path.suffix.lower() in YAML)]
    if not logs:
        raise UsageError(
            f"there is no log among {', '.join(map(str, args.files))}: hilsat grade LOG [REQUIREMENTS.yaml]"
        )
    reference = None if args.against is None else read_run(args.against)
    grades: list[tuple[Path, Grade]] = []
    code = 0
    for log in logs:
        try:
            grade = grade_file(log, files, reference)
        except HilsatError as error:
            if len(logs) == 1:
                raise
            print(f"hilsat grade: {error}", file=sys.stderr)
            code = max(code, error.exit_code)
            continue
        if files and not grade.added:
            names = ", ".join(map(str, files))
            print(f"hilsat grade: {log}: no requirement of {names} applies to {grade.scenario}", file=sys.stderr)
        grades.append((log, grade))
        code = max(code, 0 if grade.passed else 1)
        print(to_json(grade) if args.json else format_grade(grade))
    if args.junit is not None:
        from tools.grading.junit import make_junit

        with create(args.junit, [*logs, *files, *([args.against] if args.against else [])], args.force) as path:
            path.write_bytes(make_junit(grades))
    return code
