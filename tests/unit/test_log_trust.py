"""What a verdict is worth: logs with holes, damage, lies and nothing in them are never graded a pass."""

from __future__ import annotations

import argparse
import random
import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import bus
import tools.grading.grade as grading
from bus.errors import ConfigError, HilsatError, RecordError, UsageError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics
from plant_server.faults import make_fault
from tools.config.loader import load_scenario, load_text
from tools.config.scenario import Resolved
from tools.grading.faults import find_effect, judge_faults
from tools.grading.grade import Grade, format_grade, grade_file
from tools.log.completeness import Completeness, Gap, Timetable, check_completeness
from tools.log.mcap_reader import read_run
from tools.log.recorder import Recorder, RunAttachment
from tools.log.recover import recover
from tools.verbs import grade as grade_verb
from tools.verbs import plot as plot_verb

NOMINAL = Path(bus.__file__).resolve().parents[1] / "scenarios" / "nominal.yaml"
TICKS, TICK_NS = 20, 100_000_000  # 2 s at 10 Hz
TRUTH = TickPacker([Topic("/truth/attitude", "hilsat/TruthAttitude", (Field("error_deg"), Field("hole")))], 2)
FSW = TickPacker(
    [
        Topic("/fsw/attitude", "hilsat/FswAttitude", (Field("error_deg"),)),
        Topic("/fsw/executive", "hilsat/FswExecutive", (Field("rivals"),)),
    ],
    101,
)
CHUNK, ATTACHMENT = 6, 9
BELOW = "{name: small, check: below, signal: truth.attitude.error_deg, bound: 25}"
FAULT = "{unit: wheel.1, kind: loss, effectiveness: 0.5, at_s: 1}"


@cache
def scenario(expect: str = f"[{BELOW}]", faults: str = "[]", mode: str = "inprocess", ticks: int = TICKS) -> Resolved:
    settings = [f"duration_s={ticks / 10}", f"expect={expect}", f"faults={faults}", f"clock.mode={mode}"]
    return load_scenario(NOMINAL, settings)


Skip = Callable[[int], bool]
FaultRecords = tuple[tuple[str, str, str, int], ...]
FIRED: FaultRecords = (("wheel.1", "loss", "onset", 10), ("wheel.1", "loss", "effect", 10))


def never(tick: int) -> bool:
    return False


def write_log(
    path: Path, resolved: Resolved, *, skip_truth: Skip = never, skip_fsw: Skip = never, dropped: int = 0,
    faults: FaultRecords = (), ticks: int = TICKS, close: bool = True, text: str = "", rivals: int = 0,
) -> Path:  # fmt: skip
    """error_deg = tick in the truth and in the flight software; small chunks, so that there are several."""
    attachment = RunAttachment("scenario.yaml", "application/yaml", (text or resolved.to_yaml()).encode())
    recorder = Recorder(path, metadata={"run_id": "x"}, attachments=[attachment], sources=(1, 2))
    recorder._limit_bytes = 900  # a chunk every few ticks
    plant, fsw = recorder.link(1), recorder.link(2)
    plant.announce(announce_topics([TRUTH]))
    fsw.announce(announce_topics([FSW]))
    for tick in range(ticks):
        if not skip_truth(tick):
            plant.write_tick(tick, tick * TICK_NS, TRUTH.pack(tick, tick * TICK_NS, float(tick), 0.0))
        if not skip_fsw(tick):
            fsw.write_tick(tick, tick * TICK_NS, FSW.pack(tick, tick * TICK_NS, float(tick), float(rivals)))
        for unit, kind, phase, at in faults:
            if at == tick:
                plant.fault(tick * TICK_NS, tick, unit, kind, phase, 0.5, id="faults[0]")
        if tick % 5 == 4:
            for link in (plant, fsw):
                link.flush()
            recorder.flush()
    plant.dropped = dropped
    if close:
        plant.close("done")
        fsw.close("done")
        recorder.close()
    else:
        plant.flush()
        recorder.flush()
    return path


def outcomes(grade: Grade) -> dict[str, str]:
    return {verdict.name: verdict.outcome for verdict in grade.verdicts}


def find_records(raw: bytes) -> list[tuple[int, int, int]]:
    """Opcode, offset and length of the body of every record, by the MCAP specification."""
    found, at = [], 8
    while at + 9 <= len(raw) - 8:
        opcode, length = struct.unpack_from("<BQ", raw, at)
        found.append((opcode, at + 9, length))
        at += 9 + length
    return found


def flip(path: Path, opcode: int, index: int = 0, where: float = 0.5) -> Path:
    """Flip one byte in the body of the n-th record of a kind."""
    raw = bytearray(path.read_bytes())
    _, start, length = [record for record in find_records(raw) if record[0] == opcode][index]
    raw[start + int(length * where)] ^= 0xFF
    path.write_bytes(raw)
    return path


