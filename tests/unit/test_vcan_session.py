"""The host's side of a run, against a machine that is a shell script, and the guest's side, against a pipe."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import tools
from tools.vcan import plan, session
from tools.vcan.errors import GuestError
from tools.vcan.machine import Machine
from tools.vcan.session import Session, job_directory

ROOT = str(Path(tools.__file__).resolve().parent.parent)


def run_script(script: str, *, timeout_s: float = 0.0, boot_limit_s: float = 10.0) -> int:
    """Play the machine with a shell script whose directory is the job's."""
    with job_directory() as job:
        for name in plan.STREAMS:
            (job / name).touch()
        (job / "script").write_text(f"cd {job}\n{script}\n")
        fake = Machine("the fake", ["sh", str(job / "script")], dict(os.environ), boot_limit_s=boot_limit_s)
        return Session(job, fake, real_time=False, timeout_s=timeout_s).run()


def test_output_and_exit_code_arrive_unchanged(capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    """Every byte value on either stream, no newline added, none translated."""
    code = run_script(
        'echo -n >started; python3 -c "import sys; sys.stdout.buffer.write(bytes(range(256)) * 999)" >stdout;'
        "printf 'a\\r\\n\\0b' >stderr; echo -n 41 >exit_code; sleep 60"
    )
    out, err = capfdbinary.readouterr()
    assert code == 41
    assert out == bytes(range(256)) * 999
    assert err == b"a\r\n\0b"


def test_a_machine_that_ends_without_an_exit_code_is_described() -> None:
    """What it printed last is in the message, and whether the command had begun."""
    with pytest.raises(GuestError, match="did not come up") as caught:
        run_script("echo some kernel message; exit 1")
    assert "some kernel message" in str(caught.value)
    assert caught.value.exit_code == 125
    with pytest.raises(GuestError, match="went down while the command was running"):
        run_script("touch started; sleep 0.2; exit 1")


def test_a_machine_that_hangs_while_booting_is_given_up() -> None:
    """The limit is on booting alone: a long command is not affected by it."""
    begin = time.monotonic()
    with pytest.raises(GuestError, match=r"did not come up within 0.5 s"):
        run_script("exec sleep 60", boot_limit_s=0.5)
    assert time.monotonic() - begin < 10.0
    assert run_script("touch started; sleep 1; echo -n 0 >exit_code", boot_limit_s=0.5) == 0


def test_known_panics_get_their_reason() -> None:
    """The one message that people with new processors meet is explained."""
    with pytest.raises(GuestError, match="XSAVE area"):
        run_script("echo 'Kernel panic - not syncing: userspace - ptrace set fp regs failed, errno = 14'; exit 1")


def test_after_the_time_limit_the_command_is_asked_to_end_and_124_returned() -> None:
    """The machine is told TERM first; what it then reports does not hide that time ran out."""
    script = (
        "touch started; read word; echo -n $word >word; cp word /tmp/hilsat-test-word; echo -n 0 >exit_code; sleep 60"
    )
    try:
        assert run_script(script, timeout_s=0.3) == session.TIMED_OUT
        assert Path("/tmp/hilsat-test-word").read_text() == "TERM"
    finally:
        Path("/tmp/hilsat-test-word").unlink(missing_ok=True)


def test_a_command_that_ignores_the_time_limit_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the grace the machine is ended under it."""
    monkeypatch.setattr(session, "GRACE_S", 0.3)
    begin = time.monotonic()
    assert run_script("touch started; exec sleep 60", timeout_s=0.2) == session.TIMED_OUT
    assert time.monotonic() - begin < 10.0


def test_signals_are_passed_on_as_words() -> None:
    """INT, then TERM; the exit code stays the command's own."""

    def strike() -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            time.sleep(0.4)
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=strike)
    thread.start()
    script = "touch started; read a; read b; test $a-$b = INT-TERM && echo -n 33 >exit_code || echo -n 1 >exit_code"
    assert run_script(f"{script}; sleep 60") == 33
    thread.join()


def test_nothing_is_left_of_a_machine_with_children(tmp_path: Path) -> None:
    """A grandchild in the background ends with the session, and so does the job's directory."""
    pid_file = tmp_path / "pid"
    jobs = set(Path(session.tempfile.gettempdir()).glob(f"{session.JOB_PREFIX}*"))
    assert run_script(f"sleep 300 & echo $! >{pid_file}; touch started; echo -n 0 >exit_code; sleep 60") == 0
    state = Path(f"/proc/{int(pid_file.read_text())}/stat")
    deadline = time.monotonic() + 5.0
    while state.exists() and ") Z" not in state.read_text() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not state.exists() or ") Z" in state.read_text()
    assert set(Path(session.tempfile.gettempdir()).glob(f"{session.JOB_PREFIX}*")) <= jobs


