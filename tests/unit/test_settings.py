"""Building settings from plain data: what is accepted, what is said about the rest."""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from bus.errors import ConfigError
from bus.run import RunConfig, run_hash
from bus.settings import build, join_key, plain
from bus.units import Gt, Le, Seconds, Unit, Vec3
from fsw.config import FswConfig
from fsw.estimation.settings import MekfConfig
from fsw.observers.settings import IloConfig
from plant_server.config import ExclusionConfig, PlantConfig, StarTrackerConfig

ROOT = Path(__file__).resolve().parents[2]
INERTIA = [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]
FSW: dict[str, Any] = {
    "model": {"inertia_kgm2": INERTIA},
    "estimator": {"kind": "direct"},
    "observer": {"kind": "ilo", "k1": 0.2},
    "controller": {"kind": "smc"},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    kind: Literal["round"]
    radius_m: Annotated[float, Unit("m"), Gt(0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Square:
    kind: Literal["square"]
    side_m: Annotated[float, Unit("m"), Gt(0), Le(10)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    name: str
    shape: Round | Square
    count: int = 1
    spare: bool = False
    offset_m: Annotated[Vec3, Unit("m")] = (0.0, 0.0, 0.0)
    delay_s: Annotated[Seconds, Gt(0)] | None = None
    holes: tuple[Round, ...] = ()


SOUND = {"name": "plate", "shape": {"kind": "square", "side_m": 2}}


def problems_of(data: Any, cls: type = Part) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        build(cls, data, "x")
    assert all(problem.startswith("x: ") for problem in caught.value.problems)
    return [problem.removeprefix("x: ") for problem in caught.value.problems]


def test_values_arrive_typed_and_defaults_fill_in() -> None:
    """A whole number given for a float becomes a float, a list becomes a tuple, the tag chooses the class."""
    part = build(Part, SOUND | {"offset_m": [1, 2, 3], "holes": [{"kind": "round", "radius_m": 1}]}, "x")
    assert part == Part(
        name="plate",
        shape=Square(kind="square", side_m=2.0),
        offset_m=(1.0, 2.0, 3.0),
        holes=(Round(kind="round", radius_m=1.0),),
    )
    assert isinstance(part.shape, Square)
    assert isinstance(part.shape.side_m, float)
    assert isinstance(part.offset_m[0], float)


CASES: list[tuple[str, Any, list[str]]] = [
    ("not a mapping", [], ["(top level): a list where a mapping is needed, with the keys name, shape, count, spare, "
                           "offset_m, delay_s, holes"]),
    ("missing", {"name": "a"}, ["shape: is missing"]),
    ("missing with unit", SOUND | {"shape": {"kind": "square"}}, ["shape.side_m: is missing [m]"]),
    ("near miss", SOUND | {"cuont": 2}, ['cuont: is not a known key; did you mean "count"?']),
    ("wrong unit in the key", SOUND | {"offset_mm": [0, 0, 0]},
     ['offset_mm: is not a known key; did you mean "offset_m" [m]?']),
    ("nothing like it", SOUND | {"qqqq": 2},
     ["qqqq: is not a known key; there are: name, shape, count, spare, offset_m, delay_s, holes"]),
    ("misspelt and required: said once", {"nmae": "a", "shape": SOUND["shape"]},
     ['nmae: is not a known key; did you mean "name"?', ]),
    ("text for a number", SOUND | {"delay_s": "soon"}, ['delay_s: "soon" is not a number [s]; allowed: > 0']),
    ("unit in the value", SOUND | {"delay_s": "3 s"},
     ['delay_s: "3 s" is not a number [s]; allowed: > 0; write the number alone, in s']),
    ("true for a number", SOUND | {"delay_s": True}, ["delay_s: true is not a number [s]; allowed: > 0"]),
    ("out of range", SOUND | {"delay_s": 0}, ["delay_s: 0.0 s is out of range; allowed: > 0"]),
    ("both limits", SOUND | {"shape": {"kind": "square", "side_m": 11}},
     ["shape.side_m: 11.0 m is out of range; allowed: > 0, <= 10"]),
    ("not finite", SOUND | {"delay_s": float("nan")}, ["delay_s: nan is not a finite number [s]; allowed: > 0"]),
    ("infinite", SOUND | {"offset_m": [0, float("inf"), 0]}, ["offset_m[1]: inf is not a finite number [m]"]),
    ("too large for a float", SOUND | {"delay_s": 10**400}, ["delay_s: is too large for a number [s]; allowed: > 0"]),
    ("fraction for a count", SOUND | {"count": 1.5}, ["count: 1.5 is not a whole number"]),
    ("true for a count", SOUND | {"count": True}, ["count: true is not a whole number"]),
    ("text for a switch", SOUND | {"spare": "on"}, ['spare: "on" is neither true nor false']),
    ("number for text", SOUND | {"name": 7}, ["name: 7 is not text; put it in quotes"]),
    ("too few", SOUND | {"offset_m": [0, 0]}, ["offset_m: has 2 entries, needs 3"]),
    ("not a list", SOUND | {"offset_m": 1}, ["offset_m: 1 where a list is needed"]),
    ("nothing", SOUND | {"offset_m": None}, ["offset_m: nothing where a list is needed"]),
    ("unknown tag", SOUND | {"shape": {"kind": "sqare"}},
     ['shape.kind: "sqare" is not known; did you mean "square"? there are: round, square']),
    ("no tag", SOUND | {"shape": {"side_m": 1}}, ["shape.kind: is missing; there are: round, square"]),
    ("tag of a wrong type", SOUND | {"shape": {"kind": 3}}, ["shape.kind: 3 is not known; there are: round, square"]),
    ("text for a tagged mapping", SOUND | {"shape": "round"},
     ['shape: "round" where a mapping is needed, with kind: round | square']),
    ("inside a list", SOUND | {"holes": [{"kind": "round", "radius_m": 1}, {"kind": "round", "radius_m": -1}]},
     ["holes[1].radius_m: -1.0 m is out of range; allowed: > 0"]),
    ("all at once", {"shape": {"kind": "square", "side_m": "a"}, "count": "b", "offset_m": [0, "c", "d"]},
     ["name: is missing", 'shape.side_m: "a" is not a number [m]; allowed: > 0, <= 10',
      'count: "b" is not a whole number', 'offset_m[1]: "c" is not a number [m]',
      'offset_m[2]: "d" is not a number [m]']),
]  # fmt: skip


@pytest.mark.parametrize(("data", "said"), [pytest.param(d, s, id=i) for i, d, s in CASES])
def test_every_problem_is_named_with_its_key_and_what_is_allowed(data: Any, said: list[str]) -> None:
    """The whole message is the contract: users read it, and nothing else tells them what to do."""
    assert problems_of(data) == said


def test_real_settings_survive_json() -> None:
    """What the run's starter writes is what the process reads: the same objects come back through JSON."""
    fsw = build(FswConfig, FSW, "x")
    assert isinstance(fsw.observer, IloConfig)
    assert fsw.observer.k1 == 0.2
    assert build(FswConfig, json.loads(json.dumps(plain(fsw))), "x") == fsw
    tracker = StarTrackerConfig(exclusion=ExclusionConfig(angle_deg=20.0))
    assert build(StarTrackerConfig, json.loads(json.dumps(plain(tracker))), "x") == tracker
    assert build(StarTrackerConfig, plain(StarTrackerConfig()), "x").exclusion is None


def test_another_kind_has_its_own_keys() -> None:
    """A key of one kind is unknown in another: nothing is carried along silently."""
    said = problems_of(FSW | {"estimator": {"kind": "direct", "gate_sigma": 3}}, FswConfig)
    assert said == ["estimator.gate_sigma: is not a known key; there are: kind"]
    assert isinstance(build(FswConfig, FSW | {"estimator": {"kind": "mekf"}}, "x").estimator, MekfConfig)


def test_wheels_are_four() -> None:
    """A plant has exactly four wheels; three are refused with the count."""
    data = {"body": {"inertia_kgm2": INERTIA}, "wheels": [{"mount": "x"}] * 3}
    assert problems_of(data, PlantConfig) == ["wheels: has 3 entries, needs 4"]


def test_run_config_counts_ticks_in_whole_numbers() -> None:
    """300 s at 100 Hz are 30000 ticks of 10 ms; 0.3 * 10 is not 2.9999 but 3."""
    run = build(RunConfig, {"name": "a", "seed": 1, "duration_s": 300, "run_hash": 7}, "x")
    assert (run.ticks, run.tick_ns) == (30000, 10_000_000)
    short = {"name": "a", "seed": 1, "duration_s": 0.3, "run_hash": 7, "clock": {"tick_hz": 10}}
    assert build(RunConfig, short, "x").ticks == 3


RESOLVED: dict[str, Any] = {
    "name": "a", "seed": 3, "duration_s": 10.0, "clock": {"mode": "lockstep", "tick_hz": 100},
    "bus": {"address": "hub:"}, "plant": {"x": 1.5}, "faults": [], "fsw": {"y": 2.0}, "expect": [],
}  # fmt: skip


def test_run_hash_is_that_of_its_definition() -> None:
    """First four bytes of SHA-256 over canonical JSON, computed here from the definition, not from the code."""
    text = '{"duration_s":10.0,"faults":[],"fsw":{"y":2.0},"plant":{"x":1.5},"seed":3,"tick_hz":100}'
    assert run_hash(RESOLVED) == int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"seed": 4}, False),
        ({"duration_s": 11.0}, False),
        ({"plant": {"x": 1.6}}, False),
        ({"faults": [1]}, False),
        ({"fsw": {"y": 2.1}}, False),
        ({"clock": {"mode": "lockstep", "tick_hz": 50}}, False),
        ({"clock": {"mode": "inprocess", "tick_hz": 100}}, True),
        ({"bus": {"address": "socketcan:vcan0"}}, True),
        ({"expect": [1]}, True),
        ({"name": "b"}, True),
    ],
)
def test_run_hash_changes_with_what_decides_the_bytes_alone(change: dict[str, Any], same: bool) -> None:
    """Lock-step and in-process runs must carry the same hash, for their bytes are compared."""
    assert (run_hash(RESOLVED | change) == run_hash(RESOLVED)) is same


def test_key_paths_read_as_people_write_them() -> None:
    assert join_key(("plant", "wheels", 2, "max_torque_nm")) == "plant.wheels[2].max_torque_nm"
    assert join_key(()) == "(top level)"


def test_module_needs_the_standard_library_only() -> None:
    """The flight software imports them: beside `bus` itself only annotated-types, which holds the limits, may come in."""
    outside: set[str] = set()
    for module in ("settings", "run", "units", "texts", "words", "errors"):
        for node in ast.walk(ast.parse((ROOT / "bus" / f"{module}.py").read_text())):
            if isinstance(node, ast.ImportFrom):
                outside.add((node.module or "").split(".")[0])
            elif isinstance(node, ast.Import):
                outside |= {alias.name.split(".")[0] for alias in node.names}
    assert outside - set(sys.stdlib_module_names) == {"annotated_types", "bus"}
    code = "import sys, fsw.config, bus.settings; print(*sorted({'pydantic', 'yaml', 'tools'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