# -- holes ---------------------------------------------------------------------------------------------------------


def test_a_whole_log_passes_and_counts_its_ticks(tmp_path: Path) -> None:
    """The control: everything is there, and the ticks are a requirement of their own."""
    grade = grade_file(write_log(tmp_path / "a.mcap", scenario()))
    assert outcomes(grade) == {
        "small": "pass",
        "no id has two senders": "pass",
        "no tick is missing in the log": "pass",
    }
    assert grade.outcome == "pass"
    assert grade.verdicts[-1].value == 0


def test_a_second_sender_of_an_id_fails_the_run(tmp_path: Path) -> None:
    """What the flight software counted is held against every run, whatever its scenario asks for."""
    grade = grade_file(write_log(tmp_path / "a.mcap", scenario(), rivals=3))
    assert outcomes(grade)["no id has two senders"] == "fail"
    assert grade.outcome == "fail"
    assert "3 met by the flight software" in format_grade(grade)


def test_a_damaged_chunk_is_a_hole_that_is_named_and_never_a_pass(tmp_path: Path) -> None:
    """The only requirement fails in the first chunk: flipping a byte there must not turn the fail into a pass."""
    early = scenario("[{name: late, check: above, signal: truth.attitude.error_deg, bound: 3}]")
    path = write_log(tmp_path / "a.mcap", early)
    assert outcomes(grade_file(path))["late"] == "fail"
    grade = grade_file(flip(path, CHUNK))
    assert not grade.passed
    assert outcomes(grade)["late"] == "not executed"
    words = format_grade(grade)
    assert "NOT EXECUTED" in words
    assert "ticks 0 to 4 are not in the log (damaged chunk)" in words
    assert grade.as_dict()["outcome"] == "fail"
    assert [verdict["passed"] for verdict in grade.as_dict()["verdicts"]] == [False, True, False]


def test_a_window_beside_the_hole_is_graded_and_the_run_is_still_no_pass(tmp_path: Path) -> None:
    """Ticks 5 to 9 are gone; from 1.5 s on all is there."""
    late = scenario("[{name: late, check: above, signal: truth.attitude.error_deg, bound: 3, from_s: 1.5}]")
    grade = grade_file(flip(write_log(tmp_path / "a.mcap", late), CHUNK, 1))
    assert outcomes(grade) == {"late": "pass", "no id has two senders": "pass", "no tick is missing in the log": "fail"}
    assert grade.verdicts[-1].value == 5
    assert not grade.passed


def test_ticks_that_the_recorder_dropped_are_told_from_others(tmp_path: Path) -> None:
    """What the recording says of itself is the reason; without it nobody knows."""
    for dropped, reason in ((3, "dropped by the recorder"), (0, "unknown why")):
        path = write_log(tmp_path / f"{dropped}.mcap", scenario(), skip_truth=lambda t: 7 <= t < 10, dropped=dropped)
        grade = grade_file(path)
        assert not grade.passed
        assert f"/truth/attitude: ticks 7 to 9 are not in the log ({reason})" in grade.verdicts[0].detail


def test_a_log_that_ends_early_is_no_pass(tmp_path: Path) -> None:
    """Cut, closed early, or of a single sample: what comes after was not seen."""
    for ticks, close in ((15, True), (15, False), (1, True)):
        path = write_log(tmp_path / f"{ticks}{close}.mcap", scenario(), ticks=ticks, close=close)
        grade = grade_file(path)
        assert outcomes(grade)["small"] == "not executed"
        assert "log ends early" in grade.verdicts[0].detail
        assert not grade.complete
        assert not grade.passed


def test_a_recovered_log_keeps_its_hole(tmp_path: Path) -> None:
    """`recover` writes a whole file; what was lost stays lost, and the grade says so."""
    path = flip(write_log(tmp_path / "a.mcap", scenario()), CHUNK, 1)
    found = recover(path, tmp_path / "b.mcap")
    assert found.holes
    assert any("ticks 5 to 9" in line for line in found.lost)
    grade = grade_file(tmp_path / "b.mcap")
    assert not grade.passed
    assert outcomes(grade)["small"] == "not executed"


def test_a_tick_twice_is_not_two_ticks(tmp_path: Path) -> None:
    """A chunk copied over another: as many records as ticks, and five of them missing."""
    path = write_log(tmp_path / "a.mcap", scenario())
    raw = path.read_bytes()
    chunks = [(start, length) for opcode, start, length in find_records(raw) if opcode == CHUNK]
    (one, n), (two, m) = chunks[1], chunks[2]
    twice = raw[: two - 9] + raw[one - 9 : one + n] + raw[two + m :]
    path.write_bytes(twice)
    grade = grade_file(path)
    assert not grade.passed
    assert "of a tick that has one already" in grade.verdicts[-1].detail


