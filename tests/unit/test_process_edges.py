"""The edges of a process: its streams, its signals, and what nobody foresaw, each in an interpreter of its own."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import bus
from bus.process import name_signal

ROOT = str(Path(bus.__file__).resolve().parent.parent)
RAISE = """
import sys
from bus.process import run_process
def body():
    {body}
sys.exit(run_process("plant", body))
"""


def run_code(code: str, *shell: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the code with ROOT on its path; `shell`: redirections of a shell around it."""
    words = [sys.executable, "-P", "-c", code]
    if shell:
        words = ["sh", "-c", 'exec "$@" ' + " ".join(shell), "sh", *words]
    environment = {**os.environ, "PYTHONPATH": ROOT} | environment
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=False, env=environment)


@pytest.mark.parametrize(
    ("body", "code", "words"),
    [
        ("pass", 0, ""),
        ("raise ValueError('first\\nsecond')", 3, "plant: unforeseen ValueError: first second; the traceback is in "),
        ("1 / 0", 3, "plant: unforeseen ZeroDivisionError: "),
        ("from bus.errors import UsageError; raise UsageError('no')", 2, "plant: no"),
        ("raise KeyboardInterrupt", 130, ""),
    ],
)
def test_how_a_body_ends_is_the_exit_code_and_one_line(body: str, code: int, words: str, tmp_path: Path) -> None:
    """What was not foreseen is infrastructure (3), in one line; its traceback is in the file that the line names."""
    done = run_code(RAISE.format(body=body), TMPDIR=str(tmp_path))
    assert done.returncode == code
    assert done.stderr.startswith(words)
    assert done.stderr.count("\n") == bool(words)
    traces = list(tmp_path.iterdir())
    assert len(traces) == ("unforeseen" in words)
    for trace in traces:
        assert str(trace) in done.stderr
        assert "Traceback (most recent call last)" in trace.read_text()


def test_a_bus_that_went_because_all_are_told_to_end_is_no_error() -> None:
    """Told to end a moment after the others have gone: the signal's exit code and no word; not told, the error as it is."""
    lose = "from bus.errors import BusLostError; raise BusLostError('the host of the bus has gone')"
    told = "import os, signal, threading; threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGTERM)).start(); "
    done = run_code(RAISE.format(body=told + lose))
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, "")
    done = run_code(RAISE.format(body=lose))
    assert (done.returncode, done.stderr) == (3, "plant: the host of the bus has gone\n")


def test_the_traceback_goes_where_it_is_wanted(tmp_path: Path) -> None:
    """To stderr for `--debug`; nowhere, with a word of it, when there is no place to write."""
    shown = run_code(RAISE.format(body="1 / 0"), HILSAT_TRACES="-")
    assert "Traceback" in shown.stderr
    assert shown.stderr.endswith("the traceback is above; please report it\n")
    lost = run_code(RAISE.format(body="1 / 0"), HILSAT_TRACES=str(tmp_path / "nowhere"))
    assert lost.returncode == 3
    assert lost.stderr.endswith("start it with `hilsat --debug` to see the traceback; please report it\n")


def test_a_storm_of_signals_ends_a_process_once() -> None:
    """Three signals while it cleans up: the code of the first, no traceback, and the cleaning up goes on to its end."""
    body = """
    import os, signal, time
    try:
        os.kill(os.getpid(), signal.SIGTERM); time.sleep(5)
    finally:
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
            os.kill(os.getpid(), number)
        time.sleep(0.01); print("cleaned")
    """
    done = run_code(RAISE.format(body=body.strip()))
    assert (done.returncode, done.stdout, done.stderr) == (143, "cleaned\n", "")


def test_a_hang_up_is_as_good_as_sigterm_unless_switched_off() -> None:
    """SIGHUP ends the body with 129; started by nohup it does not."""
    body = "import os, signal, time; os.kill(os.getpid(), signal.SIGHUP); time.sleep(0.01)"
    assert run_code(RAISE.format(body=body)).returncode == 129
    words = ["nohup", sys.executable, "-P", "-c", RAISE.format(body=body)]
    environment = {**os.environ, "PYTHONPATH": ROOT}
    assert subprocess.run(words, env=environment, capture_output=True, timeout=60, check=False).returncode == 0


