"""Where the border of what a scenario may hold is: numbers, texts, lists, files, and what the bus can carry."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bus.errors import BusAddressError, ConfigError
from bus.settings import Reading, fields_of, find_unit
from bus.units import ANY_REACH, REACH
from bus.wire.hub.directory import HubDirectory
from tools.config.loader import examine, examine_text, load_scenario
from tools.config.reference import walk_classes
from tools.config.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]
ZHANG = ROOT / "scenarios" / "zhang2018.yaml"
TEXT = ZHANG.read_text()


def said_of(*overrides: str, path: Path = ZHANG) -> list[str]:
    return [f"{finding.key}: {finding.message}" for finding in examine(path, ["expect=[]", *overrides]).findings]


def said_of_text(text: str) -> list[str]:
    return [f"{finding.key}: {finding.message}" for finding in examine_text(text, str(ZHANG)).findings]


# -- numbers -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("duration_s=1e8", "duration_s: 100000000.0 s is out of reach; its magnitude can be at most 1e+07"),
        ("plant.step_s=1e-300", "plant.step_s: 1e-300 s is out of reach; it must be at least 1e-09"),
        ("plant.step_s=1e-6", "plant.step_s: 1e-06 s makes 100000 steps of a tick of 0.1 s; at most 10000"),
        ("plant.gyro.arw_rad_sqrt_s=1e150", "plant.gyro.arw_rad_sqrt_s: 1e+150 is out of reach; its magnitude can be"),
        ("plant.body.rate_deg_s[0]=-1e7", "plant.body.rate_deg_s[0]: -10000000.0 deg/s is out of reach; its magnitude"),
        ("plant.body.rate_deg_s[0]=-1e5", "plant.body.rate_deg_s: 100000 deg/s cannot be followed in steps of 0.01 s"),
        ("fsw.executive.control_divider=10000000000", "fsw.executive.control_divider: 10000000000 is out of reach; its"),
        ("seed=18446744073709551616", "seed: 18446744073709551616 is out of range; allowed: >= 0, <= 1844674407370955"),
        (f"seed=0x{'f' * 300}", "seed: a huge number is out of range; allowed: >= 0, <= 18446744073709551615"),
        (f"seed=0x{'f' * 5000}", 'seed: "0xfffffffffffffffffffffffffffffffffff..." has 5002 characters: not a number'),
        ("plant.wheels[0].inertia_kgm2=1e-12", "plant.wheels[0].inertia_kgm2: 1e-12 kg m^2 is out of reach; it must be"),
        ("fsw.model.inertia_kgm2=[[1e-12,0,0],[0,1e-12,0],[0,0,1e-12]]", "fsw.model.inertia_kgm2: 1e-12 kg m^2 on the"),
    ],
)  # fmt: skip
def test_a_number_out_of_reach_is_refused_with_its_reach(setting: str, said: str) -> None:
    """One finding, at the key, with the unit and what is allowed; without the border each of these is taken or hangs."""
    (got,) = said_of(setting)
    assert got.startswith(said)


def test_ticks_of_a_run_are_bounded() -> None:
    """1e7 s at 1000 Hz are 1e10 ticks: each number is within its reach, both together are not."""
    got = said_of("duration_s=1e7", "clock.tick_hz=1000", "plant.step_s=0.001")
    assert "duration_s: 1e+07 s at 1000 Hz are 1e+10 ticks; at most 1e+09" in got


def test_largest_seed_is_taken() -> None:
    """2^64 - 1, the border itself."""
    assert load_scenario(ZHANG, [f"seed={2**64 - 1}"]).scenario.seed == 18446744073709551615


def test_docs_have_the_table_of_reaches() -> None:
    """docs/limits.md says of every unit what bus/units.py holds settings to, and nothing else."""
    page = (ROOT / "docs" / "limits.md").read_text()
    rows = [line for line in page.split("\n") if line.startswith("| ") and not line.startswith("| unit")]
    expected = [f"| {unit} | {reach.least:g} | {reach.most:g} |" for unit, reach in REACH.items()]
    assert rows == [*expected, f"| any other | {ANY_REACH.least:g} | {ANY_REACH.most:g} |"]


def test_every_unit_has_a_reach() -> None:
    """A unit that is not in the table would be held to 1e12 without a word; bit/s are whole numbers with own limits."""
    units = {find_unit(kind) for _, cls in walk_classes(Scenario, "") for kind, _ in fields_of(cls).values()}
    assert units - {""} <= {*REACH, "bit/s"}


# -- texts and lists -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("name", "../../x", 'name: "../../x" is not a name; it needs letters'),
        ("name", "n" * 300, 'name: "nnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnnn..." has 300 characters; at most 80'),
        ("name", "a\nPASS: b", 'name: "a\\nPASS: b" is not a name'),
        ("name", "a\0b", 'name: "a\\u0000b" is not a name'),
        ("name", ".hidden", 'name: ".hidden" is not a name'),
        ("name", "", 'name: "" is not a name'),
        ("title", "a\nb", 'title: "a\\nb" holds the character U+000A, which cannot be printed on a line'),
        ("title", "a\x1b[2J", 'title: "a\\u001b[2J" holds the character U+001B'),
        ("title", "t" * 201, "title:"),
        ("description", "a\x07", 'description: "a\\u0007" holds the character U+0007, which cannot be printed'),
    ],
)
def test_a_text_that_cannot_be_shown_or_be_a_file_is_refused(key: str, text: str, said: str) -> None:
    """What a scenario calls itself becomes a directory and lines of a report."""
    data = load_scenario(ZHANG).as_dict() | {key: text}
    (problem,) = Reading(Scenario, data).problems
    assert f"{problem.path[0]}: {problem.message}".startswith(said)


def test_texts_beyond_ascii_are_taken() -> None:
    """A title is for people; only names of files are narrow."""
    title = "Lageregelung mit Störung → λ, 衛星 🛰"
    data = load_scenario(ZHANG).as_dict() | {"title": title, "description": "two\nlines"}
    assert Reading(Scenario, data).value.title == title


@pytest.mark.parametrize("key", ["faults", "expect"])
def test_lists_have_an_end(key: str) -> None:
    """1001 entries are refused by their number, without one finding for each."""
    data: dict[str, Any] = load_scenario(ZHANG).as_dict()
    data[key] = [data[key][0]] * 1001
    (problem,) = Reading(Scenario, data).problems
    assert (problem.path, problem.message) == ((key,), "has 1001 entries, at most 1000")


def test_a_signal_of_many_terms_is_refused_in_words() -> None:
    """2000 terms would end in the interpreter's recursion limit when graded."""
    signal = " + ".join(["truth.attitude.error_deg"] * 2000)
    got = said_of_text(TEXT.replace("signal: fsw.law.beta", f"signal: {signal}"))
    assert len(got) == 1
    assert got[0].startswith('expect[4].signal: "truth.attitude.error_deg + truth.atti..."')
    assert got[0].endswith(f"has {len(signal)} characters; at most 400")


