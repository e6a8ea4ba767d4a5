"""Bad scenario files: every problem at its line and column, in words that say what to do, all of them at once."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bus.errors import ConfigError
from bus.words import describe
from tools.config.loader import examine, load_scenario

GOOD = """\
name: bench
duration_s: 10
clock: {tick_hz: 10}
plant:
  body:
    inertia_kgm2: [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]
  wheels:
    - {mount: x}
    - {mount: y}
    - {mount: z, max_torque_nm: 0.1}
    - {mount: skew}
  star_tracker: {rate_hz: 5}
faults:
  - {unit: wheel.1, kind: loss, effectiveness: 0.5, at_s: 2}
fsw:
  model:
    inertia_kgm2: [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]
  estimator: {kind: direct}
  observer: {kind: ilo, period_s: 0.1}
  controller: {kind: smc}
expect:
  - name: settles
    check: settles
    signal: truth.attitude.error_deg
    bound: 1
    by_s: 9
"""


def findings(tmp_path: Path, text: str, *overrides: str) -> list[str]:
    file = tmp_path / "s.yaml"
    file.write_text(text)
    return [finding.headline.replace(f"{tmp_path}/", "") for finding in examine(file, overrides).findings]


def test_the_base_of_these_cases_is_sound(tmp_path: Path) -> None:
    """Otherwise every case below would show something else than it says."""
    assert findings(tmp_path, GOOD) == []


# what is replaced by what, and the messages that must come of it
CASES = [
    ("text", "max_torque_nm: 0.1", "max_torque_nm: fast",
     ['s.yaml:10:33: plant.wheels[2].max_torque_nm: "fast" is not a number [N m]; allowed: > 0']),
    ("range", "max_torque_nm: 0.1", "max_torque_nm: -0.1",
     ["s.yaml:10:33: plant.wheels[2].max_torque_nm: -0.1 N m is out of range; allowed: > 0"]),
    ("near miss", "max_torque_nm: 0.1", "max_torqe_nm: 0.1",
     ['s.yaml:10:18: plant.wheels[2].max_torqe_nm: is not a known key; did you mean "max_torque_nm" [N m]?']),
    ("exponent without a point is a number", "max_torque_nm: 0.1", "max_torque_nm: 1e-3", []),
    ("on is text", "  model:\n", "  model:\n    wheel_momentum: on\n",
     ['s.yaml:17:21: fsw.model.wheel_momentum: "on" is neither true nor false']),
    ("no is text", "name: bench", "name: no", []),
    ("leading zero is decimal", "duration_s: 10", "duration_s: 010", []),
    ("underscore is text", "duration_s: 10", "duration_s: 1_0",
     ['s.yaml:2:13: duration_s: "1_0" is not a number [s]; allowed: > 0']),
    ("sexagesimal is text", "duration_s: 10", "duration_s: 1:30",
     ['s.yaml:2:13: duration_s: "1:30" is not a number [s]; allowed: > 0']),
    ("nan", "duration_s: 10", "duration_s: .nan", ["s.yaml:2:13: duration_s: .nan is not a finite number"]),
    ("infinite", "duration_s: 10", "duration_s: -.inf", ["s.yaml:2:13: duration_s: -.inf is not a finite number"]),
    ("quoted number", "duration_s: 10", 'duration_s: "10"',
     ['s.yaml:2:13: duration_s: "10" is not a number [s]; allowed: > 0']),
    ("twice", "    bound: 1\n", "    bound: 1\n    signal: truth.attitude.error_deg\n",
     ["s.yaml:26:5: expect[0].signal: is given twice; the first is at s.yaml:24:5"]),
    ("tab", "  body:\n", "\tbody:\n", ["s.yaml:5:1: not valid YAML: a tab stands where YAML wants spaces"]),
    ("open bracket", "clock: {tick_hz: 10}", "clock: {tick_hz: 10",
     ["s.yaml:4:6: not valid YAML: expected ',' or '}', but got ':' (while parsing a flow mapping)"]),
    ("control character", "name: bench", "name: be\x07nch",
     ["s.yaml:1:9: character U+0007 is not allowed in YAML"]),
    ("python tag", "name: bench", "name: !!python/object:os.system ls",
     ["s.yaml:1:7: name: tag tag:yaml.org,2002:python/object:os.system is not supported here",
      ]),
    ("number as key", "name: bench", "name: bench\n7: 8", ["s.yaml:2:1: a key must be text, got 7"]),
    ("two documents", "name: bench", "name: bench\n---\nx: 1",
     ["s.yaml:2:1: not valid YAML: but found another document (expected a single document in the stream)"]),
    ("alias of itself", "name: bench", "name: bench\ntitle: &a [*a]",
     ["s.yaml:2:8: title[0]: is an alias of something that contains it", "s.yaml:2:8: title: a list is not text"]),
    ("missing", "name: bench\n", "", ["s.yaml:1:1: name: is missing"]),
    ("missing deep", "unit: wheel.1, ", "", ["s.yaml:14:5: faults[0].unit: is missing"]),
    ("empty value", "  estimator: {kind: direct}", "  estimator:",
     ["s.yaml:18:13: fsw.estimator: nothing where a mapping is needed, with kind: direct | mekf"]),
    ("asymmetric inertia", "body:\n    inertia_kgm2: [[45, 3, 2], [3,", "body:\n    inertia_kgm2: [[45, 3, 2], [4,",
     ["s.yaml:6:19: plant.body.inertia_kgm2: is not symmetric: row 1 column 2 is 3, row 2 column 1 is 4"]),
    ("inertia not positive definite", "body:\n    inertia_kgm2: [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]",
     "body:\n    inertia_kgm2: [[-1, 0, 0], [0, 2, 0], [0, 0, 2]]",
     ["s.yaml:6:19: plant.body.inertia_kgm2: is not positive definite: its principal moments are -1, 2, 2 kg m^2; "
      "all must be above 0"]),
    ("no such body", "model:\n    inertia_kgm2: [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]",
     "model:\n    inertia_kgm2: [[1, 0, 0], [0, 2, 0], [0, 0, 4]]",
     ["s.yaml:17:19: fsw.model.inertia_kgm2: breaks the triangle inequality: no rigid body has the principal moments "
      "1, 2, 4 kg m^2; the largest can be at most the sum of the others, 3"]),
    ("no attitude", "  estimator:", "  target_q: [0, 0, 0, 0]\n  estimator:",
     ["s.yaml:18:13: fsw.target_q: has length 0; an attitude needs one above 1e-6"]),
    ("part of a tick", "duration_s: 10", "duration_s: 10.05",
     ["s.yaml:2:13: duration_s: 10.05 s is not a whole number of ticks of 0.1 s; near: 10 s"]),
    ("no duration", "duration_s: 10", "duration_s: 0",
     ["s.yaml:2:13: duration_s: 0.0 s is out of range; allowed: > 0"]),
    ("step beside the tick", "plant:\n", "plant:\n  step_s: 0.03\n",
     ["s.yaml:5:11: plant.step_s: 0.03 s does not divide the tick of 0.1 s; near: 0.025 s"]),
    ("star tracker beside the tick", "{rate_hz: 5}", "{rate_hz: 4}",
     ["s.yaml:12:27: plant.star_tracker.rate_hz: 4 Hz does not divide the tick rate of 10 Hz; near: 3.33333 Hz"]),
    ("star tracker faster than the tick", "{rate_hz: 5}", "{rate_hz: 20}",
     ["s.yaml:12:27: plant.star_tracker.rate_hz: 20 Hz does not divide the tick rate of 10 Hz; near: 10 Hz"]),
    ("latency beside the tick", "{rate_hz: 5}", "{rate_hz: 5, latency_s: 0.17}",
     ["s.yaml:12:41: plant.star_tracker.latency_s: 0.17 s is not a whole number of ticks of 0.1 s; "
      "near: 0.2 s"]),
    ("gains for another period", "clock: {tick_hz: 10}", "clock: {tick_hz: 100}",
     ["s.yaml:19:35: fsw.observer.period_s: its gains belong to 0.1 s, but the control period is 0.01 s "
      "(fsw.executive.control_divider 1 / clock.tick_hz 100); set fsw.executive.control_divider: 10"]),
    ("gains for a shorter period", "period_s: 0.1}", "period_s: 0.03}",
     ["s.yaml:19:35: fsw.observer.period_s: its gains belong to 0.03 s, but the control period is 0.1 s "
      "(fsw.executive.control_divider 1 / clock.tick_hz 10); set period_s: 0.1 with gains for it"]),
    ("fraction of a nanosecond", "clock: {tick_hz: 10}", "clock: {tick_hz: 30}",
     ["s.yaml:3:18: clock.tick_hz: 30 Hz: the period is not a whole number of ns; near: 25 or 32"]),
    ("too slow a bus", "clock: {tick_hz: 10}", "clock: {tick_hz: 10}\nbus: {bitrate_bps: 10000}",
     ["s.yaml:4:20: bus.bitrate_bps: ticks at 10 Hz and a star tracker at 5 Hz need"]),
    ("fault after the end", "at_s: 2", "at_s: 10",
     ["s.yaml:14:59: faults[0].at_s: 10.0 s is not before the end of the run, 10.0 s: the fault would never take "
      "effect"]),
    ("fault that ends first", "at_s: 2", "at_s: 2, until_s: 1",
     ["s.yaml:14:71: faults[0].until_s: 1.0 s is not after"]),
    ("unknown kind of fault", "kind: loss", "kind: los",
     ['s.yaml:14:27: faults[0].kind: "los" is not known; did you mean "loss"?']),
    ("fault without its magnitude", "effectiveness: 0.5, ", "", ["s.yaml:14:5: faults[0].effectiveness: is missing"]),
    ("fault of another kind's magnitude", "effectiveness: 0.5, ", "effectiveness: 0.5, torque_nm: 1, ",
     ["s.yaml:14:53: faults[0].torque_nm: wheel fault loss has no use for torque_nm; it takes effectiveness"]),
    ("fault without effect", "kind: loss, effectiveness: 0.5", "kind: bias, torque_nm: 0",
     ["s.yaml:14:27: faults[0].kind: a bias of 0 N m has no effect"]),
    ("fault that this plant cannot show", "unit: wheel.1, kind: loss, effectiveness: 0.5",
     "unit: gyro.x, kind: noise, factor: 5",
     ["s.yaml:14:26: faults[0].kind: more noise has no effect: the gyro (ideal) has no angle random walk"]),
    ("fault out of range that ends first", "effectiveness: 0.5, at_s: 2", "effectiveness: 5, at_s: 2, until_s: 1",
     ["s.yaml:14:48: faults[0].effectiveness: 5.0 is out of range; allowed: >= 0, < 1",
      "s.yaml:14:69: faults[0].until_s: 1.0 s is not after"]),
    ("two faults of one id", "at_s: 2}", "at_s: 2, id: a}\n  - {unit: wheel.2, kind: dead, at_s: 3, id: a}",
     ['s.yaml:15:46: faults[1].id: "a" is the id of faults[0] too; ids are unique']),
    ("expectation after the end", "by_s: 9", "by_s: 11",
     ["s.yaml:26:11: expect[0].by_s: 11.0 s is after the end of the run, 10.0 s"]),
    ("empty window", "by_s: 9", "by_s: 9\n    from_s: 5\n    until_s: 5",
     ["s.yaml:27:13: expect[0].from_s: the window is empty: it starts at 5.0 s and ends at 5.0 s"]),
    ("settles without a time", "    by_s: 9\n", "",
     ["s.yaml:23:12: expect[0].check: settles needs by_s, not_before_s or at_s"]),
    ("half a published time", "by_s: 9", "at_s: 9", ["s.yaml:26:11: expect[0].at_s: at_s and tolerance_s go together"]),
    ("signal in no form", "signal: truth.attitude.error_deg", "signal: truth.attitude.(",
     ["s.yaml:24:13: expect[0].signal: is not an expression: invalid syntax"]),
    ("signal with a call", "signal: truth.attitude.error_deg", "signal: __import__(truth.a)",
     ["s.yaml:24:13: expect[0].signal: function __import__ is not known; there are: norm, abs,"]),
    ("signal without a signal", "signal: truth.attitude.error_deg", "signal: 1 + 1",
     ["s.yaml:24:13: expect[0].signal: names no logged signal, such as truth.attitude.error_deg"]),
    ("signal that is not logged", "signal: truth.attitude.error_deg", "signal: abs(truth.attitude.eror_deg)",
     ['s.yaml:24:13: expect[0].signal: truth.attitude has no field eror_deg; did you mean "error_deg"?']),
    ("topic that is not logged", "signal: truth.attitude.error_deg", "signal: truth.atitude.error_deg",
     ['s.yaml:24:13: expect[0].signal: there is no topic truth.atitude; did you mean "truth.attitude"?']),
    ("unknown check", "check: settles", "check: setles",
     ['s.yaml:23:12: expect[0].check: "setles" is not known; did you mean "settles"? there are: settles, below']),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "said"), [pytest.param(o, n, s, id=i) for i, o, n, s in CASES])
def test_what_is_wrong_is_said_where_it_stands(tmp_path: Path, old: str, new: str, said: list[str]) -> None:
    """Line, column, key and words of each problem, and no follow-up complaint beside it."""
    assert GOOD.count(old) == 1
    got = findings(tmp_path, GOOD.replace(old, new))
    assert len(got) == len(said), got
    for message, start in zip(got, said, strict=True):
        assert message.startswith(start)


def test_all_problems_come_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    """Structure, single values and checks across keys: one pass finds the lot, whatever else is wrong."""
    text = GOOD.replace("duration_s: 10\n", "duraton_s: 10\n")
    text = text.replace("mount: z, max_torque_nm: 0.1", "mount: w, max_torque_nm: fast")
    text = text.replace("{rate_hz: 5}", "{rate_hz: 3}").replace("kind: smc", "kind: smv")
    text = text.replace("mount: skew", "mount: skew, viscous_nm_s: 5")
    text = text.replace("body:\n    inertia_kgm2: [[45", "body:\n    inertia_kgm2: [[450")
    got = findings(tmp_path, text)
    places = [message.split(": ")[0] for message in got]
    assert places == [
        "s.yaml:2:1", "s.yaml:6:19", "s.yaml:10:15", "s.yaml:10:33", "s.yaml:11:35", "s.yaml:12:27", "s.yaml:20:22"
    ]  # fmt: skip


def test_the_line_is_shown_with_a_caret_under_the_value(tmp_path: Path) -> None:
    """The second and third line of a message: the source line, and a caret exactly under the value."""
    file = tmp_path / "s.yaml"
    file.write_text(GOOD.replace("max_torque_nm: 0.1", "max_torque_nm: fast"))
    with pytest.raises(ConfigError) as caught:
        load_scenario(file)
    (problem,) = caught.value.problems
    _, line, caret = problem.split("\n")
    assert line == "  |     - {mount: z, max_torque_nm: fast}"
    assert line[caret.index("^") :].startswith("fast")
    assert caught.value.exit_code == 2


def test_aliases_that_unfold_without_end_are_refused(tmp_path: Path) -> None:
    """Nine levels of nine aliases would be 400 million values: refused, quickly, with the limit."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 9)]
    got = findings(tmp_path, "\n".join(lines))
    assert any("aliases unfold to more than 50000 values" in message for message in got)


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    """A thousand open brackets end in a message, not in a crash of the interpreter."""
    got = findings(tmp_path, "name: " + "[" * 5000)
    assert len(got) == 1
    assert "nested" in got[0] or "not valid YAML" in got[0]