def test_ticks_that_the_flight_software_skipped_in_real_time_are_no_hole(tmp_path: Path) -> None:
    """With slips counted, /fsw may lack ticks; an expectation over it says so. The truth never may."""
    resolved = scenario("[{name: f, check: below, signal: fsw.attitude.error_deg, bound: 99}]", mode="realtime")
    path = write_log(tmp_path / "a.mcap", resolved, skip_fsw=lambda t: t in (8, 9))
    timetable = grading.make_timetable(resolved)
    assert timetable.realtime
    run = read_run(path)
    gaps = check_completeness(run, timetable).gaps  # nobody counted a slip: unexplained
    assert {(gap.topic, gap.first, gap.last, gap.ran) for gap in gaps} == {
        (topic.name, 8, 9, True) for topic in FSW.topics
    }
    explained = Completeness((Gap("/fsw/attitude", 8, 9, 1, "not run (slips)"),), ())
    assert explained.missing == 0
    verdict = grading.judge(run, resolved.scenario.expect[0], explained, timetable)
    assert verdict.passed
    assert "2 records of its window were not made" in verdict.detail
    assert not grade_file(write_log(tmp_path / "b.mcap", resolved, skip_truth=lambda t: t == 8)).passed


def test_nothing_asked_is_nothing_passed(tmp_path: Path) -> None:
    """Neither expectations nor faults: not executed, exit code 1."""
    path = write_log(tmp_path / "a.mcap", scenario("[]"))
    grade = grade_file(path)
    assert grade.outcome == "not executed"
    assert "nothing was graded" in format_grade(grade)
    words = {"files": [path], "json": False, "requirements": [], "junit": None, "against": None}
    assert grade_verb.run(type("Words", (), words)()) == 1


# -- faults --------------------------------------------------------------------------------------------------------


def fault_record(
    phase: str, tick: int, own_id: str = "faults[0]", unit: str = "wheel.1", kind: str = "loss"
) -> dict[str, Any]:
    return {"id": own_id, "number": 1, "unit": unit, "fault": kind, "phase": phase, "tick": tick}


@pytest.mark.parametrize(
    ("records", "passes"),
    [
        ([("onset", 10), ("effect", 10)], True),
        ([("onset", 11), ("effect", 15)], True),
        ([("onset", 10)], False),  # switched on, changed nothing
        ([("effect", 10)], False),  # no onset
        ([("onset", 13), ("effect", 13)], False),  # too late
        ([("onset", 10), ("effect", 9)], False),  # before its onset
        ([("refused", 10), ("effect", 10)], False),
    ],
)
def test_a_fault_with_an_id_passes_by_its_effect(records: list[tuple[str, int]], passes: bool) -> None:
    """Only an effect of this fault, at or after an onset that came when it was due."""
    fault = make_fault(unit="wheel.1", kind="loss", effectiveness=0.5, at_s=1.0)
    timetable, nothing = Timetable(TICKS, 10), Completeness((), ())
    (verdict,) = judge_faults([fault_record(*record) for record in records], (fault,), nothing, timetable)
    assert verdict.passed is passes


def test_another_faults_effect_does_not_count() -> None:
    """Another id, unit or kind; a fault of the whole gyro counts by its own id."""
    fault = make_fault(unit="wheel.1", kind="loss", effectiveness=0.5, at_s=1.0)
    onset = fault_record("onset", 10)
    for other in ({"own_id": "faults[1]"}, {"unit": "wheel.2"}, {"kind": "dead"}):
        assert find_effect([onset, fault_record("effect", 10, **other)], "faults[0]", fault, 10)[0] is None
    gyro = make_fault(unit="gyro", kind="constant", rate_rad_s=0.1, at_s=1.0)
    axis = [fault_record(phase, 10, unit="gyro", kind="constant") for phase in ("onset", "effect")]
    assert find_effect(axis, "faults[0]", gyro, 10)[0] == 10
    assert find_effect(axis[:1], "faults[0]", gyro, 10)[0] is None


# -- a log is data -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["extends: {0}\n", '{{"extends": {0}}}\n', "? extends\n: {0}\n", "'extends': {0}\n"])
def test_nothing_outside_the_log_is_read(form: str, tmp_path: Path) -> None:
    """An attached scenario that extends a file, a sound one here, is refused and none of the file is quoted."""
    secret = tmp_path / "secret.yaml"
    secret.write_text(scenario().to_yaml().replace("title:", "title: not for the eyes of a log\n#"))
    path = write_log(tmp_path / "a.mcap", scenario(), text=form.format(secret))
    with pytest.raises((RecordError, ConfigError)) as caught:
        grade_file(path)
    assert "eyes" not in str(caught.value)
    assert "extends" in str(caught.value)


