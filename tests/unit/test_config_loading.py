"""Scenario files that extend others, overrides, what a resolved scenario gives, and the files that ship."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from bus.errors import ConfigError
from bus.run import RunConfig
from bus.settings import build
from fsw.config import FswConfig
from fsw.controllers.settings import VariableStructureConfig
from fsw.observers.settings import IloConfig, NoObserverConfig
from plant_server.config import PlantConfig
from plant_server.faults import make_fault
from tools.config.check import check
from tools.config.expect import Settles
from tools.config.expect_checks import check_signal
from tools.config.findings import Source
from tools.config.loader import load_scenario, load_text
from tools.config.merge import parse_key
from tools.config.reference import BEGIN, END, REFERENCE_FILE, update_reference
from tools.config.schema import SCHEMA_FILE, format_schema
from tools.config.yaml_nodes import Dumper, read_yaml, write_yaml

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "scenarios").glob("*.yaml"))
ZHANG = ROOT / "scenarios" / "zhang2018.yaml"


def problems_of(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, overrides)
    return [problem.split("\n")[0] for problem in caught.value.problems]


# -- extends -------------------------------------------------------------------------------------------------------


@pytest.fixture
def child(tmp_path: Path) -> Path:
    (tmp_path / "base.yaml").write_text(ZHANG.read_text())
    return tmp_path / "child.yaml"


def test_mappings_merge_and_lists_replace(child: Path) -> None:
    """One gain changes and the others stay; a list of one fault replaces all five."""
    child.write_text(
        "extends: base.yaml\nname: child\n"
        "fsw: {observer: {k2: 50}}\nfaults:\n  - {unit: wheel.1, kind: dead, at_s: 1}\n"
    )
    scenario = load_scenario(child).scenario
    assert isinstance(scenario.fsw.observer, IloConfig)
    assert (scenario.fsw.observer.k2, scenario.fsw.observer.k3) == (50.0, 21.0)
    assert scenario.faults == (make_fault(unit="wheel.1", kind="dead", at_s=1.0),)
    assert (scenario.name, scenario.duration_s) == ("child", 300.0)


def test_another_kind_does_not_inherit_the_old_ones_keys(child: Path) -> None:
    """The observer's gains would be unknown keys of `none`: with the kind, the whole mapping is replaced."""
    child.write_text(
        "extends: base.yaml\nexpect: []\nfsw:\n  observer: {kind: none}\n  controller: {kind: variable_structure, k: 0.2}\n"
    )
    fsw = load_scenario(child).scenario.fsw
    assert fsw.observer == NoObserverConfig(kind="none")
    assert fsw.controller == VariableStructureConfig(kind="variable_structure", k=0.2)


def test_problems_are_shown_in_the_file_that_they_come_from(child: Path, tmp_path: Path) -> None:
    """Two files, one problem each: each is told with its own file and line."""
    base = (tmp_path / "base.yaml").read_text()
    line = base[: base.index("duration_s: 300")].count("\n") + 1
    (tmp_path / "base.yaml").write_text(base.replace("duration_s: 300", "duration_s: long"))
    child.write_text("extends: base.yaml\n\nfsw: {observer: {k1: 7}}\n")
    assert problems_of(child) == [
        f'{child}:3:22: fsw.observer.k1: 7.0 is out of range; allowed: >= 0, <= 1',
        f'{tmp_path}/base.yaml:{line}:13: duration_s: "long" is not a number [s]; allowed: > 0',
    ]  # fmt: skip


def test_a_chain_of_files_and_its_texts(child: Path, tmp_path: Path) -> None:
    """Grandparents count, the nearest file wins, and every text is kept for the log, the file itself first."""
    child.write_text("extends: base.yaml\nseed: 1\ntitle: one\n")
    (tmp_path / "deep").mkdir()
    grandchild = tmp_path / "deep" / "grandchild.yaml"
    grandchild.write_text("extends: ../child.yaml\nseed: 2\n")
    resolved = load_scenario(grandchild)
    assert (resolved.scenario.seed, resolved.scenario.title, resolved.scenario.name) == (2, "one", "zhang2018")
    assert [Path(source.name).name for source in resolved.sources] == ["grandchild.yaml", "child.yaml", "base.yaml"]


