"""The verbs of `hilsat vcan`. Mounted by the main command line; alone: `python -P -m tools.vcan`."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any, NoReturn

from bus.errors import HilsatError, UsageError
from tools.vcan import exec as execution
from tools.vcan import kernel
from tools.vcan.errors import GuestError, VcanError
from tools.vcan.interfaces import bring_up, parse_names, take_down
from tools.vcan.machine import Request
from tools.vcan.status import as_record, as_text, collect_status

MEMORY = re.compile(r"(\d+)([MG])", re.IGNORECASE)
MEMORY_MIN_MB, MEMORY_MAX_MB = 128, 65536
EXEC_TEXT = """\
Runs COMMAND where CAN interfaces exist: in a network namespace of this kernel, else in a user-mode Linux guest on the
host's own files (about 2 s), else under QEMU. The command sees the host's files and environment; in a guest / is
copy-on-write, while the current directory and every --rw directory are the host's own. It runs as root of its guest or
namespace, with HILSAT_REQUIRE_VCAN=1, with only `lo` and the CAN interfaces, and with an empty standard input.
INT, TERM, HUP and QUIT are passed on, and the command may finish; the third one switches the guest off.
Exit code: the command's; 128+n: ended by signal n; 124: time limit; 125: no guest came up; 126, 127: not executable,
not found; 2: this command line is wrong.
"""


def add_parser(subparsers: Any) -> None:
    """Mount `vcan` and its verbs; `func` of the parsed arguments takes them and returns the exit code."""
    parser = subparsers.add_parser("vcan", help="SocketCAN on any Linux: status, up, down, exec, kernel")
    add_verbs(parser)


def add_verbs(parser: argparse.ArgumentParser) -> None:
    verbs = parser.add_subparsers(dest="vcan_verb", required=True, metavar="VERB")
    status = verbs.add_parser("status", help="what this kernel has, what is missing, what exec would use")
    status.add_argument("--json", action="store_true", help="one JSON object on stdout")
    for name, text in (("up", "make vcan interfaces and switch them on"), ("down", "remove vcan interfaces")):
        verb = verbs.add_parser(name, help=text)
        verb.add_argument("interfaces", nargs="+", metavar="IFACE", help="for example vcan0")
    add_exec(verbs)
    built = verbs.add_parser("kernel", help="the time-travel kernel that --virtual-time needs: build, status")
    what = built.add_subparsers(dest="kernel_verb", required=True, metavar="VERB")
    build = what.add_parser("build", help=f"build and cache it ({kernel.COST})")
    build.add_argument("--jobs", type=int, default=0, metavar="N", help="compile jobs (default: one per processor)")
    state = what.add_parser("status", help="is it built, where, from what")
    state.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.set_defaults(func=run)


def add_exec(verbs: Any) -> None:
    verb = verbs.add_parser(
        "exec",
        help="run a command where vcan exists, on any Linux",
        description=EXEC_TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="hilsat vcan exec [options] -- COMMAND [ARG...]",
    )
    verb.add_argument(
        "--can", default="vcan0", metavar="NAMES", help="interfaces to make, comma-separated (default: vcan0)"
    )
    time = verb.add_mutually_exclusive_group()
    time.add_argument(
        "--virtual-time", action="store_true", help="sleeping costs no wall time, computing no virtual time"
    )
    time.add_argument("--real-time", action="store_true", help="SCHED_FIFO on one processor: steadier timing")
    verb.add_argument(
        "--rw", action="append", default=[], metavar="DIR", help="a directory to write through to; repeatable"
    )
    verb.add_argument(
        "--timeout", type=float, default=0.0, metavar="S", help="wall-clock limit [s]; then TERM, exit code 124"
    )
    verb.add_argument("--mem", default="2G", metavar="SIZE", help="guest memory, e.g. 512M or 2G (default: 2G)")
    verb.add_argument("--backend", choices=("auto", *execution.BACKENDS), default="auto")
    verb.add_argument("-v", "--verbose", action="store_true", help="say which backend runs and how")
    verb.add_argument("command", nargs=argparse.REMAINDER, metavar="-- COMMAND")


def parse_memory(text: str) -> int:
    """Return a memory size in MB. Raises UsageError."""
    found = MEMORY.fullmatch(text.strip())
    size_mb = int(found[1]) * (1024 if found[2].upper() == "G" else 1) if found else 0
    if not MEMORY_MIN_MB <= size_mb <= MEMORY_MAX_MB:
        raise UsageError(
            f'--mem "{text}" is not a size from {MEMORY_MIN_MB}M to {MEMORY_MAX_MB // 1024}G, such as 512M or 2G'
        )
    return size_mb


def read_request(args: argparse.Namespace) -> Request:
    """Return what `exec` was asked for. Raises UsageError."""
    command = args.command[1:] if args.command[:1] == ["--"] else args.command
    if not command:
        raise UsageError("no command to run; for example: hilsat vcan exec -- candump vcan0")
    if args.virtual_time and args.backend not in ("auto", "uml"):
        raise UsageError(f"--virtual-time runs on user-mode Linux only, not on --backend {args.backend}")
    if not (args.timeout >= 0.0 and math.isfinite(args.timeout)):
        raise UsageError(f"--timeout {args.timeout:g} is not a number of seconds >= 0 (0: no limit)")
    for path in args.rw:
        if not os.path.isdir(path):
            raise UsageError(f'--rw "{path}" is not a directory')
        if os.path.realpath(path) == "/":
            raise UsageError("--rw / is refused: name the directories that the command may write")
    return Request(
        argv=tuple(command),
        can=tuple(parse_names(args.can)),
        own_dirs=tuple(args.rw),
        backend=args.backend,
        virtual_time=args.virtual_time,
        real_time=args.real_time,
        timeout_s=args.timeout,
        memory_mb=parse_memory(args.mem),
        verbose=args.verbose,
    )


def run(args: argparse.Namespace) -> int:
    """Return the exit code of the parsed verb; errors are said on stderr."""
    verb: Callable[[argparse.Namespace], int] = VERBS[args.vcan_verb]
    try:
        with unwound_by_signals():
            return verb(args)
    except HilsatError as error:
        print(f"hilsat vcan: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


@contextlib.contextmanager
def unwound_by_signals() -> Iterator[None]:
    """While inside, TERM and HUP unwind the stack, so that temporary directories are removed and locks released."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def unwind(number: int, _frame: FrameType | None) -> NoReturn:
        raise SystemExit(128 + number)

    before = {number: signal.signal(number, unwind) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_status(args: argparse.Namespace) -> int:
    status = collect_status()
    print(json.dumps(as_record(status), indent=1) if args.json else as_text(status))
    return 0


def run_up(args: argparse.Namespace) -> int:
    print("\n".join(bring_up(args.interfaces)))
    return 0


def run_down(args: argparse.Namespace) -> int:
    print("\n".join(take_down(args.interfaces)))
    return 0


def run_exec(args: argparse.Namespace) -> int:
    request = read_request(args)
    try:
        return execution.run_command(request)
    except VcanError as error:
        raise GuestError(str(error)) from error


def run_kernel(args: argparse.Namespace) -> int:
    if args.kernel_verb == "build":
        print(kernel.build_kernel(jobs=args.jobs))
        return 0
    record = kernel.describe_kernel()
    if args.json:
        print(json.dumps(record, indent=1))
    elif record["built"]:
        print(f"built: {record['path']} ({record['size_mb']} MB, from {record.get('source', 'unknown')})")
    else:
        print(f"not built: {record['path']}; `hilsat vcan kernel build` ({record['cost']})")
    return 0


VERBS = {"status": run_status, "up": run_up, "down": run_down, "exec": run_exec, "kernel": run_kernel}


def main(argv: Sequence[str] | None = None) -> int:
    """Return the exit code of `python -P -m tools.vcan`."""
    parser = argparse.ArgumentParser(prog="hilsat vcan", description="SocketCAN on any Linux")
    add_verbs(parser)
    return run(parser.parse_args(argv))
