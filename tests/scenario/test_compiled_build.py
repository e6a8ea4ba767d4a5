"""The compiled build from end to end, in copies of the tracked files: built, chosen, noticed when stale, interrupted."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from bus.build import LIBRARY, MANIFEST, MEND
from tools.compiled.project import HOME, SCRATCH
from tools.compiled.surroundings import describe_missing
from tools.log.mcap_reader import read_run

pytestmark = pytest.mark.slow

HILSAT = "tools.cli"
BUILDER = "tools.compiled.build"
GOES_ON = "; the plain build goes on working\n"
SHORT = ["--set", "duration_s=20", "--set", "expect=[]", "--clock", "inprocess", "--no-plot", "--json", "-q"]
STALE = f"the compiled build is stale: bus/linear.py has changed since; {MEND}\n"


class Copy(NamedTuple):
    """A copy of this tree, and how to start what is in it."""

    root: Path

    def environment(self, **changes: str) -> dict[str, str]:
        """Ours, with the copy's packages, no choice of a build, and the changes."""
        kept = {key: value for key, value in os.environ.items() if key not in ("HILSAT_BUILD", "CC")}
        return kept | {"PYTHONPATH": str(self.root)} | changes

    def start(self, module: str, *words: str, **changes: str) -> subprocess.CompletedProcess[str]:
        """Run a module to its end."""
        return subprocess.run(
            [sys.executable, "-P", "-m", module, *words], cwd=self.root, env=self.environment(**changes),
            capture_output=True, text=True, timeout=800, check=False,
        )  # fmt: skip

    def version(self, **changes: str) -> str:
        """Which build runs, in the words of `hilsat --version`."""
        done = self.start(HILSAT, "--version", **changes)
        assert done.returncode == 0, done.stderr
        return done.stdout.partition("(")[2].rstrip(")\n")

    def fly(self, name: str, **changes: str) -> tuple[str, dict[str, Any]]:
        """Digest and `run` metadata of a short run in one process."""
        out = self.root / "runs" / name
        done = self.start(HILSAT, "run", "nominal", "--out", str(out), *SHORT, **changes)
        assert json.loads(done.stdout)["run"]["exit_code"] == 0, done.stderr
        run = read_run(out / "run.mcap")
        return run.digest(), dict(run.metadata["run"])


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    """The tracked files and those that are new, without what is built."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=HOME,
        capture_output=True,
        check=True,
    )
    for name in os.fsdecode(listed.stdout).split("\0"):
        if (HOME / name).is_file():
            (tmp_path / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(HOME / name, tmp_path / "copy" / name)
    return Copy(tmp_path / "copy")


@pytest.fixture
def compiler() -> None:
    """What compiling needs; the plain build does without, and so do the other tests."""
    missing = describe_missing(HOME)
    if missing:
        pytest.skip(missing)


@pytest.mark.timeout(1200)  # it builds: two to five minutes, by what else runs
@pytest.mark.usefixtures("compiler")
def test_built_it_computes_the_same_and_is_refused_when_stale(copy: Copy) -> None:
    """One life of a build: said by version and log, equal digests, plain on demand, stale refused at each way in, mended."""
    digest, metadata = copy.fly("before")
    assert metadata["build"] == "plain"
    done = copy.start(BUILDER)
    assert done.returncode == 0, done.stderr
    words = copy.version()
    assert words.startswith("compiled: mypyc ")
    assert done.stderr == f"make compiled: {words}\n"
    assert copy.fly("compiled") == (digest, metadata | {"build": words} | run_of_its_own(copy, "compiled"))
    assert copy.fly("plain", HILSAT_BUILD="plain")[0] == digest
    where = ["-c", "import fsw, bus.linear; print(bus.linear.__file__)"]
    for choice, suffix in (("", ".so"), ("compiled", ".so"), ("plain", ".py")):
        told = subprocess.run(
            [sys.executable, "-P", *where], env=copy.environment(HILSAT_BUILD=choice), capture_output=True, text=True
        )
        assert told.stdout.strip().endswith(suffix), told

    source = copy.root / "bus" / "linear.py"
    before = source.read_text()
    os.utime(source)
    assert copy.version() == words
    source.write_text(before + "# changed\n")
    for module, name in ((HILSAT, "hilsat"), ("fsw", "fsw"), ("plant_server", "plant")):
        words_of = ["--version"] if module == HILSAT else ["--config", "none"]
        refused = copy.start(module, *words_of)
        assert (refused.returncode, refused.stdout, refused.stderr) == (2, "", f"{name}: {STALE}")
    refused = copy.start("pytest", "tests/unit/test_e2e.py", "-q", "-p", "no:cacheprovider")
    assert refused.returncode == 2
    assert STALE in refused.stdout + refused.stderr
    assert copy.version(HILSAT_BUILD="plain") == "plain"
    assert copy.start(HILSAT, "--version", HILSAT_BUILD="compiled").returncode == 2
    source.write_text(before)
    assert copy.version() == words

    subprocess.run(["make", "plain"], cwd=copy.root, capture_output=True, check=True)
    assert copy.version() == "plain"
    assert built_files(copy) == []
    refused = copy.start(HILSAT, "--version", HILSAT_BUILD="compiled")
    assert refused.returncode == 2
    assert "there is no compiled build" in refused.stderr


def run_of_its_own(copy: Copy, name: str) -> dict[str, Any]:
    """What differs from run to run in the metadata."""
    metadata = read_run(copy.root / "runs" / name / "run.mcap").metadata["run"]
    return {key: metadata[key] for key in ("run_id", "start_utc")}


def built_files(copy: Copy) -> list[Path]:
    """What a build puts in place."""
    scratch = copy.root / SCRATCH
    return [path for path in [*copy.root.rglob("*.so"), *copy.root.glob(f"{MANIFEST}*")] if scratch not in path.parents]


def test_without_a_compiler_it_says_so(copy: Copy, tmp_path: Path) -> None:
    """None on PATH, and one that fails: exit code 2, one line, and the plain build runs."""
    (tmp_path / "empty").mkdir()
    for changes, words in (({"PATH": str(tmp_path / "empty")}, "no C compiler"), ({"CC": "false"}, "does not compile")):
        done = copy.start(BUILDER, **changes)
        assert done.returncode == 2
        assert words in done.stderr
        assert done.stderr.endswith(GOES_ON)
        assert done.stderr.count("\n") == 1
    assert copy.version() == "plain"


@pytest.mark.usefixtures("compiler")
def test_what_does_not_compile_leaves_nothing_in_place(copy: Copy) -> None:
    """A type error and a trap of the rules: words, exit code 1, plain."""
    source = copy.root / "bus" / "linear.py"
    before = source.read_text()
    for addition, words in (
        ("\n\ndef wrong() -> int:\n    return 'text'\n", 'got "str", expected "int"'),
        ("\nFINAL: Final = (1.0, 2.0)\n", "Final on a tuple of floats"),
    ):
        source.write_text(before + addition)
        done = copy.start(BUILDER)
        assert done.returncode == 1, done.stderr
        assert words in done.stdout + done.stderr
        assert done.stderr.endswith(f"make compiled: does not compile{GOES_ON}")
        source.write_text(before)
        assert built_files(copy) == []
        assert copy.version() == "plain"


def start_builder(copy: Copy, ready: Callable[[], bool]) -> subprocess.Popen[str]:
    """A builder at work, in a session of its own, at the moment given."""
    builder = subprocess.Popen(
        [sys.executable, "-P", "-m", BUILDER], cwd=copy.root, env=copy.environment(), stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip
    until = time.monotonic() + 200.0
    while not ready():
        assert builder.poll() is None, "it ended before"
        assert time.monotonic() < until
        time.sleep(0.01)
    return builder


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_interrupted_while_it_compiles_it_leaves_plain(copy: Copy, end: signal.Signals) -> None:
    """Ctrl-C, with words and exit code 130, and a kill, while the C compiler works: the old build is gone, plain runs."""
    stale = copy.root / "bus" / "linear.cpython-39.so"
    stale.write_text("of an old build")
    objects = copy.root / SCRATCH / "object"
    builder = start_builder(copy, objects.exists)
    os.killpg(builder.pid, end)
    said = builder.communicate(timeout=60)[1]
    assert builder.returncode == (130 if end == signal.SIGINT else -end)
    if end == signal.SIGINT:
        assert said.endswith(f"make compiled: interrupted{GOES_ON}")
        assert "Traceback" not in said
    assert built_files(copy) == []
    assert copy.version() == "plain"


@pytest.mark.usefixtures("compiler")
def test_a_second_builder_and_a_half_build_are_told(copy: Copy) -> None:
    """One at a time; and what a kill between two files leaves is refused until one of the ways on is taken."""
    builder = start_builder(copy, (copy.root / SCRATCH / "cache").exists)
    done = copy.start(BUILDER)
    assert (done.returncode, done.stderr) == (2, f"make compiled: another one is at work in this checkout{GOES_ON}")
    os.killpg(builder.pid, signal.SIGKILL)
    builder.communicate()
    (copy.root / f"{LIBRARY}.so").write_text("the first of the files")
    refused = copy.start(HILSAT, "--version")
    assert refused.returncode == 2
    assert refused.stderr == f"hilsat: a compiled build was begun and not finished; {MEND}\n"
    assert copy.version(HILSAT_BUILD="plain") == "plain"
    assert json.loads(copy.start(HILSAT, "check", "nominal", "--json", HILSAT_BUILD="plain").stdout)