def test_a_circle_and_a_missing_parent(child: Path, tmp_path: Path) -> None:
    child.write_text("extends: other.yaml\n")
    (tmp_path / "other.yaml").write_text("extends: child.yaml\n")
    (said,) = problems_of(child)
    assert said.startswith(f"{tmp_path}/other.yaml:1:10: extends: {child} extends itself")
    child.write_text("name: x\nextends: bas.yaml\n")
    near = f'{tmp_path}/bas.yaml: there is no such file; did you mean "{tmp_path}/base.yaml"?'
    assert problems_of(child) == [f"{child}:2:10: extends: {near}"]
    child.write_text("extends: [a]\n")
    assert problems_of(child) == [
        f"{child}:1:10: extends: needs the path of another scenario file, relative to this one"
    ]


# -- overrides -----------------------------------------------------------------------------------------------------


def test_overrides_reach_anywhere() -> None:
    """Numbers, words, list entries, whole lists, kinds, and an address that would be a mapping in YAML."""
    resolved = load_scenario(
        ZHANG,
        [
            "seed=7",
            "plant.wheels[2].max_torque_nm=2e-1",
            "plant.wheels.1.tilt_deg=0",
            "fsw.observer.kind=none",
            "faults=[]",
            "bus.address=hub:",
            "title=a: b # c",
            "fsw.target_q=[0, 1, 0, 0]",
        ],
    )
    scenario = resolved.scenario
    assert scenario.seed == 7
    assert [wheel.max_torque_nm for wheel in scenario.plant.wheels] == [0.1, 0.1, 0.2, 0.1]
    assert [wheel.tilt_deg for wheel in scenario.plant.wheels] == [10.0, 0.0, 5.0, 6.0]
    assert scenario.fsw.observer == NoObserverConfig(kind="none")
    assert scenario.faults == ()
    assert (scenario.bus.address, scenario.title) == ("hub:", "a: b # c")
    assert scenario.fsw.target_q == (0.0, 1.0, 0.0, 0.0)


def test_a_later_override_sees_the_kind_that_an_earlier_one_chose() -> None:
    words = ["expect=[]", "fsw.controller.kind=braking_profile", "fsw.controller.eta=0.7"]
    assert load_scenario(ZHANG, words).as_dict()["fsw"]["controller"]["eta"] == 0.7


def test_a_fault_keeps_its_time_when_its_kind_is_overridden() -> None:
    words = ["faults[0].kind=bias", "faults[0].effectiveness=null", "faults[0].torque_nm=0.01"]
    fault = load_scenario(ZHANG, words).scenario.faults[0]
    assert (fault.unit, fault.kind, fault.at_s, fault.magnitudes) == ("wheel.1", "bias", 30.0, {"torque_nm": 0.01})


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("seed", "--set seed: needs the form key.path=value"),
        ("=3", "--set =3: needs the form key.path=value"),
        ("a..b=3", "--set a..b=3: needs the form key.path=value"),
        ("sed=3", '--set sed=3: sed: is not a known key; did you mean "seed"?'),
        ("seed=-1", "--set seed=-1: seed: -1 is out of range; allowed: >= 0"),
        ("seed=.nan", "--set seed=.nan: seed: .nan is not a finite number"),
        ("faults[9].at_s=1", "--set faults[9].at_s=1: faults[9].at_s: cannot be set: faults has 5 entries"),
        ("seed.x=1", "--set seed.x=1: seed.x: cannot be set: seed is a single value"),
        ("faults[9]=1", "--set faults[9]=1: faults[9]: cannot be set: the list has 5 entries, from 0"),
        ("plant.gyro=[", "--set plant.gyro=[: plant.gyro: not valid YAML"),
        ("plant.gyro={kind: x}", "--set plant.gyro={kind: x}: plant.gyro.kind: is not a known key"),
    ],
)
def test_a_wrong_override_is_named_with_its_own_words(word: str, said: str) -> None:
    (got,) = problems_of(ZHANG, word)
    assert got.startswith(said)


def test_key_paths_are_read_in_both_spellings() -> None:
    assert parse_key("plant.wheels[2].mount") == parse_key("plant.wheels.2.mount") == ("plant", "wheels", 2, "mount")
    assert [parse_key(text) for text in ("", ".a", "a[", "a[x]", "[0]", "a]", "a..b")] == [None] * 7


# -- resolved ------------------------------------------------------------------------------------------------------


