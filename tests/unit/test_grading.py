"""The grader on logs made for the test, whose right grades are known beforehand in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.telemetry.link import Field, TickPacker, Topic, announce_topics
from tools.config.expect import Above, Below, Equals, RmsBelow, RmsEquals, Settles, Within
from tools.grading.expressions import evaluate
from tools.grading.judge import judge
from tools.log.mcap_reader import Run, read_run
from tools.log.recorder import Recorder

TICK_NS = 100_000_000


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """100 s at 10 Hz: decay = 10 exp(-t/10), wave = sin(t), pair = (3, 4) t; and /slow/step at 1 Hz, 0 then 1 from 50 s."""
    path = tmp_path_factory.mktemp("grading") / "run.mcap"
    fast = TickPacker(
        [
            Topic(
                "/fast/all",
                "hilsat/Fast",
                (Field("decay", "float64"), Field("wave", "float64"), Field("pair", "float64", 2)),
            )
        ],
        1,
    )
    slow = TickPacker([Topic("/slow/step", "hilsat/Slow", (Field("level", "float64"), Field("hole", "float64")))], 2)
    recorder = Recorder(path, metadata={}, sources=(1,))
    link = recorder.link(1)
    link.announce(announce_topics([fast, slow]))
    for k in range(1001):
        t = k / 10
        records = fast.pack(k, k * TICK_NS, 10 * math.exp(-t / 10), math.sin(t), 3 * t, 4 * t)
        if k % 10 == 0:
            records += slow.pack(k, k * TICK_NS, float(t >= 50), math.nan if k == 500 else 0.0)
        link.write_tick(k, k * TICK_NS, records)
    link.close("done")
    recorder.close()
    return read_run(path)


def settles(bound: float, **limits: float) -> Settles:
    return Settles(check="settles", name="s", signal="fast.all.decay", bound=bound, **limits)


def test_settling_time_is_the_last_sample_above_the_bound(log: Run) -> None:
    """10 exp(-t/10) > 1 until t = 10 ln 10 = 23.03 s: the last such sample is at 23.0 s."""
    verdict = judge(log, settles(1.0, by_s=25.0))
    assert verdict.passed
    assert verdict.value == pytest.approx(23.0)
    assert verdict.margin == pytest.approx(2.0)
    assert not judge(log, settles(1.0, by_s=22.9)).passed
    assert not judge(log, settles(1.0, not_before_s=23.1)).passed
    assert judge(log, settles(1.0, at_s=24.0, tolerance_s=1.0)).passed
    assert not judge(log, settles(1.0, at_s=24.2, tolerance_s=1.0)).passed
    assert judge(log, settles(20.0, by_s=1.0)).value == 0.0


def test_what_never_settles_fails(log: Run) -> None:
    """The last sample of the window is above the bound."""
    verdict = judge(log, settles(1.0, by_s=25.0, until_s=20.0))
    assert not verdict.passed
    assert verdict.value is None


def test_bounds_over_a_window_give_the_worst_sample(log: Run) -> None:
    """sin over a whole period reaches 1 (at 10 Hz: to within 1e-3)."""
    for item in (
        Below(check="below", name="b", signal="fast.all.wave", bound=1.1),
        Above(check="above", name="a", signal="fast.all.wave", bound=-1.1),
        Within(check="within", name="w", signal="fast.all.wave", lower=-1.1, upper=1.1),
        Equals(check="equals", name="e", signal="fast.all.wave", value=0.0, tolerance=1.1),
    ):
        verdict = judge(log, item)
        assert verdict.passed
        assert verdict.margin == pytest.approx(0.1, abs=1e-3)
    assert not judge(log, Below(check="below", name="b", signal="fast.all.wave", bound=0.99)).passed
    assert judge(log, Below(check="below", name="b", signal="fast.all.wave", bound=0.7, until_s=0.7)).passed


def test_holds(log: Run) -> None:
    """wave > 0 on (0, pi): from some time at the latest, for a length of time."""
    positive = {"check": "above", "name": "h", "signal": "fast.all.wave", "bound": 0.5}
    held = math.pi - 2 * math.asin(0.5)  # 2.09 s each period
    assert judge(log, Above(**positive, for_s=2.0)).passed
    verdict = judge(log, Above(**positive, for_s=2.0))
    assert verdict.value == pytest.approx(held, abs=0.2)
    assert not judge(log, Above(**positive, for_s=3.0)).passed
    by = judge(log, Above(**positive, by_s=1.0, for_s=2.0))
    assert by.value == pytest.approx(0.6, abs=0.11)
    assert not judge(log, Above(**positive, by_s=0.3, for_s=2.0)).passed
    level = Equals(check="equals", name="l", signal="slow.step.level", value=1.0, by_s=50.0)
    assert judge(log, level).margin == pytest.approx(0.0)


def test_rms(log: Run) -> None:
    """The rms of a sine over whole periods is 1/sqrt(2)."""
    window = {"name": "r", "signal": "fast.all.wave", "until_s": 30 * math.pi}
    assert judge(log, RmsBelow(check="rms_below", bound=0.72, **window)).value == pytest.approx(2**-0.5, abs=2e-3)
    assert not judge(log, RmsBelow(check="rms_below", bound=0.7, **window)).passed
    assert judge(log, RmsEquals(check="rms_equals", value=0.707, tolerance=0.01, **window)).passed
    assert not judge(log, RmsEquals(check="rms_equals", value=0.8, tolerance=0.01, **window)).passed


@pytest.mark.parametrize(
    "signal",
    [
        "slow.step.hole",
        "slow.step.hole ** 0",
        "(slow.step.hole * 0 / 0) ** 0",
        "1 ** slow.step.hole",
        "1 / (1 / (slow.step.level - 1))",
        "1 / ((1 + slow.step.level) * 1e200) ** 2",
        "rate(slow.step.hole) ** 0",
        "min(fast.all.pair * (slow.step.hole ** 0)) ** 0",
    ],
)
def test_a_number_that_is_none_is_not_executed_however_it_is_hidden(log: Run, signal: str) -> None:
    """NaN at 50 s, division by zero, overflow: floating point would make 1 or 0 of each of these."""
    verdict = judge(log, Below(check="below", name="n", signal=signal, bound=9.0))
    assert verdict.outcome == "not executed"
    assert "not a number at t = " in verdict.detail


def test_one_sample_neither_settles_nor_holds(log: Run) -> None:
    """Nothing stays anywhere in a single sample; two can."""
    for until_s, outcome in ((0.05, "not executed"), (0.15, "pass")):
        assert judge(log, settles(20.0, by_s=1.0, until_s=until_s)).outcome == outcome
        held = Below(check="below", name="h", signal="fast.all.decay", bound=20.0, by_s=0.0, until_s=until_s)
        assert judge(log, held).outcome == outcome


def test_a_margin_beyond_numbers_is_null_in_json(log: Run) -> None:
    """1.5e308 from -1.5e308 is further than a float goes: the verdict stands, the figure is left out."""
    item = Below(check="below", name="m", signal="fast.all.wave * 0 - 1.5e308", bound=1.5e308)
    verdict = judge(log, item)
    assert verdict.passed
    assert verdict.as_dict()["margin"] is None
    rms = judge(log, RmsBelow(check="rms_below", name="r", signal="fast.all.decay * 1e200", bound=1.0))
    assert (rms.outcome, rms.as_dict()["value"]) == ("fail", None)


def test_an_empty_window_and_a_missing_signal_are_not_executed(log: Run) -> None:
    """Neither is a pass by default; the near miss is named."""
    assert "no sample" in judge(log, Below(check="below", name="n", signal="fast.all.wave", bound=1, from_s=200)).detail
    verdict = judge(log, Below(check="below", name="n", signal="fast.all.wav", bound=1))
    assert verdict.outcome == "not executed"
    assert "did you mean wave?" in verdict.detail


def test_expressions(log: Run) -> None:
    """Against numpy: norms, indices, arithmetic, rates, and topics of different rates."""
    t = np.arange(1001) / 10
    assert np.allclose(evaluate(log, "norm(fast.all.pair)").values, 5 * t)
    assert np.allclose(evaluate(log, "sum(fast.all.pair) / 7 + fast.all.pair[0] ** 2").values, t + 9 * t**2)
    assert np.allclose(evaluate(log, "max(fast.all.pair) - min(fast.all.pair)").values, t)
    assert np.allclose(evaluate(log, "rate(fast.all.pair[1])").values[1:], 4)
    assert np.allclose(evaluate(log, "abs(-deg(fast.all.wave))").values, np.abs(np.degrees(np.sin(t))))
    assert np.allclose(
        evaluate(log, "rad(sqrt(fast.all.decay * 4))").values, np.radians(2 * np.sqrt(10 * np.exp(-t / 10)))
    )
    mixed = evaluate(log, "fast.all.pair[0] - slow.step.level")
    assert mixed.t_s is not None
    assert mixed.t_s.size == 101
    assert np.allclose(mixed.values, 3 * mixed.t_s - (mixed.t_s >= 50))
    assert np.allclose(evaluate(log, "norm(fast.all.pair * fast.all.wave)").values, 5 * t * np.abs(np.sin(t)))


@pytest.mark.parametrize(
    ("expression", "word"),
    [
        ("fast.all.pair", "vector of 2"),
        ("norm(fast.all.wave)", "needs a vector"),
        ("fast.all.wave[0]", "not a vector"),
        ("fast.all.pair[2]", "out of bounds"),
        ("fats.all.wave", "did you mean fast.all"),
        ("norm(2)", "needs a vector"),
        ("fast.all.wave + " * 5000 + "1", "nested too deeply|not an expression"),
        ("-" * 5000 + "fast.all.wave", "nested too deeply|not an expression"),
        ("fast.all.wave * 1" + "0" * 400, "too large|too large to convert"),
        ("fast.all.wave * 1j", "is not a number"),
        ("fast.all.wave % 2", "only"),
        ("exp(fast.all.wave)", "function exp is not known"),
        ("fast.all.pair[99999999999999999999]", "fast.all.pair"),
        ("fast.all.wave +", "not an expression"),
    ],
)
def test_wrong_expressions_say_why(log: Run, expression: str, word: str) -> None:
    """Each names what is wrong."""
    with pytest.raises(ConfigError, match=word):
        evaluate(log, expression)