def test_directories_of_killed_runs_are_swept_and_those_of_live_ones_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lock that falls with its process tells them apart."""
    monkeypatch.setattr(session.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(session, "STALE_S", 0.0)
    dead = tmp_path / f"{session.JOB_PREFIX}dead"
    dead.mkdir()
    (dead / "stdout").write_text("left over")
    reader = subprocess.Popen(
        ["sh", "-c", "read line", f"{dead}/stdout"], stdin=subprocess.PIPE
    )  # somebody looks at it
    orphan = subprocess.Popen(["sh", "-c", "read line", f"init={dead}/init"], stdin=subprocess.PIPE)
    while not Path(
        f"/proc/{orphan.pid}/cmdline"
    ).read_bytes():  # Popen returns before the kernel shows the new arguments
        time.sleep(0.01)
    with job_directory() as live:
        assert orphan.wait(5) == -signal.SIGKILL
        assert reader.poll() is None
        assert not dead.exists()
        assert live.stat().st_mode & 0o077 == 0
        with job_directory():
            assert live.is_dir()
    assert list(tmp_path.iterdir()) == []
    reader.kill()
    reader.wait()


# -- the guest's side ----------------------------------------------------------------------------------------------

SUPERVISE = """
import os, sys
from tools.vcan.supervisor import Command, supervise
sys.exit(supervise(Command(sys.argv[1:], dict(os.environ), os.getcwd(), 1, 2), 0))
"""


def start_supervisor(*argv: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-P", "-c", SUPERVISE, *argv],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": ROOT},
    )


@pytest.mark.parametrize(
    ("command", "code"), [("exit 0", 0), ("exit 77", 77), ("kill -9 $$", 137), ("kill -TERM $$", 143)]
)
def test_the_exit_code_is_the_commands_as_a_shell_tells_it(command: str, code: int) -> None:
    """128 + n for signal n, the convention of POSIX shells."""
    with start_supervisor("sh", "-c", command) as process:
        assert process.wait(20) == code


def test_programs_that_cannot_be_run_have_the_codes_of_env() -> None:
    """env(1): 126 found but cannot be invoked, 127 cannot be found."""
    with start_supervisor("/no/such/program") as process:
        assert process.wait(20) == 127
        assert "/no/such/program" in (process.stderr.read() if process.stderr else "")
    with start_supervisor("/etc/passwd") as process:
        assert process.wait(20) == 126


CLOSING = "import time\ntry:\n print('ready', flush=True)\n time.sleep(60)\nexcept KeyboardInterrupt:\n time.sleep(0.3); print('closed'); raise SystemExit(42)"  # noqa: E501


def test_a_command_may_finish_after_an_interrupt() -> None:
    """Python's own KeyboardInterrupt shows that the disposition was not inherited as ignored."""
    with start_supervisor(sys.executable, "-c", CLOSING) as process:
        assert process.stdin
        assert process.stdout
        assert process.stdout.readline() == "ready\n"
        process.stdin.write("INT\n")
        process.stdin.flush()
        assert process.stdout.read() == "closed\n"
        assert process.wait(20) == 42


def test_an_interrupt_goes_to_the_group_and_a_termination_to_the_command_alone() -> None:
    """As a terminal and kill(1) do. The shell ignores both; only its child reacts."""
    script = "trap '' TERM; trap 'echo shell' INT; sh -c 'trap \"echo child; exit\" INT TERM; echo up; while :; do sleep 0.05; done'; exit 5"  # noqa: E501
    with start_supervisor("sh", "-c", script) as process:
        assert process.stdin
        assert process.stdout
        assert process.stdout.readline() == "up\n"
        process.stdin.write("TERM\nnonsense\n\xff\n")
        process.stdin.flush()
        time.sleep(0.3)
        process.stdin.write("INT\n")
        process.stdin.flush()
        assert sorted(process.stdout.read().split()) == ["child", "shell"]
        assert process.wait(20) == 5


def test_the_end_of_the_line_terminates_the_command() -> None:
    """A host that has gone cannot ask any more; the command is told to end."""
    with start_supervisor("sh", "-c", "trap 'exit 9' TERM; echo up; while :; do sleep 0.05; done") as process:
        assert process.stdin
        assert process.stdout
        assert process.stdout.readline() == "up\n"
        process.stdin.close()
        assert process.wait(20) == 9
