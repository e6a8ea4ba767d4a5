"""Ten thousand runs: what it takes to load, report and compare them. `-s` prints the figures."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

MOST_S, MOST_KB = 10.0, 500_000
MOST_BYTES = 3_000_000
ATTEMPTS = 3  # what else runs on the machine makes a second longer


def measure(words: list[str]) -> tuple[int, float, int]:
    """Exit code, user and system time in s, and largest resident size in kB of one hilsat command."""
    pid = os.posix_spawn(sys.executable, [sys.executable, "-P", "-m", "tools.cli", *words], os.environ)
    _, status, usage = os.wait4(pid, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss


@pytest.mark.slow
def test_ten_thousand_runs(make_results: Callable[..., Path]) -> None:
    """Two campaigns of 10 000 runs, 8 requirements and 6 metrics: each verb within 10 s of processor time and 500 MB."""
    a, b = str(make_results("a", runs=10_000)), str(make_results("b", runs=10_000, seed=2))
    for words in (["show", a], ["report", a], ["diff", a, b], ["export", a, "-f", "--csv", str(Path(a) / "a.csv")]):
        for _ in range(ATTEMPTS):
            code, cpu_s, size_kb = measure(["campaign", *words])
            if code or cpu_s < MOST_S:
                break
            Path(a, "report.html").unlink(missing_ok=True)
        print(f"{words[0]}: {cpu_s:.1f} s, {size_kb / 1000.0:.0f} MB")
        assert code == 0
        assert cpu_s < MOST_S
        assert size_kb < MOST_KB
    assert (Path(a) / "report.html").stat().st_size < MOST_BYTES
