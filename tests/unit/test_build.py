"""Which build a process runs: what is told of trees of the tests' own making, and the ways in that ask."""

from __future__ import annotations

import copy
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

import pytest

import bus
from bus import build, process
from bus.build import CURRENT, LIBRARY, MANIFEST, SOABI, Build, find_build
from bus.errors import UsageError
from tools import cli
from tools.compiled import place, surroundings
from tools.compiled.project import HOME, list_modules
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.run.bench import Bench
from tools.run.provenance import describe_run

T = TypeVar("T")
MODULES = ["bus/linear.py", "fsw/rotation.py"]
STALE = Build(trouble="the compiled build is stale: so it is")


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """The packages of a project with two modules to compile."""
    for package in build.PACKAGES:
        (tmp_path / "home" / package).mkdir(parents=True)
    for name in MODULES:
        (tmp_path / "home" / name).write_text(f"# {name}\n")
    return tmp_path / "home"


@pytest.fixture
def libraries(tmp_path: Path) -> dict[str, Path]:
    """What a compiler made of them, elsewhere."""
    made = {}
    for name in (LIBRARY, *(name.removesuffix(".py") for name in MODULES)):
        made[f"{name}.{SOABI}.so"] = tmp_path / f"made-{len(made)}"
        made[f"{name}.{SOABI}.so"].write_bytes(b"\x7fELF")
    return made


@pytest.fixture
def built(home: Path, libraries: dict[str, Path]) -> Path:
    """The project with its build in place."""
    manifest = place.write_manifest(place.read_sources(home, MODULES), libraries, ["-O2"], needs_librt=False)
    place.put_in_place(home, libraries, manifest)
    return home


def edit_manifest(home: Path, **changes: Any) -> None:
    manifest = json.loads((home / MANIFEST).read_text())
    (home / MANIFEST).write_text(json.dumps(manifest | changes))


def test_who_never_built_runs_plain(home: Path) -> None:
    """No manifest, no library: plain and no trouble, unless the compiled build is asked for."""
    assert find_build(str(home), "").words == find_build(str(home), "plain").words == "plain"
    assert find_build(str(home), "").trouble == ""
    assert "there is no compiled build" in find_build(str(home), "compiled").trouble


def test_a_sound_build_runs_unless_plain_is_chosen(built: Path) -> None:
    """Named with compiler, Python and number of modules; the environment chooses."""
    for choice in ("", "compiled"):
        found = find_build(str(built), choice)
        assert found.compiled, found.trouble
        assert found.words.startswith("compiled: mypyc ")
        assert found.words.endswith(f", {SOABI}, 2 modules")
    assert find_build(str(built), "plain").words == "plain"


def test_a_source_that_was_only_touched_is_not_stale(built: Path) -> None:
    """A copy, or a change that was taken back, has another time and the same content: it is the content that counts."""
    os.utime(built / MODULES[0])
    assert find_build(str(built), "").compiled


@pytest.mark.parametrize("size", ["same", "other"])
def test_a_changed_source_is_stale(built: Path, size: str) -> None:
    """By its hash where only that tells; with the file's name and both ways on, on one line."""
    source = built / MODULES[1]
    source.write_text(source.read_text().upper() if size == "same" else "")
    trouble = find_build(str(built), "").trouble
    assert trouble == f"the compiled build is stale: {MODULES[1]} has changed since; {build.MEND}"
    assert all(way in trouble for way in ("`make compiled`", "HILSAT_BUILD=plain", "`make plain`"))
    assert find_build(str(built), "compiled").trouble == trouble
    assert find_build(str(built), "plain").trouble == ""


def test_a_source_or_library_that_is_gone_or_short_is_stale(built: Path) -> None:
    """Also a library that a full disk cut off."""
    library = built / f"{LIBRARY}.{SOABI}.so"
    library.write_bytes(b"")
    assert f"{LIBRARY}.{SOABI}.so is not what was built" in find_build(str(built), "").trouble
    library.unlink()
    assert f"{LIBRARY}.{SOABI}.so is missing" in find_build(str(built), "").trouble
    (built / MODULES[0]).unlink()
    assert f"{MODULES[0]} has changed" in find_build(str(built), "").trouble