def test_every_signal_has_a_name() -> None:
    """The kernel has 64; Python names 31 and the two ends of the rest."""
    assert [name_signal(number) for number in (9, 40, 64)] == ["SIGKILL", "signal 40", "SIGRTMAX"]


@pytest.mark.parametrize("closed", [c for n in (1, 2, 3) for c in itertools.combinations((0, 1, 2), n)])
def test_closed_streams_are_as_good_as_dev_null(closed: tuple[int, ...]) -> None:
    """0, 1, 2 are open afterwards, also for children, and nothing that is opened later gets their numbers."""
    code = """
import os, subprocess, sys
from bus.streams import open_streams, read_failure
open_streams(); open_streams()
fd = os.open("/dev/null", os.O_RDONLY)
assert fd > 2 and all(os.get_inheritable(n) for n in (0, 1, 2))
print("out"); print("err", file=sys.stderr); sys.stdin.read()
subprocess.run(["sh", "-c", "echo a; echo b >&2; cat"], check=True)
assert read_failure(sys.stdout) is None
"""
    shell = [f"{fd}{'<' if fd == 0 else '>'}&-" for fd in closed]
    done = run_code(code, *shell, "" if 0 in closed else "</dev/null")
    assert done.returncode == 0, done.stderr
    assert done.stdout == ("" if 1 in closed else "a\nout\n")
    assert done.stderr == ("" if 2 in closed else "err\nb\n")


@pytest.mark.parametrize(
    "environment",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"PYTHONIOENCODING": "ascii"},
        {"PYTHONIOENCODING": "latin-1:strict"},
        {"PYTHONIOENCODING": "utf-8:strict"},
    ],
)
def test_text_that_a_terminal_cannot_show_is_shown_by_number(environment: dict[str, str]) -> None:
    """Letters beyond the encoding and a lone surrogate, on stdout and stderr: no error in any encoding."""
    code = """
import sys
from bus.streams import open_streams
open_streams()
for stream in (sys.stdout, sys.stderr):
    print("St\\xf6rung \\u03bb \\udc80", file=stream)
"""
    words = [sys.executable, "-P", "-c", code]
    done = subprocess.run(
        words, capture_output=True, timeout=60, check=False, env={**os.environ, "PYTHONPATH": ROOT} | environment
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == done.stderr
    assert b"\\udc80" in done.stdout
    assert (b"\\u03bb" in done.stdout) == ("utf-8:strict" not in environment.values())


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_stream_fails_nothing_and_is_told(unbuffered: str) -> None:
    """Both streams on /dev/full, buffered and not: the code of the work stands, the failure can be asked for."""
    code = """
import sys
from bus.streams import open_streams, read_failure
open_streams()
print("x" * 100000); print("y", file=sys.stderr)
sys.exit(read_failure(sys.stdout).errno)
"""
    assert run_code(code, ">/dev/full", "2>/dev/full", PYTHONUNBUFFERED=unbuffered).returncode == 28


def test_a_reader_that_went_away_is_still_noticed() -> None:
    """On stdout it is a BrokenPipeError, as for every filter; on stderr it is nothing."""
    code = """
import os, sys
from bus.streams import open_streams, read_failure
read_end, write_end = os.pipe(); os.close(read_end); os.dup2(write_end, {fd})
open_streams()
try:
    print("x", file=(sys.stdout, sys.stderr)[{fd} - 1]); read_failure(sys.stdout)
except BrokenPipeError:
    os._exit(141)
"""
    assert [run_code(code.format(fd=fd)).returncode for fd in (1, 2)] == [141, 0]


def test_signals_are_what_they_were_after_a_run() -> None:
    """A runner inside a larger program gives the handlers back."""
    code = """
import signal
from bus.process import ENDING, raise_signals
before = [signal.getsignal(number) for number in ENDING]
with raise_signals() as came:
    assert [signal.getsignal(number) for number in ENDING] != before
assert [signal.getsignal(number) for number in ENDING] == before and came == []
"""
    assert run_code(code).returncode == 0
    assert signal.SIGHUP in signal.Signals
