"""Campaign files: what they come to, run by run, and what is said of those that cannot be flown."""

from __future__ import annotations

import itertools
import json
import textwrap
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from bus.errors import ConfigError, UsageError
from tools.campaign.campaign import Campaign
from tools.campaign.check import check_campaign
from tools.campaign.definition import find_campaign, list_campaigns, load_campaign
from tools.campaign.fly import fly
from tools.campaign.formulas import FormulaError, parse_formula
from tools.campaign.inspection import inspect
from tools.campaign.job import make_job
from tools.campaign.one_run import load_one, split_word
from tools.campaign.plan import derive_seed
from tools.campaign.template import TemplateError, Values, list_names, render
from tools.config.file_kinds import is_campaign
from tools.config.loader import load_scenario
from tools.config.scenario_files import SHIPPED, find_scenario
from tools.run.bench import Bench

Write = Callable[..., Path]
ERROR = "truth.attitude.error_deg"
CHAIN = {"first": {"formula": "onset_s + 1"}, "later": {"formula": "first + 1"}}
INDICES = {"kind": "indices", "requirement": "R-1"}
SEARCH = {"kind": "boundary", "axis": "onset", "lower": 0, "upper": 1, "tolerance": 0.1}
GOOD: dict[str, Any] = {
    "name": "mine",
    "base": "zhang2018-flight",
    "seed": 1,
    "set": {
        "duration_s": 20,
        "fsw.controller.kind": "$law",
        "faults": [{"unit": "$unit", "$fault...": None, "at_s": "$onset_s"}],
        "expect": [],
    },
    "axes": {
        "law": ["smc", "pid"],
        "unit": ["wheel.1", "wheel.2"],
        "fault": {
            "cases": {"half": {"kind": "loss", "effectiveness": 0.5}, "stuck": {"kind": "stuck_torque", "torque_nm": 1}}
        },
        "onset_s": {"uniform": [2, 10], "unit": "s"},
    },
    "samples": 3,
}


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a campaign that is GOOD but for these keys; None takes a key out."""

    def write_file(**changes: Any) -> Path:
        data = {key: value for key, value in {**GOOD, **changes}.items() if value is not None}
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        return path

    return write_file


def axes(**items: Any) -> dict[str, Any]:
    """Keys of a campaign whose axes go nowhere that matters: ids of faults that are not there."""
    return {"axes": {name: {"key": f"fsw.x_{name}", **item} for name, item in items.items()}, "set": None}


def expand(path: Path) -> Campaign:
    """A campaign whose scenarios are not looked at."""
    found = inspect(str(path), (), 0)
    assert found.campaign is not None, found.findings
    return found.campaign


def findings(path: Path) -> list[str]:
    """What is said of a file, without the excerpts."""
    return [finding.headline.removeprefix(str(path)) for finding in inspect(str(path), (), 40).findings]


# -- points ---------------------------------------------------------------------------------------------------------


def test_grid(write: Write) -> None:
    """A grid has every combination of the lists once a draw, and the same draws in each combination."""
    points = load_campaign(write()).points()
    cells = Counter(tuple(point.labels[name] for name in ("law", "unit", "fault")) for point in points)
    assert cells == Counter(
        dict.fromkeys(itertools.product(["smc", "pid"], ["wheel.1", "wheel.2"], ["half", "stuck"]), 3)
    )
    onsets = [point.values["onset_s"] for point in points]
    assert onsets == onsets[:3] * 8
    assert len(set(onsets)) == 3
    own = load_campaign(write(draws="own")).points()
    assert len({point.values["onset_s"] for point in own}) == 24


def test_pairwise_has_every_pair(write: Write) -> None:
    """A covering array of six axes has every pair of values of every two axes, in far fewer runs than the grid."""
    names = "abcdef"
    campaign = expand(write(combine="pairwise", samples=1, **axes(**{n: {"values": list(range(4))} for n in names})))
    points = campaign.points()
    for one, other in itertools.combinations(names, 2):
        pairs = {(point.values[one], point.values[other]) for point in points}
        assert pairs == set(itertools.product(range(4), repeat=2))
    assert 16 <= len(points) <= 32 < 4**6


def test_pairwise_keeps_to_constraints(write: Write) -> None:
    """Under a constraint no forbidden pair comes, and every other one does."""
    keys = axes(**{n: {"values": [0, 1, 2]} for n in "abcd"})
    points = expand(write(combine="pairwise", samples=1, where=["not (a == 1 and b == 2)"], **keys)).points()
    assert {(p.values["a"], p.values["b"]) for p in points} == set(itertools.product(range(3), repeat=2)) - {(1, 2)}
    assert {(p.values["c"], p.values["d"]) for p in points} == set(itertools.product(range(3), repeat=2))


def test_sampled_lists(write: Write) -> None:
    """Lists that are drawn in a Latin hypercube come as often as each other, to one run in each stratum."""
    keys = axes(a={"values": ["x", "y", "z"]}, b={"uniform": [0, 1]})
    points = expand(write(combine="sampled", sampling="latin_hypercube", samples=30, **keys)).points()
    assert Counter(point.values["a"] for point in points) == {"x": 10, "y": 10, "z": 10}
    assert sorted(int(point.values["b"] * 30) for point in points) == list(range(30))


def test_common_draw(write: Write) -> None:
    """Axes with a common draw are one quantile of their two distributions; without it they are not."""
    both = {"a": {"uniform": [0, 1]}, "b": {"log_uniform": [1, 100]}}
    campaign = expand(write(samples=50, **axes(**{name: {**axis, "common": "c"} for name, axis in both.items()})))
    for point in campaign.points():
        assert point.values["b"] == pytest.approx(100.0 ** point.values["a"], rel=1e-9)
    assert campaign.dimensions == 1
    apart = expand(write(samples=50, **axes(**both)))
    assert any(abs(p.values["b"] / 100.0 ** p.values["a"] - 1.0) > 0.1 for p in apart.points())
    assert apart.dimensions == 2


def test_formula_follows_a_search(write: Write) -> None:
    """A computed axis follows the others, also where a strategy has put another value in."""
    keys = axes(a={"uniform": [1, 2]}, b={"formula": "2 * a + 1"})
    campaign = expand(write(samples=2, **keys))
    point = campaign.points()[0]
    assert point.values["b"] == pytest.approx(2 * point.values["a"] + 1)
    moved = type(point)(values={**point.values, "a": 7.0}, labels=point.labels)
    assert campaign.plan(0, moved).point.values["b"] == 15.0
    assert "fsw.x_b=15.0" in campaign.plan(0, moved).overrides


def test_repeats_have_seeds_of_their_own(write: Write) -> None:
    """Repeats are the same point flown with other seeds, each from the campaign's seed and the run's number."""
    campaign = load_campaign(write(repeats=3))
    plans = [campaign.plan(number, point) for number, point in enumerate(campaign.points())]
    assert campaign.runs == len(plans) == 72
    assert plans[0].overrides == plans[2].overrides != plans[3].overrides
    assert [plan.seed for plan in plans] == [derive_seed(1, number) for number in range(72)]
    assert len({plan.seed for plan in plans}) == 72
    assert [plan.point.repeat for plan in plans[:4]] == [0, 1, 2, 0]


def test_several_bases_are_an_axis(write: Write) -> None:
    """A list of bases is an axis called base, and each run names its own."""
    campaign = load_campaign(write(base=["zhang2018-flight", "zhang2018"], samples=1))
    assert campaign.axes[0].labels == ("zhang2018-flight", "zhang2018")
    bases = [campaign.plan(n, point).base for n, point in enumerate(campaign.points())]
    assert Counter(bases) == {"zhang2018-flight": 8, "zhang2018": 8}


def test_plan_is_a_scenario(write: Write) -> None:
    """The overrides of a run make of its base what the file says, to the last digit."""
    campaign = load_campaign(write())
    plan = campaign.plan(17, campaign.points()[17])
    scenario = load_scenario(find_scenario(plan.base), [*plan.overrides, f"seed={plan.seed}"]).scenario
    values = plan.point.values
    assert scenario.fsw.controller.kind == values["law"]
    assert (scenario.faults[0].unit, scenario.faults[0].kind) == (values["unit"], values["fault"]["kind"])
    assert scenario.faults[0].at_s == values["onset_s"]
    assert scenario.seed == derive_seed(1, 17)


def test_sample_reaches_the_ends(write: Write) -> None:
    """The corners of the unit cube are the ends of the axes, and a list's first and last value where lists are drawn."""
    keys = axes(a={"values": [1, 2, 3]}, b={"uniform": [-1, 5]})
    campaign = expand(write(combine="sampled", **keys))
    assert campaign.dimensions == 2
    assert dict(campaign.sample([0.0, 0.0]).values) == {"a": 1, "b": -1.0}
    assert dict(campaign.sample([1.0 - 1e-9, 0.5]).values) == {"a": 3, "b": 2.0}
    with pytest.raises(ValueError, match="3 numbers for 2 dimensions"):
        campaign.sample([0.0, 0.0, 0.0])


