"""Three axes sampled together give exactly what they give one by one.

The oracle is the general way: the same gyro, made to look at its faults before every sample.
"""

from __future__ import annotations

from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st

from plant_server.config import FaultConfig, GyroConfig
from plant_server.faults import FaultTimeline
from plant_server.gyro import Gyro

TICK_S = 0.01
small = st.floats(-1e-2, 1e-2)
threes = st.tuples(small, small, small)

configs = st.builds(
    GyroConfig,
    preset=st.sampled_from(["ideal", "space", "tactical"]),
    bias_rad_s=st.just((0.0, 0.0, 0.0)) | threes,
    scale_factor=st.none() | threes,
    misalignment_deg=st.just((0.0, 0.0, 0.0)) | threes,
    bandwidth_hz=st.sampled_from([None, None, 20.0]),
    angle_lsb_rad=st.sampled_from([None, 0.0, 1e-5]),
    range_rad_s=st.just(1.0),
)


@st.composite
def faults(draw: Any) -> FaultConfig:
    at_s = TICK_S * draw(st.integers(0, 40))
    until_s = draw(st.none() | st.integers(1, 20).map(lambda ticks: at_s + TICK_S * ticks))
    kind, magnitudes = draw(
        st.sampled_from(
            [("constant", {"rate_rad_s": 0.1}), ("stuck", {}), ("dead", {}), ("noise", {"factor": 3.0}),
             ("scale", {"factor": 0.2})]
        )
    )  # fmt: skip
    unit = draw(st.sampled_from(["gyro.x", "gyro.y", "gyro.z", "gyro"]))
    return FaultConfig(unit=unit, kind=kind, at_s=at_s, until_s=until_s, **magnitudes)


def make_gyro(config: GyroConfig, given_faults: list[FaultConfig]) -> Gyro:
    timeline = FaultTimeline(tuple(given_faults), step_s=TICK_S, steps_per_tick=1, seed=1)
    return Gyro(config, timeline, TICK_S, 1)


@settings(max_examples=150, deadline=None)
@given(configs, st.lists(faults(), max_size=3), st.lists(st.floats(-1.1, 1.1), min_size=60, max_size=60))
@example(  # what an ideal gyro that gets stuck holds is the sample before
    GyroConfig(preset="ideal", range_rad_s=1.0),
    [FaultConfig(unit="gyro.x", kind="stuck", at_s=2 * TICK_S)],
    [0.0, 0.5, 0.25, 0.125],
)
def test_both_ways_give_the_same(config: GyroConfig, given_faults: list[FaultConfig], rates: list[float]) -> None:
    """Rates, statuses, silence and truth, bit for bit, through onsets and ends of faults and rates out of range."""
    usual, each = make_gyro(config, given_faults), make_gyro(config, given_faults)
    for step, rate in enumerate(rates):
        each.look_again()
        truth = (rate, -0.5 * rate, 0.25)
        assert usual.sample(truth, step, TICK_S * step) == each.sample(truth, step, TICK_S * step)
        assert (usual.status, usual.silent, usual.truth_rad_s) == (each.status, each.silent, each.truth_rad_s)


def test_the_quick_way_is_taken() -> None:
    """It would be no use otherwise: after one sample without faults the axes are left alone."""
    gyro = make_gyro(GyroConfig(preset="tactical"), [])
    gyro.sample((0.1, 0.2, 0.3), 0, 0.0)
    for axis in gyro.axes:
        axis.bias_rad_s = 7.0  # an axis that is sampled by itself sets it
    gyro.sample((0.1, 0.2, 0.3), 1, TICK_S)
    assert [axis.bias_rad_s for axis in gyro.axes] == [7.0, 7.0, 7.0]