def test_each_side_is_told_its_own_part_only() -> None:
    """The flight software must not learn of the faults or of the true inertia."""
    resolved = load_scenario(ZHANG)
    plant, fsw = json.loads(resolved.plant_json()), json.loads(resolved.fsw_json("hub:/tmp/x"))
    assert sorted(plant) == ["faults", "plant", "run"]
    assert sorted(fsw) == ["fsw", "run"]
    assert "wheel.1" not in resolved.fsw_json()
    assert build(PlantConfig, plant["plant"], "x") == resolved.scenario.plant
    assert build(FswConfig, fsw["fsw"], "x") == resolved.scenario.fsw
    run = build(RunConfig, fsw["run"], "x")
    assert (run.ticks, run.run_hash, run.bus.address) == (3000, resolved.run_hash, "hub:/tmp/x")
    assert resolved.scenario.bus.address == json.loads(resolved.fsw_json())["run"]["bus"]["address"] == "hub:"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_scenarios_load_and_survive_their_own_yaml(path: Path) -> None:
    """What is attached to a log reads back as the same scenario, and as the same run."""
    resolved = load_scenario(path)
    again = load_text(resolved.to_yaml(), "scenario.yaml")
    assert again.scenario == resolved.scenario
    assert again.run_hash == resolved.run_hash
    assert resolved.scenario.name == path.stem
    assert path.read_text().startswith("# yaml-language-server: $schema=scenario.schema.json\n")


def test_there_are_scenarios_to_ship() -> None:
    """An empty glob would make the test above pass without a look."""
    wanted = {"zhang2018", "zhang2018-flight", "nominal", "variable-structure", "braking-profile"}
    assert wanted <= {path.stem for path in SHIPPED}


@pytest.mark.parametrize(
    "word", ["1e-3", "on", "null", "012", "0x1F", "a: b", "- x", "ünï", "'", '"', "#", "", "<<", " x "]
)
def test_words_that_look_like_something_else_survive_yaml(word: str) -> None:
    """The writer quotes what the reader would take for a number, a switch or nothing."""
    data = load_scenario(ZHANG).as_dict() | {"title": word}
    resolved = load_text(json.dumps(data), "x")
    assert resolved.scenario.title == word
    assert load_text(resolved.to_yaml(), "y").scenario.title == word


class PythonDumper(yaml.SafeDumper):
    """What `Dumper` is where PyYAML came without libyaml."""

    yaml_implicit_resolvers = Dumper.yaml_implicit_resolvers
    ignore_aliases = Dumper.ignore_aliases


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_logs_carry_the_same_scenario_with_and_without_libyaml(path: Path) -> None:
    """Both emitters give the same text, and so does writing the file key by key, as it is done."""
    resolved = load_scenario(path)
    whole = write_yaml(resolved.as_dict(), PythonDumper)
    assert write_yaml(resolved.as_dict()) == whole
    assert resolved.to_yaml() == whole


@pytest.mark.parametrize("prose", ["one\ntwo\n", "word " * 40 + "\n" + "w" * 200, "a \U0001f600 face", "\ttab\n\n b"])
def test_prose_that_the_two_write_differently_means_the_same(prose: str) -> None:
    """Line breaks and emoji are folded and escaped in two ways, and read back as they were."""
    for dumper in (Dumper, PythonDumper):
        node, findings = read_yaml(Source("x", write_yaml({"description": prose}, dumper)))
        assert node is not None
        assert (node.plain(), findings) == ({"description": prose}, [])


def test_what_one_run_overrides_does_not_reach_the_next() -> None:
    """A text is parsed once; each reading has a tree of its own, the list of faults included."""
    plain = load_scenario(ZHANG)
    load_scenario(ZHANG, ["faults=[]", "seed=9", "plant.wheels[0].max_torque_nm=0.2", "fsw.observer.k2=50"])
    again = load_scenario(ZHANG)
    assert again.scenario == plain.scenario
    assert again.to_yaml() == plain.to_yaml()


def test_a_file_that_was_edited_is_read_anew(child: Path) -> None:
    child.write_text("extends: base.yaml\nname: before\n")
    assert load_scenario(child).scenario.name == "before"
    child.write_text("extends: base.yaml\nname: afterw\n")
    assert load_scenario(child).scenario.name == "afterw"


def test_minus_zero_is_not_taken_for_zero() -> None:
    """Equal in Python, but not in a file: the text that is kept of one run is not another's."""
    texts = [
        load_scenario(ZHANG, [f"plant.body.rate_deg_s=[{word}, 0.3, 0.009]"]).to_yaml() for word in ("0.0", "-0.0")
    ]
    assert texts[0] != texts[1]