def test_overrides_of_the_file(write: Write) -> None:
    """key=value words change the campaign as they change a scenario."""
    campaign = load_campaign(write(), ["seed=5", "samples=2", "axes.unit=[wheel.3]"])
    assert (campaign.seed, campaign.runs) == (5, 8)
    assert {point.values["unit"] for point in campaign.points()} == {"wheel.3"}


# -- templates and formulas ------------------------------------------------------------------------------------------


def test_template() -> None:
    """Whole values, words in a text, merged keys, entries of lists and loops all come out as documented."""
    run = Values({"a": 3, "m": {"k": 1}, "l": [1, 2], "n": None}, {"m": "em"})
    assert render({"x": "$a", "y": "t $a ${a}b $$5 $m", "$m...": None}, run) == {"x": 3, "y": "t 3 3b $5 em", "k": 1}
    assert render(["$l...", "$m...", "$n...", "$l"], run) == [1, 2, {"k": 1}, [1, 2]]
    assert render([{"$for t in l": None, "at": "$t", "u": "$a"}], run) == [{"at": 1, "u": 3}, {"at": 2, "u": 3}]
    assert render({"$n...": None, "z": 1}, run) == {"z": 1}
    names = {name for name, _ in list_names([{"$for t in l": None, "at": "$t"}, {"$m...": None}, "x $a"])}
    assert names == {"l", "m", "a"}
    with pytest.raises(TemplateError, match="where a mapping is needed"):
        render({"$a...": None}, run)
    with pytest.raises(TemplateError, match="where a list is needed"):
        render([{"$for t in a": None}], run)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + 2 * b ** 2 - 1 / 4", 3 + 2 * 25 - 0.25),
        ("a < b <= 5 and not a == 4", True),
        ("u in ['x', 'y'] or a > 100", True),
        ("max(a, b) - abs(-a) + floor(2.7)", 4),
        ("sqrt(b * b)", 5.0),
    ],
)
def test_formulas(text: str, value: Any) -> None:
    """Formulas have the value that Python gives them."""
    assert parse_formula(text, ["a", "b", "u"]).evaluate({"a": 3, "b": 5, "u": "x"}) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("__import__('os')", "function __import__ is not known"),
        ("a.real", "signals are not known here"),
        ("[x for x in a]", "is not allowed"),
        ("lambda: 1", "is not allowed"),
        ("aa", "did you mean a?"),
        ("a +", "is not an expression"),
        ("f'{a}'", "is not allowed"),
        ("(" * 300 + "a" + ")" * 300, "is not an expression"),
        ("+".join(["a"] * 600), "is too long"),
        ("a or 1j", "neither a number nor a text"),
    ],
)
def test_what_is_no_formula(text: str, words: str) -> None:
    """What could do more than compare and compute is refused, and so is what is too much."""
    with pytest.raises(FormulaError, match=words.replace("?", r"\?").replace("(", r"\(")):
        parse_formula(text, ["a"])


