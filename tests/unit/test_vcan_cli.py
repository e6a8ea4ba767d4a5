"""`hilsat vcan`: what a command line is taken to mean, and what a wrong one is answered."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import pytest

from bus.errors import UsageError
from tools.vcan import cli
from tools.vcan.machine import Request

ROOT = Path(cli.__file__).resolve().parents[2]


def parse(*argv: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    cli.add_parser(parser.add_subparsers(dest="verb"))
    return parser.parse_args(["vcan", *argv])


def test_exec_reads_every_option_and_keeps_the_command_untouched() -> None:
    """Options before `--` are ours, everything after it is the command's, dashes included."""
    args = parse("exec", "--can", "vcan0,can_b", "--timeout", "2.5", "--mem", "512m", "--", "prog", "--can", "x", "--")
    assert cli.read_request(args) == Request(
        argv=("prog", "--can", "x", "--"), can=("vcan0", "can_b"), timeout_s=2.5, memory_mb=512
    )
    assert args.func is cli.run


def test_exec_takes_a_command_without_the_separator() -> None:
    """`exec sh -c ...` is what people type."""
    assert cli.read_request(parse("exec", "sh", "-c", "exit 3")).argv == ("sh", "-c", "exit 3")


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["exec"], "no command"),
        (["exec", "--can", "", "--", "true"], "names no interface"),
        (["exec", "--can", "vcan0,vcan0", "--", "true"], "named twice"),
        (["exec", "--can", "a_name_of_16_chr", "--", "true"], "1 to 15 letters"),
        (["exec", "--can", "lo", "--", "true"], "not lo"),
        (["exec", "--mem", "2", "--", "true"], "128M to 64G"),
        (["exec", "--mem", "64M", "--", "true"], "128M to 64G"),
        (["exec", "--timeout", "-1", "--", "true"], "-1"),
        (["exec", "--timeout", "nan", "--", "true"], "nan"),
        (["exec", "--rw", "/nowhere/at/all", "--", "true"], "/nowhere/at/all"),
        (["exec", "--rw", "/", "--", "true"], "--rw /"),
        (["exec", "--virtual-time", "--backend", "qemu", "--", "true"], "qemu"),
    ],
)
def test_a_wrong_command_line_is_named_and_ends_with_2(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every refused value appears in the message, and nothing is started."""
    with pytest.raises(UsageError, match=words.replace("(", r"\(")):
        cli.read_request(parse(*argv))
    assert cli.run(parse(*argv)) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.out == ""


def test_virtual_and_real_time_exclude_each_other() -> None:
    """Both at once has no meaning; argparse's own exit code is 2 as well."""
    with pytest.raises(SystemExit) as stopped:
        parse("exec", "--virtual-time", "--real-time", "--", "true")
    assert stopped.value.code == 2


def test_the_module_runs_alone_and_its_json_is_one_object() -> None:
    """`python -P -m tools.vcan` is the same command line, without the rest of hilsat."""
    command = [sys.executable, "-P", "-m", "tools.vcan", "status", "--json"]
    result = subprocess.run(
        command, capture_output=True, text=True, env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    )
    assert result.returncode == 0, result.stderr
    record = json.loads(result.stdout)
    assert [backend["name"] for backend in record["backends"]] == ["native", "uml", "qemu"]
    assert record["has_can"] is (not record["missing"] or "privilege" in record["missing"][0])
