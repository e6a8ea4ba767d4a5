"""A wheel that was dead and comes back, in flight: locked out for good without a probe, used again with one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from fsw.modes import Mode
from fsw.wheel_health.share_kalman import ShareKalmanInternals
from tools.run.bench import Bench

PUBLISHED = ["expect=[]"]  # the four faults of Zhang, Ye & Sun 2018
Z = 2  # wheel 3: holds 15 mN m from 20 s on, healthy from 40 s on; wheel 4 is dead from 30 s on


class Flown(NamedTuple):
    """A flight, once a second: the second, error [deg], wheel 3's share and mode."""

    error_deg: np.ndarray
    share_z: np.ndarray
    mode: np.ndarray


def fly(scenario: str, changes: list[str], until_s: int) -> Flown:
    with Bench.open(scenario, [*PUBLISHED, *changes]) as bench:
        second = round(1.0 / bench.tick_s)
        rows = []
        for _ in range(until_s):
            bench.step(second)
            inside = bench.flight.wheel_health.internals
            assert isinstance(inside, ShareKalmanInternals)
            rows.append((bench.truth.error_deg, inside.share[Z], float(bench.flight.modes.mode)))
        error, share, mode = np.array(rows).T
        return Flown(error, share, mode)


@pytest.mark.parametrize("law", ["smc", "braking_profile"])
def test_without_a_probe_a_recovered_wheel_is_locked_out_and_the_satellite_lost(law: str) -> None:
    """Published faults, 160 s. Wheel 3 obeys again from 40 s on. Not probed, it is told nothing and shows nothing: its share
    stays 0, two axes are all that is left, and the body drifts off beyond 40 deg and on. Probed, its share is at least 0.9
    ten seconds after the recovery, three axes are back, and the target is reached. The modes know of the lost axis under
    smc; braking_profile keeps wheel 4 at its limit, where a constant command hides a dead wheel: share 0.14 and a bias."""
    controller = f"fsw.controller={{kind: {law}}}"
    without = fly("zhang2018", [controller, "fsw.wheel_health={kind: share_kalman, probe_nm: 0}"], 160)
    probed = fly("zhang2018", [controller, "fsw.wheel_health={kind: share_kalman}"], 160)
    for flown in (without, probed):
        assert flown.share_z[18] > 0.99  # at 19 s
        assert flown.share_z[38] < 0.01  # at 39 s
        assert (flown.mode[38] == Mode.DEGRADED) is np.bool_(law == "smc")
    assert (without.share_z[39:] < 0.01).all()
    assert (without.mode[39:] == (Mode.DEGRADED if law == "smc" else Mode.POINT)).all()
    assert without.error_deg[-1] > 40.0
    assert (np.diff(without.error_deg[99:]) > 0.0).all()
    assert probed.share_z[49] >= 0.9  # at 50 s
    assert (probed.share_z[49:] >= 0.9).all()
    assert (probed.mode[49:] == Mode.POINT).all()
    assert probed.error_deg[-1] < 0.02


@pytest.mark.slow
def test_the_probe_finds_the_recovered_wheel_through_gyro_star_tracker_and_latency() -> None:
    """The published faults as a real satellite would meet them, commands 10 ms late: share of wheel 3 at least 0.9 at 50 s,
    within 1 deg before 90 s and 0.02 deg at 200 s."""
    monitor = "fsw.wheel_health={kind: share_kalman, command_latency_s: 0.01}"
    flown = fly("zhang2018-flight", ["fsw.controller={kind: braking_profile}", monitor], 200)
    assert flown.share_z[38] < 0.01
    assert (flown.share_z[49:] >= 0.9).all()
    assert (flown.error_deg[89:] < 1.0).all()
    assert (flown.error_deg[199:] < 0.02).all()


def test_a_wheel_that_is_never_rated_dead_is_not_locked_out() -> None:
    """dead_below 0, the other cure: the allocator's floor of 0.15 keeps a wheel of no share at work; its recovery shows."""
    flown = fly("zhang2018", ["fsw.wheel_health={kind: share_kalman, dead_below: 0}"], 160)
    assert (flown.mode[2:] == Mode.POINT).all()
    assert flown.share_z[38] < 0.01
    assert (flown.share_z[49:] >= 0.9).all()
    assert flown.error_deg[-1] < 0.1
