"""The page "Extending hilsat": every extension of it applies to this tree, touches as many files as it says, and works.

Each runs in a copy of the tracked files. What an extension must show there is compared with numbers from outside: the
truth of the plant, the frames on the bus as cantools reads them, closed forms.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "extending.md"
DIFFS = ROOT / "docs" / "extending"
GENERATORS = ("tools.design.generate_codec", "tools.design.generate_icd_page", "tools.config.schema")
GENERATED = {
    "bus/icd/codec.py", "bus/icd/message_table.py", "bus/icd/native_codec.py", "docs/icd.md", "docs/plant.md",
    "docs/scenarios.md", "scenarios/scenario.schema.json",
}  # fmt: skip
BARS = {"controller": 2, "observer": 2, "wheel-fault": 1, "telemetry-topic": 2, "can-message": 4, "sensor": 7}
ROW = re.compile(r"^\| \[[^\]]+\]\(extending/([a-z-]+)\.diff\) \| (\d+) \| (\d+) \|", re.MULTILINE)
EXCERPT = re.compile(r"^## [^\n]*\n.*?(?=^## |\Z)", re.MULTILINE | re.DOTALL)

HEAD = """
import fsw, math
assert fsw.__file__.startswith({root!r}), fsw.__file__
from tools.run.bench import Bench
"""
SHOWS = {
    # Settles to what a law of its frequency and damping must reach, with the published wheels healthy.
    "controller": """
bench = Bench.open("nominal", ["fsw.controller={kind: quaternion_pd, frequency_rad_s: 0.04}", "expect=[]"])
at_start = bench.truth.error_deg
assert at_start > 60.0, at_start
bench.run_to_end()
assert bench.truth.error_deg < 0.1, bench.truth.error_deg

# The law itself, on a spherical body without wheels in the way: critically damped, q(t) = (1 + f t) exp(-f t) q(0).
from bus.linear import ZERO3
from fsw.controllers.quaternion_pd import QuaternionPd, QuaternionPdConfig
from fsw.records import HEALTHY, PointingError
from fsw.vehicle import ModelConfig, Vehicle
sphere = ((40.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0))
law = QuaternionPd(QuaternionPdConfig(kind="quaternion_pd"), Vehicle(ModelConfig(inertia_kgm2=sphere)), 0.1)
angle, rate, dt = 0.01, 0.0, 0.001
for _ in range(50_000):
    half = angle / 2.0
    error = PointingError((math.cos(half), math.sin(half), 0.0, 0.0), (rate, 0.0, 0.0))
    rate += dt * law.step(dt, error, ZERO3, HEALTHY)[0] / 40.0
    angle += dt * rate
expected = 0.01 * (1.0 + 2.0) * math.exp(-2.0)  # after 50 s at 0.04 rad/s
assert abs(angle - expected) < 0.002 * 0.01, (angle, expected)
""",
    # Follows the truth's fault torque, late by its time constant, through the published wheel faults.
    "observer": """
overrides = ["fsw.observer={kind: momentum, time_constant_s: 0.5}", "expect=[]"]
bench = Bench.open("zhang2018", overrides)
bench.step(200)
worst = 0.0
for tick in range(150):
    bench.step()
    hat, true = bench.read("fsw.observer.tau_fault_hat_b_nm"), bench.truth.tau_fault_b_nm
    if tick > 40:  # eight time constants after the step at 20 s; the next one comes at 30 s, tick 100
        if tick < 99:
            worst = max(worst, math.dist(hat, true))
size = math.hypot(*true)
assert size > 0.01, size  # there is something to see
assert worst < 0.1 * size + 1e-3, (worst, size)
bench.run_to_end()
assert bench.truth.error_deg < 0.1, bench.truth.error_deg

# The observer itself: a constant torque d on a body at rest is seen as d (1 - exp(-t/T)).
from bus.linear import ZERO3
from fsw.observers.momentum import Momentum, MomentumConfig
from fsw.vehicle import ModelConfig, Vehicle
sphere = ((40.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0))
vehicle = Vehicle(ModelConfig(inertia_kgm2=sphere))
observer = Momentum(MomentumConfig(kind="momentum", time_constant_s=2.0), vehicle, 0.1)
for k in range(31):
    seen = observer.step(0.1, (0.02 / 40.0 * 0.1 * k, 0.0, 0.0), ZERO3, ZERO3)
assert math.dist(seen, (0.02 * (1.0 - math.exp(-1.5)), 0.0, 0.0)) < 1e-12, seen
""",
    # The torque of the wheel swings about the command as the sine says, and the log says that it bit.
    "wheel-fault": """