def test_published_scenario_has_the_published_numbers() -> None:
    """Zhang, Ye & Sun 2018, section 4: typed again from the paper's table, with the last faults on the skew wheel."""
    scenario = load_scenario(ZHANG).scenario
    plant, fsw = scenario.plant, scenario.fsw
    assert plant.body.inertia_kgm2 == ((45, 3, 2), (3, 38, -1.5), (2, -1.5, 50)) == fsw.model.inertia_kgm2
    assert plant.body.attitude_q == (0.85, 0.25, -0.3, 0.35)
    assert plant.body.rate_deg_s == (0.51, 0.3, 0.009)
    assert not plant.body.wheel_gyroscopic
    assert [(w.mount, w.tilt_deg, w.clock_deg) for w in plant.wheels] == [
        ("x", 10, 12), ("y", 8, 15), ("z", 5, 8), ("skew", 6, 10)
    ]  # fmt: skip
    assert {w.max_torque_nm for w in plant.wheels} == {0.1} == {fsw.model.wheel_max_torque_nm}
    assert [(f.unit, f.kind, f.magnitudes, f.at_s, f.until_s) for f in scenario.faults] == [
        ("wheel.1", "loss", {"effectiveness": 0.6}, 30, 100),
        ("wheel.1", "loss", {"effectiveness": 0.4}, 100, None),
        ("wheel.2", "loss", {"effectiveness": 0.5}, 10, 50),
        ("wheel.3", "stuck_torque", {"torque_nm": 0.015}, 20, 40),
        ("wheel.4", "dead", {}, 30, None),
    ]
    observer = fsw.observer
    assert isinstance(observer, IloConfig)
    assert (observer.k1, observer.k2, observer.k3, observer.lambda_nm_s) == (0.15, 98, 21, 0.1)
    controller = load_scenario(ZHANG).as_dict()["fsw"]["controller"]
    assert (controller["k1"], controller["mu"], controller["beta0"], controller["beta_law"]) == (
        5.6,
        2,
        0.4,
        "published",
    )
    times = {item.bound: item.at_s for item in scenario.expect if isinstance(item, Settles)}
    assert times == {5: 69.1, 1: 99.3, 0.1: 123.8, 0.01: 182.6}


# -- checks across keys --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signal", [
    "truth.attitude.error_deg", "norm(fsw.observer.tau_fault_hat_b_nm - truth.wheels.tau_fault_b_nm)",
    "deg(truth.attitude.omega_bi_b_rad_s[0])", "-2 * max(abs(fsw.control.tau_rw_cmd_nm)) ** 0.5 / (1 + fsw.law.beta)",
])  # fmt: skip
def test_signals_in_good_form(signal: str) -> None:
    assert check_signal(signal) == []


@pytest.mark.parametrize("signal", [
    "", "a.b if c.d else 1", "a.b and c.d", "a.b < 1", "'x' + a.b", "a.b[0:1]", "a.b['x']", "norm(a.b, c.d)", "a.f(1)",
    "lambda: a.b", "[a.b]", "a.b; 1", "norm(x=a.b)", "a.b % 2",
    "(" * 300 + "fsw.law.beta" + ")" * 300, "True * a.b", "norm(*a.b)",
])  # fmt: skip
def test_signals_in_bad_form(signal: str) -> None:
    assert check_signal(signal)


# -- check, schema, reference --------------------------------------------------------------------------------------


def test_check_sums_up_a_sound_file(capsys: pytest.CaptureFixture[str]) -> None:
    """Ticks and the faults in the order of their onset, on stdout."""
    assert check(ZHANG) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "OK: zhang2018" in out
    assert "3000 ticks at 10 Hz" in out
    onsets = [float(found) for found in re.findall(r"^ +([0-9.]+) \.\. ", out, re.MULTILINE)]
    assert onsets == [10, 20, 30, 30, 100]


def test_check_tells_every_problem_of_every_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(ZHANG.read_text().replace("seed: 2018", "seed: x").replace("mount: y", "mount: q"))
    assert check([ZHANG, bad, tmp_path / "none.yaml"]) == 2
    out, err = capsys.readouterr()
    assert out.count("OK: ") == 1
    assert f"{bad}: 2 problems" in err
    assert "there is no such file" in err