@pytest.mark.parametrize(
    ("text", "a"), [("a < 1", "x"), ("1 / a", 0), ("9.0 ** (9 ** a)", 9), ("'x' * a", 10**9), ("log(a)", -1)]
)
def test_formula_without_a_value(text: str, a: Any) -> None:
    """What has no value says so, with the axis in question, and takes no time over it."""
    with pytest.raises(FormulaError, match="has no value"):
        parse_formula(text, ["a"]).evaluate({"a": a})


# -- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sampels": 3}, ':33:1: sampels: is not a known key; did you mean "samples"?'),
        ({"base": "zhang2018-fligth"}, ":2:7: base: scenario 'zhang2018-fligth' is not a file and not shipped; did"),
        ({"where": ["law == 'pdi'"]}, 'where[0]: law is never "pdi"; did you mean pid?'),
        ({"where": ["lwa == 'pid'"]}, "where[0]: there is no axis lwa; did you mean law?"),
        ({"where": ["onset_s > 100"]}, "where: nothing is left: no run keeps to all constraints"),
        ({"where": ["unit < 3"]}, "where[0]: unit < 3: has no value for unit = wheel.1"),
        ({"where": ["law"]}, "where[0]: law: is 'smc' and no condition; compare it with something"),
        ({"axes": {**GOOD["axes"], **CHAIN}}, "axes.later.formula: first is computed itself; a formula takes axes that"),
        ({"set": {"duration_s": "$lwa"}}, "set.duration_s: there is no axis lwa; did you mean law?"),
        ({"set": {"duration_s": 20}}, "axes.law: goes nowhere: put $law where it belongs under `set`"),
        ({"set": {"a=b": 20}}, "set.a=b: is not the key of a setting"),
        ({"axes": {"base": [1]}}, "axes.base: cannot name an axis"),
        ({"axes": {"a b": [1]}}, "axes.a b: is not a name of an axis"),
        ({"requirements": ["bensh"]}, 'requirements[0]: there is no requirement file "bensh"; did you mean bench?'),
        ({"keep_logs": "some"}, "keep_logs: 'some': give none, failures, all, or worst N"),
        ({"metrics": {"m": {"max": "truth.attitude.eror_deg"}}}, "metrics.m.max: "),
        ({"metrics": {"m": {"max": ERROR, "min": ERROR}}}, "metrics.m: has max and min; give one of"),
        ({"metrics": {"m": {"percentile": "truth.attitude.error_deg"}}}, "percentile and percent go together"),
        ({"strategy": SEARCH}, "strategy.axis: no axis is called 'onset'; did you mean 'onset_s'?"),
        ({"strategy": {"kind": "worst"}}, "strategy.kind: worst flies what is drawn, and one combination of lists"),
        ({"strategy": INDICES}, "strategy.kind: indices flies what is drawn, and one combination of lists"),
        ({"metrics": {"law": {"max": ERROR}}}, "metrics.law: is the name of an axis too"),
        ({"name": "../x"}, "name: \"../x\" is not a name"),
        ({"base": []}, "base: has 0 scenarios"),
        ({"samples": 0}, "samples: 0 is out of range"),
        ({"axes": None}, "set.fsw.controller.kind: there is no axis law"),
    ],
)  # fmt: skip
def test_what_a_file_cannot_say(write: Write, changes: dict[str, Any], words: str) -> None:
    """Each mistake is found, at its line and column, in words that say what to do."""
    found = findings(write(**changes))
    assert any(words in line for line in found), found
    assert all(line.startswith(":") and line[1].isdigit() for line in found), found