# -- files ---------------------------------------------------------------------------------------------------------


def test_a_chain_of_files_has_an_end(tmp_path: Path) -> None:
    """1200 files that extend each other: refused at the tenth; nine are taken."""
    (tmp_path / "0.yaml").write_text(TEXT)
    for number in range(1, 1200):
        (tmp_path / f"{number}.yaml").write_text(f"extends: {number - 1}.yaml\n")
    assert examine(tmp_path / "9.yaml").resolved is not None
    (finding,) = examine(tmp_path / "1199.yaml").findings
    assert finding.message == "is file 11 in a chain; at most 10"


def test_a_hundred_problems_are_listed_and_the_others_counted() -> None:
    """300 faults with a wrong time each: 100 findings and a number, also in what is raised."""
    faults = "[" + ", ".join(["{unit: wheel.1, kind: dead, at_s: -1}"] * 300) + "]"
    examination = examine(ZHANG, [f"faults={faults}"])
    assert (len(examination.findings), examination.unlisted) == (100, 200)
    with pytest.raises(ConfigError, match=r"and 200 more problems$"):
        load_scenario(ZHANG, [f"faults={faults}"])


def test_unknown_keys_are_named_up_to_twenty() -> None:
    """A file that is something else: twenty keys are named, the others counted."""
    got = said_of_text(TEXT + "".join(f"key{number}: 1\n" for number in range(500)))
    assert len(got) == 21
    assert any(line.startswith("(top level): has 480 more unknown keys") for line in got)


