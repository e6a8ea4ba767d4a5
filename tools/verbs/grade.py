"""`hilsat grade LOG`: grade a log against the scenario it carries.

Every requirement passes, fails or is not executed, because the log lacks what it takes to tell. Exit codes: 0 when all
pass and something was asked; 1 when not, that is FAIL and NOT EXECUTED alike; 3 when the log cannot be graded at all.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tools.grading.grade import format_grade, grade_file, to_json


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("grade", help="grade a log", description=__doc__)
    parser.add_argument("log", type=Path, help="MCAP file of a run")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Print the grade; return 0 for a pass, 1 for a fail and for what was not executed."""
    grade = grade_file(args.log)
    print(to_json(grade) if args.json else format_grade(grade))
    return 0 if grade.passed else 1