def test_anchors_and_merge_keys_work(tmp_path: Path) -> None:
    """What stands once may be used twice: `&name`, `*name`, and `<<` with the mapping's own keys winning."""
    text = GOOD.replace("    inertia_kgm2: [[45, 3, 2]", "    inertia_kgm2: &J [[45, 3, 2]", 1)
    text = text.replace(
        "model:\n    inertia_kgm2: [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]", "model:\n    inertia_kgm2: *J"
    )
    text = text.replace("- {mount: x}", "- &wheel {mount: x, tilt_deg: 3}").replace(
        "- {mount: y}", "- {<<: *wheel, mount: y}"
    )
    file = tmp_path / "s.yaml"
    file.write_text(text)
    scenario = load_scenario(file).scenario
    assert scenario.fsw.model.inertia_kgm2 == scenario.plant.body.inertia_kgm2
    assert (scenario.plant.wheels[1].mount, scenario.plant.wheels[1].tilt_deg) == ("y", 3.0)


# -- files that are no scenario ------------------------------------------------------------------------------------


def one_problem(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    (problem,) = caught.value.problems
    return problem.split("\n")[0]


def test_missing_file_names_the_near_miss(tmp_path: Path) -> None:
    (tmp_path / "nominal.yaml").write_text(GOOD)
    wanted = tmp_path / "nominl.yaml"
    assert one_problem(wanted) == f'{wanted}: there is no such file; did you mean "{tmp_path}/nominal.yaml"?'


def test_directory(tmp_path: Path) -> None:
    assert one_problem(tmp_path) == f"{tmp_path}: is a directory; name a scenario file in it"


def test_device() -> None:
    """Reading /dev/zero would never end."""
    assert one_problem(Path("/dev/zero")) == "/dev/zero: is a device or pipe, not a file"


def test_name_with_a_zero_byte(tmp_path: Path) -> None:
    assert "cannot be read" in one_problem(tmp_path / "a\0b.yaml")


def test_not_utf8(tmp_path: Path) -> None:
    file = tmp_path / "latin.yaml"
    file.write_bytes(b"name: a\ntitle: caf\xe9\n")
    assert one_problem(file) == f"{file}: is not UTF-8 text: byte 0xe9 in line 2; save it as UTF-8"


def test_byte_order_mark_is_no_problem(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert load_scenario(file).scenario.name == "bench"


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n"])
def test_empty(tmp_path: Path, text: str) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(text)
    assert one_problem(file) == f"{file}: is empty; a scenario needs at least name, duration_s, plant and fsw"


@pytest.mark.parametrize("text", ["- a\n- b\n", "just words\n", "42\n"])
def test_top_level_that_is_no_mapping(tmp_path: Path, text: str) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(text)
    assert one_problem(file) == f"{file}:1:1: the top level must be a mapping of keys such as name, plant, fsw"


def test_large_file_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with file.open("wb") as out:
        out.truncate(5_000_000)
    assert one_problem(file) == f"{file}: is larger than 1 MB: not a scenario file"


@pytest.mark.parametrize("text", ["\x85", "a\u2028b", "\u2029", "\x1b[2J", "\x7f", "a\nPASS: b"])
def test_a_text_never_breaks_the_line_of_its_message(text: str) -> None:
    """Control characters and line ends, those above ASCII too, are escaped as JSON does it; letters are not."""
    words = describe(text)
    assert len(words.splitlines()) == 1
    assert words.isprintable()
    assert json.loads(words) == text
    assert describe("Größe °") == '"Größe °"'