MEGABYTE: dict[str, str] = {
    "unknown keys": "".join(f"key{number}: 1\n" for number in range(70_000)),
    "some thousand unknown keys": TEXT + "".join(f"key{number}: 1\n" for number in range(20_000)),
    "one key again and again": "name: a\n" * 110_000,
    "one key some thousand times": "name: a\n" * 20_000,
    "broken": "a: b: c\n" * 120_000,
    "broken, and short enough to be explained": "- [a, b]\n" * 880 + "]",
    "broken at its end": "a\n" * 500_000 + ": ]",
    "open brackets": "[" * 1_000_000,
    "few open brackets": "[" * 7_900,
    "dashes": "- " * 500_000,
    "wide": "[" + "a," * 500_000 + "]",
    "aliases of a wide list": "a: &a [" + "x," * 20_000 + "]\nb: [" + "*a ," * 20_000 + "]",
    "aliases of aliases": "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, 12_000)),
    "merges": "a: &a {" + "".join(f"k{i}: 1, " for i in range(12_000)) + "}\nb: {<<: [" + "*a ," * 12_000 + "]}",
    "merges of merges": "a0: &a0 {x: 1}\n" + "".join(f"a{n}: &a{n} {{<<: *a{n - 1}}}\n" for n in range(1, 9_000)),
    "digits": TEXT.replace("seed: 2018", "seed: " + "9" * 900_000),
    "hexadecimal digits": TEXT.replace("seed: 2018", "seed: 0x" + "f" * 900_000),
    "wrong faults": TEXT.replace("faults:\n", "faults:\n" + "  - {unit: wheel.9, kind: los, foo: 1, at_s: 1e9}\n" * 990),
    "wrong signals": TEXT + "".join(
        f"  - {{name: e{n}, check: below, bound: 1, signal: {f'truht.attitude.x{n} + ' * 15}1}}\n" for n in range(980)
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", MEGABYTE)
def test_no_text_of_a_megabyte_takes_long_to_be_refused(kind: str) -> None:
    """Three seconds of processor time for any of them; some took minutes, and one for ever."""
    start_s = time.process_time()
    examination = examine_text(MEGABYTE[kind], str(ZHANG))
    words = [str(finding) for finding in examination.findings]
    assert time.process_time() - start_s < 3.0
    assert examination.resolved is None
    assert 1 <= len(words) <= 100
    assert all(len(word) < 1500 for word in words)


@pytest.mark.slow
@pytest.mark.parametrize("kind", MEGABYTE)
def test_no_text_of_a_megabyte_takes_much_memory(kind: str, tmp_path: Path) -> None:
    """Peak of the whole process below 200 MB, interpreter and libraries (40 MB) counted."""
    file = tmp_path / "s.yaml"
    file.write_text(MEGABYTE[kind])
    # not ru_maxrss, which begins with what the process had before it became this program
    code = "import sys; from tools.config.check import check; check(sys.argv[1]);"
    code += "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"
    done = subprocess.run([sys.executable, "-c", code, str(file)], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 200 * 1024


# -- the bus -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("plant.wheels[1].max_torque_nm=9000", "plant.wheels[1].max_torque_nm: 9000 N m does not fit into TORQUE of RW2"),
        ("fsw.model.wheel_max_torque_nm=9000", "fsw.model.wheel_max_torque_nm: 9000 N m does not fit into TORQUE of RW1"),
        ("plant.wheels[3].max_speed_rad_s=8400", "plant.wheels[3].max_speed_rad_s: 8400 rad/s does not fit into SPEED of"),
        ("plant.gyro.range_rad_s=2.2", "plant.gyro.range_rad_s: 2.2 rad/s does not fit into RATE of FOGX_RATE; at most 2."),
        ("plant.wheels[0].motor_constant_nm_a=0.003",
         "plant.wheels[0].motor_constant_nm_a: 0.1 N m at 0.003 N m/A draw 33.3333 A, which does not fit into CURRENT"),
    ],
)  # fmt: skip
def test_a_vehicle_that_its_frames_cannot_carry_is_refused(setting: str, said: str) -> None:
    """The wire would cut the value without a word."""
    assert any(line.startswith(said) for line in said_of(setting))


def test_what_the_frames_can_just_carry_is_taken() -> None:
    """The border itself, worked out from bits and scale by hand: 2^31 - 1 times 1e-9 rad/s, 2^23 - 1 times 1e-3 rad/s."""
    settings = ["plant.gyro.range_rad_s=2.147483647", "plant.wheels[0].max_speed_rad_s=8388.607"]
    assert examine(ZHANG, settings).findings == ()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["bus.address=memory:x"], "bus.address: memory: is a bus within one process; use hub: for two"),
        (["bus.address=memory:x", "clock.mode=realtime"], "bus.address: memory: is a bus within one process"),
        (["bus.address=vcan0"], 'bus.address: bus address "vcan0" names no transport; did you mean socketcan:vcan0?'),
        (["bus.address=hubb:x"], 'bus.address: bus address "hubb:x" names no transport; did you mean hub:x?'),
    ],
)
def test_a_bus_that_two_processes_cannot_meet_on_is_refused(settings: list[str], said: str) -> None:
    """Found before anything is started; a run would end with exit code 2, or wait for a peer that cannot come."""
    (got,) = said_of(*settings)
    assert got.startswith(said)


def test_one_process_opens_no_bus() -> None:
    """In process the address means nothing, so nothing is said of it."""
    assert said_of("bus.address=memory:x", "clock.mode=inprocess") == []


@pytest.mark.parametrize("below", ["", "/deeper"])
def test_a_hub_on_a_link_that_leads_nowhere_is_refused(tmp_path: Path, below: str) -> None:
    """Making the directory used to be tried for ever, at full load."""
    os.symlink(tmp_path / "nowhere", tmp_path / "link")
    place = f"{tmp_path}/link{below}"
    words = f"{tmp_path}/link is a link that leads nowhere; name another directory"
    assert said_of(f"bus.address=hub:{place}") == [f"bus.address: hub:{place}: {words}"]
    with pytest.raises(BusAddressError, match="leads nowhere"):
        HubDirectory.make(Path(place))


def test_a_hub_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "is not a directory" in said_of(f"bus.address=hub:{tmp_path}/file/x")[0]
    assert said_of(f"bus.address=hub:{tmp_path}/new/x") == []
