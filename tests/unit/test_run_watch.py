"""Who is named when processes of a run fail: the culprit first, nobody who is well, and in good time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from tools.run.children import Process
from tools.run.watch import GRACE_S, RECORDER_PATIENCE_S, SIDE_PATIENCE_S, STOPPED_S, Watch


@dataclass
class Stub:
    """A process as the watch sees one."""

    name: str
    code: int | None = None
    stopped: bool = False

    def fate(self) -> str:
        return f"{self.name}:{self.code}"


class Bench:
    """A watch over three stubs and a clock that the test turns."""

    def __init__(self) -> None:
        self.plant, self.fsw, self.recorder = Stub("plant"), Stub("fsw"), Stub("recorder")
        self.watch = Watch(cast("Any", [self.plant, self.fsw]), cast("Any", [self.recorder]))
        self.now_s = 100.0
        self.finished = False

    def look(self, after_s: float = 0.1) -> bool:
        self.now_s += after_s
        return self.watch.look(self.now_s, self.finished, [p.code for p in (self.plant, self.fsw, self.recorder)])

    def named(self, **errors: str) -> list[str]:
        return [cast("Process", failure.process).name for failure in self.watch.list_failures(errors)]


def test_a_run_that_ends_well_names_nobody() -> None:
    """The plant ends after its last tick, then the flight software, then the recorder."""
    bench = Bench()
    assert not bench.look()
    bench.finished = True
    for process in (bench.plant, bench.fsw, bench.recorder):
        assert not bench.look()
        process.code = 0
    assert bench.look()
    assert bench.named() == []


def test_the_killed_is_named_before_those_who_felt_it() -> None:
    """The plant's words come first in time; the flight software that was killed comes first in the telling."""
    bench = Bench()
    bench.plant.code = 3
    assert not bench.look()
    bench.fsw.code = -9
    assert not bench.look()
    assert bench.look(GRACE_S)  # the recorder is still running, and is neither waited for nor named
    assert bench.named(plant="PeerLostError") == ["fsw", "plant"]


def test_the_one_with_the_error_is_named_before_the_one_who_lost_it() -> None:
    """Both ended with 3; what each says of its error tells who felt the other's."""
    bench = Bench()
    bench.plant.code = bench.fsw.code = 3
    bench.look()
    assert bench.named(plant="PeerLostError", fsw="StepSizeError") == ["fsw", "plant"]
    assert bench.named(plant="DeadlineError", fsw="BusLostError") == ["plant", "fsw"]


def test_a_recorder_that_fails_is_named_before_the_sides() -> None:
    """It has no error to tell of; those of the sides are of its pipe."""
    bench = Bench()
    bench.plant.code = bench.fsw.code = bench.recorder.code = 3
    bench.look()
    assert bench.named(plant="RecordError", fsw="RecordError") == ["recorder", "plant", "fsw"]


def test_an_end_before_the_last_tick_is_a_failure_even_with_code_0() -> None:
    """Either side or the recorder that leaves early is named when nobody has a better reason, and only then."""
    for victim in ("plant", "fsw", "recorder"):
        bench = Bench()
        getattr(bench, victim).code = 0
        assert not bench.look()
        assert bench.look(GRACE_S)
        assert bench.named() == [victim]
    bench.plant.code = 3
    bench.look()
    assert bench.named(plant="DeadlineError") == ["plant"]


def test_a_stopped_process_is_lost_after_a_second_and_not_before() -> None:
    """A stop that ends in time is forgiven; one that lasts ends the run without further waiting."""
    bench = Bench()
    bench.fsw.stopped = True
    assert not bench.look()
    assert not bench.look(STOPPED_S / 2)
    bench.fsw.stopped = False
    assert not bench.look()
    bench.fsw.stopped = True
    assert not bench.look()
    assert not bench.look(STOPPED_S * 0.9)
    assert bench.look(STOPPED_S * 0.2)
    assert bench.named() == ["fsw"]


def test_who_does_not_end_after_the_run_is_named_for_it() -> None:
    """A side has SIDE_PATIENCE_S from the last tick, the recorder RECORDER_PATIENCE_S from the end of both sides."""
    bench = Bench()
    bench.finished, bench.plant.code = True, 0
    assert not bench.look()
    assert not bench.look(SIDE_PATIENCE_S * 0.9)
    assert bench.look(SIDE_PATIENCE_S * 0.2)
    assert bench.named() == ["fsw"]
    bench = Bench()
    bench.finished, bench.plant.code, bench.fsw.code = True, 0, 0
    assert not bench.look()
    assert not bench.look(RECORDER_PATIENCE_S * 0.9)
    bench.look(RECORDER_PATIENCE_S * 0.2)
    assert bench.look(GRACE_S)
    assert bench.named() == ["recorder"]