def test_what_a_scenario_refuses_is_said_of_the_axis(write: Write) -> None:
    """What is wrong with a run's scenario stands at the value of the axis that led to it, with all other such values."""
    bad = {
        **GOOD["axes"],
        "law": ["smc", "pdi"],
        "unit": ["wheel.1", "wheel.9"],
        "fault": {"cases": {"half": {"kind": "loss", "effectiveness": 1.5}}},
        "onset_s": {"uniform": [2, 30], "unit": "s"},
    }
    path = write(axes=bad, samples=12)
    found = inspect(str(path), (), 40).findings
    assert [finding.key for finding in found] == [
        "axes.law[1]", "axes.unit[1]", "axes.fault.cases.half.effectiveness", "axes.onset_s",
    ]  # fmt: skip
    lines = path.read_text().split("\n")
    assert lines[found[0].place.line - 1].strip() == "- pdi"
    assert lines[found[1].place.line - 1].strip() == "- wheel.9"
    assert 'did you mean "pid"' in found[0].message
    assert "run 24: law pdi" in found[0].message
    with pytest.raises(ConfigError, match=r"axes.unit\[1\]"):
        load_campaign(path)


def test_the_example_of_the_docs_is_sound(tmp_path: Path) -> None:
    """The first file of docs/campaigns.md, as it stands there: nothing is wrong with it, and it comes to 15 runs."""
    page = Path(__file__).parents[2].joinpath("docs", "campaigns.md").read_text()
    block = page.split("## The file\n\n")[1].split("\n\n")[0]
    path = tmp_path / "wheel-loss.yaml"
    path.write_text(textwrap.dedent(block))
    found = inspect(str(path), (), 400)
    assert [str(finding) for finding in found.findings] == []
    assert len(load_campaign(path).points()) == 30


def test_every_value_of_every_list_is_tried(write: Write) -> None:
    """The one value of 40 that makes a scenario unsound is found although far from all 960 runs are tried."""
    durations = [10 + index for index in range(39)] + [3]  # with 3 s the fault comes too late
    path = write(
        axes={**GOOD["axes"], "length_s": durations},
        set={**GOOD["set"], "duration_s": "$length_s"},
    )
    found = inspect(str(path), (), 60)
    assert found.campaign is None
    assert {finding.key for finding in found.findings} == {"axes.onset_s"}