def test_check_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One object on stdout and nothing else, with the places as numbers; the load from 135 bits a frame, by hand."""
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: x\nduration_s: -1\nextends: " + str(ZHANG) + "\n")
    assert check([bad, ZHANG], as_json=True) == 2
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert err == ""
    assert report["ok"] is False
    assert [entry["ok"] for entry in report["files"]] == [False, True]
    (problem,) = report["files"][0]["problems"]
    assert problem == {
        "file": str(bad),
        "line": 2,
        "column": 13,
        "key": "duration_s",
        "message": "-1.0 s is out of range; allowed: > 0",
    }
    load = report["files"][1]["bus_load_percent"]
    assert math.isclose(load, 100 * 135 * (13 * 10 + 2 * 10 + 3) / 500e3, abs_tol=0.06)


def test_schema_is_up_to_date() -> None:
    """Editors read the committed file: after a change of settings, run `python -P -m tools.config.schema`."""
    assert SCHEMA_FILE.read_text(encoding="utf-8") == format_schema()


def test_the_tutorial_holds_what_it_says() -> None:
    """The file of docs/scenarios.md is sound as printed, and its broken line gives the message printed there."""
    page = REFERENCE_FILE.read_text(encoding="utf-8")
    yaml_text = page.split("```yaml\n")[1].split("```")[0]
    name = str(ROOT / "scenarios" / "my-fault.yaml")
    assert load_text(yaml_text, name).scenario.name == "my-fault"
    with pytest.raises(ConfigError) as caught:
        load_text(yaml_text.replace("at_s: 20, rise_s: 30", "at_s: soon"), name)
    assert f"```\n{str(caught.value).replace(str(ROOT) + '/', '')}\n```" in page


def test_reference_is_up_to_date() -> None:
    """The table of keys in docs/scenarios.md is made from the settings; the same command writes it."""
    text = REFERENCE_FILE.read_text(encoding="utf-8")
    assert text.count(BEGIN) == text.count(END) == 1
    assert update_reference(text) == text


def read_plain(text: str) -> Any:
    node, found = read_yaml(Source("x", text))
    assert node is not None
    assert not found
    return node.plain()


def accepts(schema: dict[str, Any], value: Any, top: dict[str, Any]) -> bool:
    """Whether a JSON schema accepts a value: the words that ours uses, and an error for any other."""
    known = {"$ref", "anyOf", "type", "const", "enum", "properties", "additionalProperties", "items", "minItems",
             "maxItems", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "description", "default",
             "$schema", "title", "$defs", "if", "then"}  # fmt: skip
    assert set(schema) <= known, set(schema) - known
    if "$ref" in schema and not accepts(top["$defs"][schema["$ref"].removeprefix("#/$defs/")], value, top):
        return False
    if "anyOf" in schema and not any(accepts(member, value, top) for member in schema["anyOf"]):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if "const" in schema and value != schema["const"]:
        return False
    number = isinstance(value, int | float) and not isinstance(value, bool)
    kinds = {"object": isinstance(value, dict), "array": isinstance(value, list), "string": isinstance(value, str),
             "number": number, "integer": number and value == int(value), "boolean": isinstance(value, bool),
             "null": value is None}  # fmt: skip
    if "type" in schema and not kinds[schema["type"]]:
        return False
    if isinstance(value, dict) and "properties" in schema:
        if not set(value) <= set(schema["properties"]):
            return False
        return all(accepts(schema["properties"][key], item, top) for key, item in value.items())
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            return False
        return all(accepts(schema.get("items", {}), item, top) for item in value)
    return not number or (
        schema.get("minimum", -math.inf) <= value <= schema.get("maximum", math.inf)
        and schema.get("exclusiveMinimum", -math.inf) < value
        and value < schema.get("exclusiveMaximum", math.inf)
    )


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_schema_accepts_what_ships(path: Path) -> None:
    """The file as written (`extends` and all) and as resolved; otherwise an editor would underline good files."""
    schema = json.loads(SCHEMA_FILE.read_text())
    assert accepts(schema, read_plain(path.read_text()), schema)
    assert accepts(schema, load_scenario(path).as_dict(), schema)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("seed: 2018", "seed: x"),
        ("seed: 2018", "sed: 2018"),
        ("mount: y", "mount: q"),
        ("kind: ilo", "kind: illo"),
        ("kind: dead", "kind: died"),
        ("step_s: 0.01", "step_s: 1"),
        ("duration_s: 300", "duration_s: 0"),
        ("target_q: [1, 0, 0, 0]", "target_q: [1, 0, 0]"),
    ],
)
def test_schema_refuses_what_the_loader_refuses(old: str, new: str) -> None:
    """Otherwise the test above could not fail."""
    text = ZHANG.read_text()
    assert old in text
    schema = json.loads(SCHEMA_FILE.read_text())
    assert not accepts(schema, read_plain(text.replace(old, new)), schema)
