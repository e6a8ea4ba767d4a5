"""`hilsat vcan exec` for real: every test starts a guest (or, where the kernel has CAN, a namespace) and looks at it.

Nothing here skips: where no backend comes up, the tests fail with the reason that the program gives.
"""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

import tools
from tools.vcan import kernel, packages, session, uml

pytestmark = pytest.mark.vcan_host

ROOT = str(Path(tools.__file__).resolve().parent.parent)
VCAN = [sys.executable, "-P", "-m", "tools.vcan"]
WAIT_S = 120.0


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": ROOT, **more}


def run_exec(
    *words: str, cwd: Path | None = None, env: dict[str, str] | None = None, code: int | None = 0
) -> subprocess.CompletedProcess[bytes]:
    """Run `vcan exec` and demand its exit code; the program's own reason is in the failure."""
    command = [*VCAN, "exec", *words]
    result = subprocess.run(
        command, cwd=cwd, env=env or environment(), capture_output=True, timeout=WAIT_S, check=False
    )
    if code is not None:
        assert result.returncode == code, f"exit code {result.returncode}\n{result.stderr.decode(errors='replace')}"
    return result


def start_exec(*words: str, cwd: Path, env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
    """Start `vcan exec` of a command that prints "ready", and return when it has."""
    process = subprocess.Popen(
        [*VCAN, "exec", *words], cwd=cwd, env=env or environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout
    assert process.stderr
    line = process.stdout.readline()
    if line != b"ready\n":
        pytest.fail(f"the command did not begin: {line!r} {process.stderr.read().decode(errors='replace')}")
    return process


def find_leftovers(base: Path) -> tuple[list[str], list[str]]:
    """Return what is in a directory for temporary files, and the processes whose command line names it."""
    commands = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            text = path.read_bytes()
        except OSError:
            continue
        if os.fsencode(base) in text:
            commands.append(f"{path.parent.name} {text[:80]!r}")
    return [path.name for path in base.iterdir()], commands


@pytest.fixture(scope="module")
def can_utils() -> Path:
    """The directory of candump and cansend: the host's, else from Debian's package in the cache."""
    if found := packages.find_program("candump"):
        return Path(found).parent
    return packages.unpack("can-utils")[0] / "usr/bin"


@pytest.fixture
def time_travel() -> None:
    """Fail, with the line to run, where the time-travel kernel is not built."""
    if kernel.find_kernel() is None:
        pytest.fail(f"no time-travel kernel; run `hilsat vcan kernel build` once ({kernel.COST})")


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_exit_code_streams_environment_and_directory(tmp_path: Path) -> None:
    """The command runs as if started here: same interpreter, same directory, same variables; streams stay apart."""
    code = (
        "import os, sys; print(os.getcwd(), os.environ['ODD'], os.environ['HILSAT_REQUIRE_VCAN'], sys.prefix);"
        "print('to stderr', file=sys.stderr); sys.exit(77)"
    )
    odd = "a b'c\"$HOME\nd"
    result = run_exec("--", *python(code), cwd=tmp_path, env=environment(ODD=odd), code=77)
    assert result.stdout.decode() == f"{tmp_path} {odd} 1 {sys.prefix}\n"
    assert result.stderr.splitlines()[-1] == b"to stderr"


def test_both_streams_are_byte_exact(tmp_path: Path) -> None:
    """Eight megabytes of every byte value on each stream, compared by SHA-256 with what was in the file."""
    data = b"".join(hashlib.sha256(str(i).encode()).digest() for i in range(1 << 18))
    (tmp_path / "data").write_bytes(data)
    result = run_exec("--", "sh", "-c", "cat data; cat data >&2", cwd=tmp_path)
    assert hashlib.sha256(result.stdout).digest() == hashlib.sha256(data).digest()
    assert hashlib.sha256(result.stderr[-len(data) :]).digest() == hashlib.sha256(data).digest()


def test_programs_that_cannot_be_run_have_the_codes_of_env(tmp_path: Path) -> None:
    """env(1): 126 found but cannot be invoked, 127 cannot be found; 128 + n for a signal."""
    run_exec("--", "/no/such/program", cwd=tmp_path, code=127)
    run_exec("--", "/etc/passwd", cwd=tmp_path, code=126)
    run_exec("--", "sh", "-c", "kill -KILL $$", cwd=tmp_path, code=137)


CLOSING = """
import signal, sys, time
def close(number, frame):
    time.sleep(0.3)
    open("log", "a").write(f"closed by {number}")
    print("closed", flush=True)
    sys.exit(42)
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, close)
print("ready", flush=True)
while True:
    time.sleep(0.05)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_closes_its_log_after_a_signal(number: signal.Signals, tmp_path: Path) -> None:
    """The signal arrives inside, the command finishes what it does on one, its own exit code comes back."""
    process = start_exec("--", *python(CLOSING), cwd=tmp_path)
    process.send_signal(number)
    out, _ = process.communicate(timeout=WAIT_S)
    assert (process.returncode, out) == (42, b"closed\n")
    assert (tmp_path / "log").read_text() == f"closed by {int(number)}"


def test_the_third_interrupt_ends_what_ignores_them(tmp_path: Path) -> None:
    """Nobody has to reach for kill -9."""
    script = "trap '' INT; echo ready; while :; do sleep 0.1; done"
    process = start_exec("--", "sh", "-c", script, cwd=tmp_path)
    for _ in range(3):
        process.send_signal(signal.SIGINT)
        time.sleep(0.3)
    process.communicate(timeout=WAIT_S)
    assert process.returncode == 128 + signal.SIGINT


def test_the_time_limit_ends_the_command_with_124(tmp_path: Path) -> None:
    """The command is told TERM and its last words still arrive."""
    script = "trap 'echo last words; exit 0' TERM; while :; do sleep 0.1; done"
    begin = time.monotonic()
    result = run_exec("--timeout", "4", "--", "sh", "-c", script, cwd=tmp_path, code=124)
    assert result.stdout == b"last words\n"
    assert b"time limit of 4 s" in result.stderr
    assert 4.0 <= time.monotonic() - begin < 30.0


@pytest.mark.parametrize("how", ["finished", "interrupted", "killed"])
def test_nothing_is_left_behind(how: str, tmp_path: Path) -> None:
    """No process and no directory, also with children in the background and after kill -9 of the program itself."""
    base = tmp_path / "temporary"
    base.mkdir()
    script = "sleep 600 & echo ready; sleep 2"
    process = start_exec("--", "sh", "-c", script, cwd=tmp_path, env=environment(TMPDIR=str(base)))
    assert len(find_leftovers(base)[0]) == 1
    assert find_leftovers(base)[1]
    if how == "interrupted":
        process.send_signal(signal.SIGINT)
    elif how == "killed":
        process.kill()
    process.communicate(timeout=WAIT_S)
    deadline = time.monotonic() + 10.0
    while find_leftovers(base)[1] and time.monotonic() < deadline:
        time.sleep(0.1)
    if how == "killed":  # nobody was there to remove the directory; the next run does, once it is ten seconds old
        time.sleep(session.STALE_S)
        run_exec("--", "true", cwd=tmp_path, env=environment(TMPDIR=str(base)))
    assert find_leftovers(base) == ([], [])


def test_only_the_named_directories_are_the_hosts_own(tmp_path: Path) -> None:
    """The current directory and --rw (a blank in its name) write through; elsewhere in a guest writes are dropped."""
    own, other, work = tmp_path / "own dir", tmp_path / "other", tmp_path / "work"
    for path in (own, other, work):
        path.mkdir()
    script = 'echo a >here; echo b >"$1/there"; echo c >"$2/gone"; cat "$2/gone"'
    result = run_exec(
        "--backend", "uml", "--rw", str(own), "--", "sh", "-c", script, "sh", str(own), str(other), cwd=work
    )
    assert result.stdout == b"c\n"
    assert (work / "here").read_text() == "a\n"
    assert (own / "there").read_text() == "b\n"
    assert list(other.iterdir()) == []


def test_can_sockets_need_no_privilege_inside(tmp_path: Path) -> None:
    """A command that has become nobody, without any capability, still sends and receives on vcan0."""
    code = (
        "import os, socket; os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "a, b = (socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) for _ in range(2))\n"
        "a.bind(('vcan0',)); b.bind(('vcan0',)); a.send(bytes(8) + b'12345678'); print(os.getuid(), b.recv(16)[8:])"
    )
    assert run_exec("--backend", "uml", "--", *python(code), cwd=tmp_path).stdout == b"65534 b'12345678'\n"


def test_candump_sees_what_cansend_sends(can_utils: Path, tmp_path: Path) -> None:
    """Two processes of somebody else's program over vcan0: data, extended id, remote and CAN FD frames."""
    script = (
        f"PATH={can_utils}:$PATH; candump -n 4 vcan0 >dump & sleep 0.5\n"
        "cansend vcan0 123#DEADBEEF; cansend vcan0 1ABCDEF0#; cansend vcan0 7FF#R4; cansend vcan0 080##1AABBCC\n"
        "wait; cat dump"
    )
    lines = run_exec("--", "sh", "-c", script, cwd=tmp_path).stdout.decode().split("\n")
    words = [line.split() for line in lines if line]
    assert [word[1:3] for word in words] == [["123", "[4]"], ["1ABCDEF0", "[0]"], ["7FF", "[4]"], ["080", "[03]"]]
    assert words[0][3:] == ["DE", "AD", "BE", "EF"]
    assert words[2][3:] == ["remote", "request"]


def test_two_interfaces_are_two_buses(can_utils: Path, tmp_path: Path) -> None:
    """A frame on vcan1 is seen on vcan1 and not on vcan0."""
    script = (
        f"PATH={can_utils}:$PATH; candump -T 1500 vcan0 >d0 & candump -T 1500 vcan1 >d1 & sleep 0.5\n"
        "cansend vcan1 222#02; cansend vcan0 111#01; wait; cat d0; echo --; cat d1"
    )
    out = run_exec("--can", "vcan0,vcan1", "--", "sh", "-c", script, cwd=tmp_path).stdout.decode()
    on0, on1 = out.split("--")
    assert on0.split()[:2] == ["vcan0", "111"]
    assert on1.split()[:2] == ["vcan1", "222"]
    assert len(on0.split()) == len(on1.split()) == 4


NESTED = [*VCAN, "exec", "--backend", "native", "--can", "vcan7"]


def test_a_kernel_with_can_runs_it_natively(tmp_path: Path) -> None:
    """Inside a guest, whose kernel has CAN, exec takes a namespace: its own interface, code, streams, no orphans."""
    inner = (
        "import os, socket; print([name for _, name in socket.if_nameindex() if 'can' in name]); os.write(2, b'err')\n"
        "os.spawnlp(os.P_NOWAIT, 'sleep', 'sleep', '600'); raise SystemExit(9)"
    )
    outer = (
        "import pathlib, subprocess\n"
        f"r = subprocess.run({[*NESTED, '--', *python(inner)]!r}, capture_output=True)\n"
        "print(r.returncode, r.stdout, r.stderr)\n"
        "print([p.read_text() for p in pathlib.Path('/proc').glob('[0-9]*/comm')].count('sleep\\n'))"
    )
    lines = run_exec("--backend", "uml", "--", *python(outer), cwd=tmp_path).stdout.decode().splitlines()
    assert lines == ["9 b\"['vcan7']\\n\" b'err'", "0"]


def test_a_user_without_rights_runs_it_natively_in_a_user_namespace(tmp_path: Path) -> None:
    """Inside a guest and as nobody: user and network namespace together, root only within them."""
    tmp_path.chmod(0o777)
    code = (
        "import os, pathlib, sys\n"
        "for path in map(os.path.realpath, (sys.executable, os.getcwd())):\n"
        "  for parent in pathlib.Path(path).parents:  # in the guest's own copy: let nobody in\n"
        "    os.chmod(parent, 0o755)\n"
        "os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "os.execv('/usr/bin/env', ['env', *sys.argv[1:]])"
    )
    inner = "import os, socket; print(os.getuid(), socket.if_nameindex()[-1][1])"
    result = run_exec("--backend", "uml", "--", *python(code), *NESTED, "--", *python(inner), cwd=tmp_path)
    assert result.stdout == b"0 vcan7\n"


def test_up_and_down_make_and_remove_interfaces(tmp_path: Path) -> None:
    """The two verbs on a kernel that has CAN, and exit code 2 for a name that is taken by something else."""
    vcan = f"{sys.executable} -P -m tools.vcan"
    script = (
        f"{vcan} up vcan0 vcan5; {vcan} status --json >s; {vcan} down vcan5; {vcan} down vcan5; {vcan} down lo; echo $?"
    )
    out = run_exec("--backend", "uml", "--", "sh", "-c", script, cwd=tmp_path).stdout.decode().splitlines()
    assert out == [
        "vcan0: is up already (vcan)",
        "vcan5: made and switched on",
        "vcan5: removed",
        "vcan5: is not there",
        "2",
    ]
    assert '"name": "vcan5"' in (tmp_path / "s").read_text()


HOUR = """
import time
begin = time.time_ns(), time.monotonic_ns()
time.sleep(3600)
print(begin, time.time_ns(), time.monotonic_ns())
"""
PAIR = """
import os, random, socket, struct, time
FRAME = struct.Struct("=IB3x8s")
def open_bus():
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.bind(("vcan0",))
    return bus
bus = open_bus()
if os.fork() == 0:
    echo = open_bus()
    print("ready", flush=True)
    while True:
        frame = echo.recv(16)
        if frame[:4] == b"\\x01\\0\\0\\0":
            time.sleep(0.0003)
            echo.send(FRAME.pack(2, 8, frame[8:]))
time.sleep(1)
draw, next_ns = random.Random(5), time.monotonic_ns()
for tick in range(3000):
    next_ns += 10_000_000
    time.sleep((next_ns - time.monotonic_ns()) / 1e9)
    sent_ns = time.monotonic_ns()
    bus.send(FRAME.pack(1, 8, draw.randbytes(8)))
    answer = bus.recv(16)
    print(tick, sent_ns, time.monotonic_ns() - sent_ns, answer.hex())
os.kill(0, 15)
"""


def test_an_hour_of_sleep_takes_no_time_in_virtual_time(time_travel: None, tmp_path: Path) -> None:
    """Both clocks advance by the hour (to 1 ms), the wall clock hardly; it starts at the fixed epoch."""
    begin = time.monotonic()
    text = run_exec("--virtual-time", "--", *python(HOUR), cwd=tmp_path).stdout.decode()
    assert time.monotonic() - begin < 60.0
    wall, mono, wall_end, mono_end = (int(word.strip("(),")) for word in text.split())
    assert abs(wall_end - wall - 3600 * 10**9) < 10**6
    assert abs(mono_end - mono - 3600 * 10**9) < 10**6
    assert 0 <= wall - uml.EPOCH_NS < 60 * 10**9


def test_two_runs_in_virtual_time_are_identical(time_travel: None, tmp_path: Path) -> None:
    """30 s at 100 Hz, two processes over vcan0: every payload, time stamp and latency equal to the nanosecond."""
    begin = time.monotonic()
    first, second = (run_exec("--virtual-time", "--", *python(PAIR), cwd=tmp_path, code=143).stdout for _ in range(2))
    assert first == second
    assert len(first.splitlines()) == 3001
    assert time.monotonic() - begin < 60.0  # twice 31 s of virtual time


def test_an_idle_guest_in_virtual_time_still_hears_an_interrupt(time_travel: None, tmp_path: Path) -> None:
    """With no timer set, virtual time stands still; the control line must wake the guest all the same."""
    code = (
        "import os\nprint('ready', flush=True)\ntry:\n os.read(os.pipe()[0], 1)\n"
        "except KeyboardInterrupt:\n raise SystemExit(42)"
    )
    process = start_exec("--virtual-time", "--", *python(code), cwd=tmp_path)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=WAIT_S)
    assert process.returncode == 42


def test_a_guest_that_does_not_come_up_is_125_with_its_last_words(tmp_path: Path) -> None:
    """A kernel that panics at once: exit code 125, the console's text, and the meaning of a known panic."""
    place = tmp_path / "cache/packages/user-mode-linux"
    (place / "usr/bin").mkdir(parents=True)
    (place / packages.RECORD).write_text("{}")
    fake = place / "usr/bin/linux.uml"
    fake.write_text("#!/bin/sh\necho 'Kernel panic - not syncing: ptrace set fp regs failed, errno = 14'; exit 1\n")
    fake.chmod(0o755)
    env = environment(HILSAT_CACHE=str(tmp_path / "cache"))
    result = run_exec("--backend", "uml", "--", "true", cwd=tmp_path, env=env, code=125)
    assert b"did not come up" in result.stderr
    assert b"XSAVE" in result.stderr
    assert b"Kernel panic" in result.stderr


def test_real_time_runs_in_the_fifo_class(tmp_path: Path) -> None:
    """On one processor, or with the reason why this user may not."""
    words: Sequence[str] = ("--real-time", "--", *python("print('ran')"))
    result = run_exec(*words, cwd=tmp_path, code=None)
    if result.returncode == 125:
        assert b"SCHED_FIFO is not permitted" in result.stderr
        assert os.geteuid() != 0
    else:
        assert (result.returncode, result.stdout) == (0, b"ran\n")