def test_too_many_runs_are_counted_and_not_made(write: Write) -> None:
    """10^12 runs are refused with their number at once; so are pairs beyond what a covering array is looked for."""
    huge = axes(**{n: {"range": [1, 1000], "count": 1000} for n in "abcd"})
    (words,) = findings(write(samples=1, **huge))
    assert "axes: 1000000000000 runs (1000 a * 1000 b * 1000 c * 1000 d); at most 200000" in words
    assert "pairs of values are to be covered" in findings(write(combine="pairwise", **huge))[0]
    assert "8000000000 runs" in findings(write(samples=1_000_000, repeats=1000))[0]


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "a", "axes: [", "axes: {a: " + "[" * 200 + "]" * 200 + "}", "name: &a [*a]", "axes:\n  ? [1]\n  : 2\n",
        "name: x\nbase: nominal\naxes: {a: {values: {b: 1}}}", "base: {}", "set: []", "where: {}", "strategy: 5",
        "metrics: {a: {max: 5}}", "axes: {a: {cases: {b: .nan}}}", "requirements: [5]", "keep_logs: [1]", "\x00",
        "name: x\nbase: nominal\nset: {'$a': null}", "name: x\nbase: nominal\nset: {faults: [{'$a': null}]}",
        "name: x\nbase: 'a\\0b'", "name: x\nbase: ''\n", "name: x\nbase: nominal\naxes: {a: {formula: 'a'}}",
        "extends: x\nname: y", "name: x\nbase: nominal\naxes: {a: [1, 1.0]}", "name: x\nbase: nominal\naxes: {a: [null]}",
        "name: x\nbase: nominal\nset: {seed: '$a'}\naxes: {a: [1" + "0" * 390 + "]}",
    ],
)  # fmt: skip
def test_hostile_files_are_refused_in_words(tmp_path: Path, text: str) -> None:
    """Whatever a file holds, there are findings and no exception."""
    path = tmp_path / "x.yaml"
    path.write_text(text)
    found = inspect(str(path), (), 5)
    assert found.campaign is None
    assert found.findings


# -- hilsat check, hilsat run FILE#N ----------------------------------------------------------------------------------


def test_check_tells_campaigns_and_scenarios_apart(write: Write) -> None:
    """Every scenario that ships is taken for a scenario, every campaign for a campaign."""
    assert [path.name for path in SHIPPED.glob("*.yaml") if is_campaign(path)] == []
    assert all(is_campaign(find_campaign(name)) for name in list_campaigns())
    assert is_campaign(write())


def test_check_of_a_campaign(write: Write, capsys: pytest.CaptureFixture[str]) -> None:
    """The report has the runs, the axes with their places in the scenario, and what was left out."""
    report = check_campaign(write(where=["not (law == 'pid' and unit == 'wheel.1')"]), as_json=False)
    assert (report["ok"], report["runs"], report["tried"]) == (True, 18, 18)
    places = {axis["name"]: axis["key"] for axis in report["axes"]}
    assert places == {
        "law": "fsw.controller.kind", "unit": "faults[0].unit", "fault": "faults[0]", "onset_s": "faults[0].at_s",
    }  # fmt: skip
    text = capsys.readouterr().out
    assert "OK: mine" in text
    assert "where: 6 of 24 runs are left out" in text
    json.dumps(report, allow_nan=False)


def test_one_run_by_itself(write: Write) -> None:
    """FILE#N is the scenario that the campaign flies as run N, seed and all; a number beyond it is refused."""
    path = write()
    campaign = load_campaign(path)
    plan = campaign.plan(11, campaign.points()[11])
    expected = load_scenario(find_scenario(plan.base), [*plan.overrides, f"seed={plan.seed}"])
    assert split_word(f"{path}#11") == (str(path), 11)
    one = load_one(str(path), 11)
    assert one.resolved.as_dict() == expected.as_dict()
    assert one.words.startswith("mine, run 11: law smc")
    assert load_one(str(path), 11, ["duration_s=15"]).resolved.scenario.duration_s == 15.0
    with pytest.raises(UsageError, match="has runs 0 to 23"):
        load_one(str(path), 24)
    with pytest.raises(UsageError, match="decided by the strategy until"):
        load_one(str(write(strategy={"kind": "until", "half_width": 0.1})), 0)
    with pytest.raises(UsageError, match="is not the directory of a campaign"):
        load_one(str(path.parent), 0)