fault = "faults=[{unit: wheel.1, kind: ripple, amplitude: 0.5, frequency_rad_s: 2.0, at_s: 1}]"
bench = Bench.open("zhang2018", [fault, "expect=[]"], log="memory")
ratios = {}
for tick in range(100):
    bench.step()
    truth = bench.truth
    if truth.tau_rw_cmd_nm[0]:
        ratios[tick] = truth.tau_rw_true_nm[0] / truth.tau_rw_cmd_nm[0]
assert len(ratios) > 50, len(ratios)
for tick, ratio in ratios.items():  # of the tick that began at 0.1 tick, as its mean over ten steps
    t_s = 0.1 * tick - 1.0
    mean = sum(math.sin(2.0 * (t_s + 0.01 * (k + 0.5))) for k in range(10)) / 10.0
    expected = 1.0 + 0.5 * mean if t_s > -1e-9 else 1.0
    assert abs(ratio - expected) < 1e-9, (tick, ratio, expected)
phases = [(entry["fault"], entry["phase"]) for entry in bench.log.faults]
assert ("ripple", "onset") in phases and ("ripple", "effect") in phases, phases
""",
    # In the log, under its name and with its units, and on a bench: the speeds of the truth to the step of the frames.
    "telemetry-topic": """
bench = Bench.open("zhang2018", ["expect=[]"], log="memory")
speeds = []
for _ in range(200):
    speeds.append(bench.truth.speed_rad_s)
    bench.step()
logged = bench.log.signals("/fsw/wheels")
assert logged["speed_rad_s"].shape == (200, 4), logged["speed_rad_s"].shape
assert max(map(abs, speeds[-1])) > 1.0
assert max(math.dist(a, b) for a, b in zip(logged["speed_rad_s"].tolist(), speeds, strict=True)) < 1.1e-3
assert logged["valid"].min() == 1.0
assert bench.read("fsw.wheels.speed_rad_s") == tuple(logged["speed_rad_s"][-1])
assert abs(logged["current_a"]).max() > 0.1
import ast
from tools.config.signal_names import check_names
assert check_names(ast.parse("norm(fsw.wheels.speed_rad_s)", mode="eval")) == []
assert check_names(ast.parse("norm(fsw.wheels.sped_rad_s)", mode="eval"))
""",
    # Once a second on the bus, decoded from the log by the DBC in it, and taken by the plant.
    "can-message": """
bench = Bench.open("zhang2018", ["expect=[]", "fsw.wheel_health={kind: torque_monitor}"], log="memory")
bench.step(205)
status = bench.log.decoded("FSW_STATUS")
assert list(status["ERROR"].shape) == [21], status["ERROR"].shape
errors = bench.log.signals("/fsw/attitude")["error_deg"][::10]
assert errors.max() > 60.0 and abs(status["ERROR"] - errors).max() < 1e-6, (status["ERROR"], errors)
margins = bench.log.signals("/fsw/control")["margin"][::10]
assert abs(status["MARGIN"] - margins).max() < 0.0026
channel = bench.plant_node.channel
assert abs(channel.fsw_status[1] - errors[-1]) < 1e-6, channel.fsw_status
assert channel.counters.foreign == channel.counters.refused == 0, channel.counters
assert bench.flight.inputs.counters.foreign == 0
""",
    # Blind until the sun comes into view, then the direction that the truth has, to the step of the frames.
    "sensor": """
sun = "plant.sun_sensor={face: '+x', half_angle_deg: 45, right_ascension_deg: 20, declination_deg: -10}"
bench = Bench.open("zhang2018", [sun, "expect=[]"])
import numpy as np
a, d = math.radians(20.0), math.radians(-10.0)
sun_i = np.array([math.cos(d) * math.cos(a), math.cos(d) * math.sin(a), math.sin(d)])
seen = []
for tick in range(3000):
    w, x, y, z = q = bench.truth.q_ib
    bench.step()
    if tick % 10:
        continue
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    sun_b = np.array(rows).T @ sun_i
    sensors = bench.flight.inputs.sensors
    assert sensors.sun_valid == (sun_b[0] > math.cos(math.radians(45.0))), (tick, sun_b, sensors)
    if sensors.sun_valid:
        assert np.abs(np.array(sensors.sun_b) - sun_b).max() < 5e-5, (tick, sun_b, sensors.sun_b)
    seen.append(sensors.sun_valid)
assert not seen[0] and seen[-1]  # both were met
assert bench.flight.inputs.counters.foreign == bench.flight.inputs.counters.refused == 0
plain = Bench.open("zhang2018", ["expect=[]"]).step(20)
assert not plain.flight.inputs.sensors.sun_valid and plain.flight.inputs.counters.unit_fault == 0
try:
    Bench.open("zhang2018", ["plant.sun_sensor={face: top}"])
