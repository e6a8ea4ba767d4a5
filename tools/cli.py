"""The `hilsat` command. Each verb lives in a module of its own under tools/verbs or beside its subject.

Data goes to stdout, progress and logs to stderr. Exit codes: 0 passed; 1 ran and was graded a fail; 2 usage or
configuration; 3 infrastructure (bus lost, a process died, deadlines missed past the limit); 130 and 143 interrupted.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys

from bus.build import CURRENT
from bus.errors import HilsatError
from bus.process import Interrupted
from bus.streams import open_streams, read_failure
from bus.trace import PLACE, describe_unforeseen

# verb -> (module with add_parser(subparsers), summary); imported only when the verb is used
VERBS: dict[str, tuple[str, str]] = {
    "run": ("tools.verbs.run", "run a scenario: plant, flight software, log, grade, picture"),
    "check": ("tools.verbs.check", "validate scenario files without running them"),
    "grade": ("tools.verbs.grade", "grade a log against the scenario it carries"),
    "info": ("tools.verbs.info", "what a log holds and how its run ended, on one screen"),
    "replay": ("tools.verbs.replay", "fly a log's flight software again and compare it bit for bit"),
    "verify": ("tools.verbs.verify", "whether this machine repeats a run to the byte"),
    "report": ("tools.verbs.report", "one HTML page about one or more logs: verdicts, margins, pictures"),
    "plot": ("tools.verbs.plot", "draw a log, or any signals of some logs, as png, svg or pdf"),
    "live": ("tools.verbs.live", "fly a scenario at the clock's pace, served to Foxglove, with a button a fault"),
    "shootout": ("tools.verbs.shootout", "fly every law with every allocator through the same faults, one table"),
    "campaign": ("tools.verbs.campaign", "many runs from one file, one answer"),
    "bench": ("tools.verbs.bench", "measure what a cycle costs on this machine"),
    "inject": ("tools.verbs.inject", "break and heal units of a bench that runs, keep it as a scenario"),
    "plant": ("tools.verbs.sides", "run the plant alone, on a bus"),
    "fsw": ("tools.verbs.sides", "run the flight software alone, on a bus"),
    "recover": ("tools.verbs.logs", "make a killed run's log whole"),
    "export": ("tools.verbs.logs", "write a log's signals or frames as csv, npz, candump log, asc, blf"),
    "diff": ("tools.verbs.logs", "compare the deterministic content of two logs"),
    "vcan": ("tools.vcan.cli", "virtual CAN interfaces, and a place to run where there are none"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one verb; return the exit code. What cannot be written on stdout does not change it."""
    open_streams()
    words = sys.argv[1:] if argv is None else argv
    if CURRENT.trouble:
        print(f"hilsat: {CURRENT.trouble}", file=sys.stderr)
        return 2
    if not sys.platform.startswith("linux"):
        print(
            f"hilsat runs on Linux (this is {sys.platform}); on Windows use WSL, on macOS a Linux VM", file=sys.stderr
        )
        return 2
    try:
        code = _run_verb(words)
        failure = read_failure(sys.stdout)
    except BrokenPipeError:  # whoever read our words has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt as stop:
        return 128 + (stop.number if isinstance(stop, Interrupted) else signal.SIGINT)
    if failure is not None:
        print(
            f"hilsat: stdout cannot be written: {failure.strerror}; the exit code is that of the work", file=sys.stderr
        )
    return code


def _run_verb(words: list[str]) -> int:
    try:
        args = _make_parser(words).parse_args(_expand(words))
        if args.debug:
            os.environ[PLACE] = "-"  # for the processes of a run too
        return int(args.func(args))
    except SystemExit:  # usage, --help and --version
        read_failure(sys.stdout)
        raise
    except HilsatError as error:
        print(f"hilsat: {error}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        raise
    except Exception as error:
        print(f"hilsat: {describe_unforeseen('hilsat', error)}", file=sys.stderr)
        return HilsatError.exit_code


def _make_parser(words: list[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hilsat",
        description="Hardware-in-the-loop test bench for satellite attitude-control flight software.",
        epilog="Exit codes: 0 passed, 1 graded a fail, 2 usage or configuration, 3 infrastructure.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="which version and build, in one line")
    parser.add_argument("--debug", action="store_true", help="show the traceback of what was not foreseen")
    subparsers = parser.add_subparsers(metavar="VERB", required=True)
    wanted = next((word for word in words if not word.startswith("-")), None)
    if wanted in VERBS:
        # Two verbs may share a module; it then adds them all.
        importlib.import_module(VERBS[wanted][0]).add_parser(subparsers)
    else:
        for verb, (_, summary) in VERBS.items():
            subparsers.add_parser(verb, help=summary)
    return parser


def _expand(words: list[str]) -> list[str]:
    """The words, those behind a verb that has short forms spelt out."""
    at = next((i for i, word in enumerate(words) if not word.startswith("-")), None)
    if at is None or words[at] not in VERBS:
        return words
    expand = getattr(importlib.import_module(VERBS[words[at]][0]), "expand", None)
    return words if expand is None else [*words[: at + 1], *expand(words[at + 1 :])]


class _Version(argparse.Action):
    """One line, whatever the width of the terminal: scripts read it, and argparse's own action wraps it."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"hilsat {_version()} ({CURRENT.words})")
        parser.exit()


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("hilsat")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    from hilsat import main as start

    sys.exit(start())