def test_added_requirements_are_judged(write: Write, tmp_path: Path) -> None:
    """A requirement file beside the campaign is found, and a run by itself is judged by it too."""
    (tmp_path / "requirements").mkdir()
    (tmp_path / "requirements" / "own.yaml").write_text(
        "requirements: [{id: R-1, name: rate, check: below, signal: norm(truth.attitude.omega_bi_b_rad_s), bound: 1}]\n"
    )
    path = write(requirements=["own"])
    assert load_campaign(path).requirements == (tmp_path / "requirements" / "own.yaml",)
    assert [item.id for item in load_one(str(path), 0).resolved.scenario.expect] == ["R-1"]


def test_near_miss_of_a_shipped_name() -> None:
    """A campaign that is neither a file nor shipped is refused; a path is taken as it is."""
    with pytest.raises(UsageError, match="is not a file and not shipped"):
        find_campaign("no-such-campaign")
    assert find_campaign("x/y.yaml") == Path("x/y.yaml")


def test_shipped_campaigns_are_sound() -> None:
    """Every campaign that ships loads, is called as its file, and flies within the limit that its title names."""
    assert {"wheel-faults", "gyro-faults", "mixed-100", "shootout"} <= set(list_campaigns())
    for name in list_campaigns():
        found = inspect(str(find_campaign(name)), (), 20)
        assert found.campaign is not None, found.findings
        assert found.campaign.name == name
        assert found.campaign.runs
    assert load_campaign(find_campaign("mixed-100")).runs == 100


def test_shootout_is_fair() -> None:
    """All pairs of law and allocator fly the same cases with the same noise: only fsw.* differs."""
    campaign = load_campaign(find_campaign("shootout"), ["samples=3"])
    flown: dict[str, set[tuple[str, ...]]] = {}
    for number, point in enumerate(campaign.points()):
        words = campaign.plan(number, point).overrides
        case = tuple(word for word in words if not word.startswith(("fsw=", "fsw.allocator")))
        flown.setdefault(f"{point.labels['law']} {point.labels['share']}", set()).add(case)
    assert len(flown) == 27
    assert len({frozenset(cases) for cases in flown.values()}) == 1
    assert all(len(cases) == 3 for cases in flown.values())
    assert any(word.startswith("seed=") for word in next(iter(next(iter(flown.values())))))


def test_values_that_name_other_axes(write: Write) -> None:
    """An axis that is named inside the value of another one is filled in; one that is not there is refused."""
    keys = {
        **GOOD["axes"],
        "fault": {"cases": {"loss": {"kind": "loss", "effectiveness": "$left"}}},
        "left": {"uniform": [0.1, 0.9]},
    }
    campaign = load_campaign(write(axes=keys))
    plan = campaign.plan(0, campaign.points()[0])
    word = next(word for word in plan.overrides if word.startswith("faults="))
    assert json.loads(word.partition("=")[2])[0]["effectiveness"] == plan.point.values["left"]
    del keys["left"]
    assert any("cases.loss.effectiveness: loss: there is no axis left" in line for line in findings(write(axes=keys)))


def test_extended_campaign(write: Write, tmp_path: Path) -> None:
    """A campaign that extends another has its keys, and is another campaign when the other file changes."""
    write()
    child = tmp_path / "child.yaml"
    child.write_text("extends: mine.yaml\nname: child\nsamples: 1\n")
    campaign = load_campaign(child)
    assert (campaign.name, campaign.runs) == ("child", 8)
    write(title="other")
    assert load_campaign(child).text != campaign.text
    assert yaml.safe_load(campaign.text) == {"extends": "mine.yaml", "name": "child", "samples": 1}


def test_flown_alone_it_is_the_same_run(write: Write) -> None:
    """A run that is flown from FILE#N has the verdicts and metrics of that run in the campaign, to the last bit."""
    path = write(
        set={**GOOD["set"], "duration_s": 3, "expect": [{"name": "e", "check": "below", "signal": ERROR, "bound": 1}]},
        axes={**GOOD["axes"], "onset_s": {"uniform": [1, 2]}},
        metrics={"end": {"last": ERROR}},
    )
    campaign = load_campaign(path)
    job = make_job(campaign.name, campaign.bases, metrics=campaign.metrics)
    flown = fly(job, campaign.plan(5, campaign.points()[5])).result
    with Bench(load_one(str(path), 5, ["clock.mode=inprocess"]).resolved, log="memory") as bench:
        bench.step(bench.ticks)
        last = bench.log.signals("/truth/attitude")["error_deg"][-1]
    assert flown.metrics["end"] == float(last)
    assert flown.outcome == "fail"