except Exception as error:
    assert "top" in str(error) and "+x" in str(error), error
else:
    raise AssertionError("a face that there is not was taken")
""",
}


class Copy(NamedTuple):
    """The tracked files of this tree in a directory of their own, and how to run things there."""

    root: Path

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run a command in the copy; fail with what it said unless it ends well."""
        # a copy has no compiled build, whatever the tests run with
        kept = {key: value for key, value in os.environ.items() if not key.startswith("GIT_") and key != "HILSAT_BUILD"}
        env = kept | {"PYTHONPATH": str(self.root)}
        done = subprocess.run(command, cwd=self.root, env=env, capture_output=True, text=True)
        assert done.returncode == 0, f"{command[:4]}: {done.stdout[-2000:]}{done.stderr[-3000:]}"
        return done

    def regenerate(self) -> None:
        """Bring what is generated up to date."""
        for module in GENERATORS:
            self.run(sys.executable, "-P", "-m", module)

    def list_touched(self) -> set[str]:
        """Files that are not as they were when the copy was made."""
        listed = self.run("git", "diff", "--name-only").stdout
        listed += self.run("git", "ls-files", "--others", "--exclude-standard").stdout
        return set(listed.split())


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy without any extension, with what is generated up to date."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("this tree is no git checkout: which files are tracked is not known")
    copy = Copy(tmp_path_factory.mktemp("pristine"))
    for name in listed.stdout.split("\0"):
        if name and (ROOT / name).is_file():
            (copy.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy.root / name)
    copy.regenerate()
    copy.run("git", "init", "-q")
    copy.run("git", "add", "-A")
    return copy


@pytest.mark.slow
@pytest.mark.parametrize("name", BARS)
def test_extension_applies_and_works(name: str, pristine: Copy, tmp_path: Path) -> None:
    """The diff applies with `git apply`, touches as many files as the page says, passes ruff, and does what it is for."""
    stated = {row[0]: (int(row[1]), int(row[2])) for row in ROW.findall(PAGE.read_text(encoding="utf-8"))}
    copy = Copy(tmp_path / "copy")
    shutil.copytree(pristine.root, copy.root)
    copy.run("git", "apply", str(DIFFS / f"{name}.diff"))
    touched = copy.list_touched()
    assert not touched & GENERATED
    assert len(touched) == stated[name][0] <= BARS[name], touched
    copy.regenerate()
    assert len(copy.list_touched() & GENERATED) == stated[name][1], copy.list_touched()
    assert copy.list_touched() - GENERATED == touched
    modules = sorted(path for path in touched if path.endswith(".py"))
    copy.run(sys.executable, "-m", "ruff", "check", "--no-cache", *modules)
    copy.run(sys.executable, "-m", "ruff", "format", "--no-cache", "--check", *modules)
    copy.run(sys.executable, "-P", "-c", HEAD.format(root=str(copy.root)) + SHOWS[name])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("controller", "quaternion_pd"), ("observer", "momentum")])
def test_new_algorithm_keeps_the_contract(name: str, kind: str, pristine: Copy, tmp_path: Path) -> None:
    """The tests that every registered algorithm must pass find the new one by themselves, and it passes them."""
    copy = Copy(tmp_path / "copy")
    shutil.copytree(pristine.root, copy.root)
    copy.run("git", "apply", str(DIFFS / f"{name}.diff"))
    done = copy.run(sys.executable, "-m", "pytest", "-q", "-n", "0", "tests/contract/test_algorithms.py", "-k", kind)
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) >= 3, done.stdout[-500:]


def test_page_names_every_extension_once() -> None:
    """The table of the page has one row for each diff that ships, and for each extension with a bar."""
    rows = [row[0] for row in ROW.findall(PAGE.read_text(encoding="utf-8"))]
    assert sorted(rows) == sorted(BARS) == sorted(path.stem for path in DIFFS.glob("*.diff"))


def test_page_quotes_its_diffs() -> None:
    """Every line that the page shows of a diff stands in that diff, under the heading that links to it."""
    sections = [section for section in EXCERPT.findall(PAGE.read_text(encoding="utf-8")) if "```diff" in section]
    assert len(sections) == len(BARS)
    for section in sections:
        (name,) = set(re.findall(r"\(extending/([a-z-]+)\.diff\)", section))
        lines = (DIFFS / f"{name}.diff").read_text(encoding="utf-8").splitlines()
        quoted = [line for block in re.findall(r"```diff\n(.*?)```", section, re.DOTALL) for line in block.splitlines()]
        assert quoted
        assert [line for line in quoted if line not in lines and line != "..."] == []