def test_another_python_and_a_missing_librt_are_told(built: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither would be noticed by the import, or only with a traceback."""
    edit_manifest(built, librt="0.1.2")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install librt==0.1.2" in find_build(str(built), "").trouble
    edit_manifest(built, soabi="cpython-39-other")
    assert f"it is for cpython-39-other, this is {SOABI}" in find_build(str(built), "").trouble


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"soabi": 1', "\0"])
def test_a_damaged_manifest_is_told(built: Path, text: str) -> None:
    """Whatever is in the file: words, no traceback."""
    (built / MANIFEST).write_text(text)
    trouble = find_build(str(built), "").trouble
    assert trouble == f"the compiled build is stale: {MANIFEST} is damaged; {build.MEND}"


def test_a_wrong_choice_is_told(home: Path) -> None:
    """A mistake in the variable must not pass for the default."""
    assert find_build(str(home), "Plain").trouble == "HILSAT_BUILD=Plain is neither plain nor compiled"


@pytest.mark.parametrize("steps", range(5))
def test_half_a_build_never_runs(
    home: Path, libraries: dict[str, Path], steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed after any number of files are in place: plain while there is none, refused until all are."""

    class Killed(BaseException):
        pass

    done: list[object] = []

    def guarded(work: Any) -> Any:
        def step(*arguments: Any) -> None:
            if len(done) == steps:
                raise Killed
            done.append(work(*arguments))

        return step

    monkeypatch.setattr(place, "remove_build", lambda home: None)  # a killed process cleans nothing up
    monkeypatch.setattr(shutil, "copy", guarded(shutil.copy))
    monkeypatch.setattr(os, "replace", guarded(os.replace))
    manifest = place.write_manifest(place.read_sources(home, MODULES), libraries, [], needs_librt=False)
    if steps < 4:
        with pytest.raises(Killed):
            place.put_in_place(home, libraries, manifest)
    else:
        place.put_in_place(home, libraries, manifest)
    found = find_build(str(home), "")
    assert found.compiled == (steps == 4)
    assert ("begun and not finished" in found.trouble) == (0 < steps < 4)


def test_a_build_that_fails_on_the_way_in_leaves_nothing(
    home: Path, libraries: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk, Ctrl-C: what was put in place is taken out again."""

    def fail(*paths: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", fail)
    before = sorted(home.rglob("*"))
    with pytest.raises(KeyboardInterrupt):
        place.put_in_place(home, libraries, "{}")
    assert sorted(home.rglob("*")) == before


@pytest.mark.parametrize("choice", ["", "plain"])
def test_a_plain_process_sees_sources_alone(tmp_path: Path, choice: str) -> None:
    """A library beside a source, which Python would take first, is not looked at; nor one that comes while it runs."""
    shutil.copytree(
        HOME / "bus", tmp_path / "bus", ignore=shutil.ignore_patterns("*.so", "compiled.json", "__pycache__")
    )
    (tmp_path / f"bus/linear.{SOABI}.so").write_text("no library at all")
    code = (
        "import bus, pathlib, sys\n"
        f"pathlib.Path(bus.__file__).with_name('attitude.{SOABI}.so').write_text('')\n"
        "import bus.attitude, bus.linear; print(bus.attitude.__file__, bus.linear.__file__)"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], env={**os.environ, "PYTHONPATH": str(tmp_path), "HILSAT_BUILD": choice},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split() == [f"{tmp_path}/bus/attitude.py", f"{tmp_path}/bus/linear.py"], done.stderr


def test_every_package_settles_it_first() -> None:
    """Whichever package is imported first, the finder is in place before a module of it is looked for."""
    for package in ("fsw", "plant_server", "tools"):
        code = f"import {package}, sys; print(*sorted(n for n in sys.modules if n.startswith('bus')))"
        done = subprocess.run([sys.executable, "-c", code], cwd=HOME, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "bus bus.build"


def test_the_ways_in_refuse(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The command, the processes and the bench: exit code 2 or its error, one line, nothing done."""
    for module in (cli, process):
        monkeypatch.setattr(module, "CURRENT", STALE)
    assert cli.main(["--version"]) == 2
    assert process.run_process("fsw", lambda: pytest.fail("it ran")) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == f"hilsat: {STALE.trouble}\nfsw: {STALE.trouble}\n"
    monkeypatch.setattr("tools.run.bench.CURRENT", STALE)
    with pytest.raises(UsageError, match="stale"):
        Bench.open("nominal")


def test_version_and_log_say_which_build(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the same words, in one line on a narrow terminal too: a figure is worth nothing without them."""
    monkeypatch.setenv("COLUMNS", "20")
    with pytest.raises(SystemExit):
        cli.main(["--version"])
    assert re.fullmatch(rf"hilsat \S+ \({re.escape(CURRENT.words)}\)\n", capsys.readouterr().out)
    resolved = load_scenario(find_scenario("nominal"))
    assert describe_run(resolved, "none")["build"] == CURRENT.words


def test_what_a_machine_lacks_is_told_in_a_line(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiler, one that does not compile, headers, a place to write to, packages: each with what brings it."""
    with monkeypatch.context() as patch:
        patch.setenv("CC", "no-such-compiler -pipe")
        assert "no C compiler 'no-such-compiler -pipe': sudo apt-get" in surroundings.describe_missing(home)
        patch.setenv("CC", "false")
        assert "'false' does not compile" in surroundings.describe_missing(home)
    monkeypatch.setenv("CC", "true")
    assert "'true' does not compile" in surroundings.describe_missing(home)  # it made nothing
    monkeypatch.setattr(surroundings, "_miss_compiler", lambda: "")
    with monkeypatch.context() as patch:
        patch.setattr("sysconfig.get_path", lambda name: str(home))
        assert f"headers of Python are missing ({home}/Python.h): sudo apt" in surroundings.describe_missing(home)
    monkeypatch.setattr(surroundings, "_miss_headers", lambda: "")
    assert surroundings.describe_missing(home) == ""
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda path, mode: Path(path).name != "fsw")
        assert surroundings.describe_missing(home).startswith(f"{home}/fsw cannot be written to")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert surroundings.describe_missing(home) == "the Python package mypy is missing: `make setup` installs it"


def test_the_list_of_modules_is_sorted_and_there(tmp_path: Path) -> None:
    """Ours is; one that is not says what is wrong with it."""
    assert list_modules(HOME)
    project = tmp_path / "pyproject.toml"
    for modules, words in (
        (["b.py", "a.py"], "not sorted"),
        (["a.py", "a.py"], "twice"),
        (["a.py"], "no such file: a.py"),
    ):
        project.write_text(f"[tool.hilsat.compiled]\nmodules = {modules}\n")
        with pytest.raises(ValueError, match=words):
            list_modules(tmp_path)


def test_git_and_the_plain_wheel_leave_a_build_out() -> None:
    """Both go by .gitignore."""
    ignored = (Path(bus.__file__).resolve().parents[1] / ".gitignore").read_text().splitlines()
    assert {"*.so", f"{MANIFEST}*"} <= set(ignored)


@pytest.mark.parametrize(
    ("target", "choice", "compiles"), [("wheel", "", False), ("wheel", "1", True), ("sdist", "1", False)]
)
def test_the_wheel_is_plain_unless_asked(
    target: str, choice: str, compiles: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the variable the hook adds nothing; with it, files, the tag, what is needed to build and to run."""
    place_of_it = "hatchling.builders.hooks.plugin.interface"
    for name in (place_of_it[: end.start()] for end in re.finditer(r"\.|$", place_of_it)):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    sys.modules[place_of_it].BuildHookInterface = HatchHook  # type: ignore[attr-defined]
    monkeypatch.delitem(sys.modules, "tools.compiled.wheel_hook", raising=False)
    hook: Any = importlib.import_module("tools.compiled.wheel_hook").CompiledWheel(target)
    monkeypatch.delitem(sys.modules, "tools.compiled.wheel_hook")
    monkeypatch.setenv("HILSAT_COMPILE", choice)
    made = ({MANIFEST: HOME / "x.json"}, ["librt==0.1.2"])
    monkeypatch.setattr("tools.compiled.build.compile_for_wheel", lambda home: made)
    monkeypatch.setattr(sys, "path", sys.path[:])
    pure: dict[str, Any] = {"pure_python": True, "infer_tag": False, "force_include": {}, "dependencies": []}
    data = copy.deepcopy(pure)
    hook.initialize("editable", data)
    assert data == pure
    hook.initialize("standard", data)
    needed = [re.split(r"[<>=]", word)[0] for word in hook.dependencies()]
    if compiles:
        assert not data["pure_python"]
        assert data["infer_tag"]
        assert data["force_include"] == {str(HOME / "x.json"): MANIFEST}
        assert data["dependencies"] == ["librt==0.1.2"]
        assert {"mypy", "librt", "setuptools", "numpy"} <= set(needed)
    else:
        assert data == pure
        assert needed == []


class HatchHook(Generic[T]):
    """As much of hatchling's interface as the hook uses."""

    root = str(HOME)

    def __init__(self, target_name: str) -> None:
        self.target_name = target_name