def test_a_flipped_bound_is_not_believed(tmp_path: Path) -> None:
    """The attachment carries a checksum, and a log with two scenarios has none."""
    path = flip(write_log(tmp_path / "a.mcap", scenario()), ATTACHMENT)
    with pytest.raises(RecordError, match=r"scenario\.yaml is damaged"):
        grade_file(path)
    raw = write_log(tmp_path / "b.mcap", scenario()).read_bytes()
    _, start, length = next(record for record in find_records(raw) if record[0] == ATTACHMENT)
    body = raw[start : start + length - 4].replace(b"bound: 25.0", b"bound: 99.0")
    other = struct.pack("<BQ", ATTACHMENT, length) + body + struct.pack("<I", zlib.crc32(body))
    (tmp_path / "b.mcap").write_bytes(raw[: start - 9] + other + raw[start - 9 :])
    with pytest.raises(RecordError, match="2 different files called scenario"):
        grade_file(tmp_path / "b.mcap")


# -- pictures ------------------------------------------------------------------------------------------------------


def test_a_picture_of_anything_or_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Broken TeX in title and fault is text; an unknown kind of picture, and one that is there, are refused."""
    resolved = load_scenario(NOMINAL, ["duration_s=2", r"title='50 $ \\frac{ of $'", "expect=[]"])
    path = write_log(tmp_path / "a.mcap", resolved, faults=(("$\\frac{", "loss", "onset", 10),), ticks=15)

    def plot(out: str, force: bool = False) -> int:
        parser = argparse.ArgumentParser()
        plot_verb.add_parser(parser.add_subparsers())
        return plot_verb.run(parser.parse_args(["plot", str(path), "-o", str(tmp_path / out), *["--force"] * force]))

    assert plot("a.png") == 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert "log ends early" in capsys.readouterr().err
    for out, words in (
        ("a.png", "there already"),
        ("a.xyz", "one of png"),
        ("a.mcap", "one of png"),
        ("a", "one of png"),
    ):
        with pytest.raises(UsageError, match=words):
            plot(out)
    assert plot("a.png", force=True) == 0


# -- bytes ---------------------------------------------------------------------------------------------------------


def mutate(random_: random.Random, data: bytes) -> bytes:
    """Some bytes flipped, put in, taken out or copied elsewhere, or the end cut off."""
    raw = bytearray(data)
    for _ in range(random_.choice((1, 1, 1, 2, 5))):
        if raw:
            at, count = random_.randrange(len(raw)), random_.randrange(1, 80)
            match random_.randrange(5):
                case 0:
                    raw[at] ^= 1 << random_.randrange(8)
                case 1:
                    raw[at:at] = random_.randbytes(count)
                case 2:
                    del raw[at : at + count]
                case 3:
                    del raw[at:]
                case _:
                    to = random_.randrange(len(raw))
                    raw[to : to + count] = raw[at : at + count]
    return bytes(raw)


def grade_mutations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, seed: int) -> int:
    """Grade mutations of a log that passes and of one that fails; how many could not be graded at all."""
    monkeypatch.setattr(grading, "load_text", cache(load_text))
    fails = scenario("[{name: late, check: above, signal: truth.attitude.error_deg, bound: 3}]", f"[{FAULT}]")
    bases = [
        write_log(tmp_path / "good.mcap", scenario(faults=f"[{FAULT}]"), faults=FIRED).read_bytes(),
        write_log(tmp_path / "bad.mcap", fails, faults=FIRED).read_bytes(),
    ]
    assert [grade_file(tmp_path / name).outcome for name in ("good.mcap", "bad.mcap")] == ["pass", "fail"]
    random_, path, refused = random.Random(seed), tmp_path / "mutated.mcap", 0
    for number in range(count):
        which = random_.randrange(2)
        path.write_bytes(mutate(random_, bases[which]))
        try:
            grade = grade_file(path)
        except HilsatError:
            refused += 1
            continue
        assert not (grade.passed and which), f"mutation {number} of seed {seed} turned a fail into a pass"
        format_grade(grade)
    return refused


def test_no_mutation_of_a_failing_log_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few hundred: no exception but ours, no pass that the sound log has not."""
    assert 0 < grade_mutations(tmp_path, monkeypatch, 300, 1) < 300


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_no_mutation_of_a_failing_log_passes_in_20000(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same, 20 000 times."""
    assert 0 < grade_mutations(tmp_path, monkeypatch, 20_000, 2) < 20_000
