"""The mode manager: every way into and out of every mode."""

from __future__ import annotations

import pytest

from bus.units import DEG
from fsw.modes import Mode, ModeManager, ModesConfig

TICK_S = 0.1
STILL = (0.0, 0.0, 0.0)
SPINNING = (6.0 * DEG, 0.0, 0.0)
SLOW = (1.9 * DEG, 0.0, 0.0)


def test_boot_goes_to_point_once_the_sensors_are_good() -> None:
    """Standby is left on the first cycle with good sensors, not before."""
    modes = ModeManager(ModesConfig(), TICK_S)
    assert modes.step(False, True, STILL, False) is Mode.STANDBY
    assert modes.step(True, False, STILL, False) is Mode.STANDBY
    assert modes.step(True, True, STILL, False) is Mode.POINT
    assert modes.changes == 1
    assert modes.reason == "sensors good"


def test_high_rate_is_damped_before_pointing_with_hysteresis() -> None:
    """Above 5 deg/s detumble; back to point only below 2 deg/s."""
    modes = ModeManager(ModesConfig(), TICK_S)
    assert modes.step(True, True, SPINNING, False) is Mode.DETUMBLE
    assert modes.step(True, True, (3.0 * DEG, 0.0, 0.0), False) is Mode.DETUMBLE
    assert modes.step(True, True, SLOW, False) is Mode.POINT
    assert modes.step(True, True, (3.0 * DEG, 0.0, 0.0), False) is Mode.POINT
    assert modes.step(True, True, SPINNING, False) is Mode.DETUMBLE


@pytest.mark.parametrize(
    ("attitude", "rate", "request_safe", "reason"),
    [
        (False, True, False, "attitude stale"),
        (True, False, False, "rate stale"),
        (True, True, True, "safe mode requested"),
    ],
)
@pytest.mark.parametrize("start", [STILL, SPINNING])
def test_losing_what_pointing_needs_is_safe_mode(
    attitude: bool, rate: bool, request_safe: bool, reason: str, start: tuple[float, float, float]
) -> None:
    """From point and from detumble, each loss leads to safe, and the reason is kept."""
    modes = ModeManager(ModesConfig(), TICK_S)
    modes.step(True, True, start, False)
    assert modes.step(attitude, rate, start, request_safe) is Mode.SAFE
    assert modes.reason == reason


def test_safe_is_left_only_after_the_sensors_were_good_for_a_while() -> None:
    """recover_after_ticks good ticks in a row; one bad one starts the count again."""
    modes = ModeManager(ModesConfig(recover_after_ticks=3), TICK_S)
    modes.step(True, True, STILL, False)
    modes.step(False, True, STILL, False)
    modes.step(True, True, STILL, False)
    modes.step(True, True, STILL, False)
    assert modes.step(False, True, STILL, False) is Mode.SAFE
    for _ in range(2):
        assert modes.step(True, True, STILL, False) is Mode.SAFE
    assert modes.step(True, True, STILL, False) is Mode.STANDBY
    assert modes.step(True, True, STILL, False) is Mode.POINT


@pytest.mark.parametrize(
    ("initial", "mode"), [("standby", Mode.STANDBY), ("detumble", Mode.DETUMBLE), ("safe", Mode.SAFE)]
)
def test_the_initial_mode_is_kept(initial: str, mode: Mode) -> None:
    """A run that is to stay in one mode stays there while the sensors are good and the rate is low."""
    modes = ModeManager(ModesConfig(initial=initial, recover_after_ticks=1), TICK_S)  # type: ignore[arg-type]
    for _ in range(5):
        state = modes.step(True, True, STILL, False)
    assert state is mode


def test_safe_request_in_standby() -> None:
    """Even before the sensors are good, a request for safe mode is obeyed."""
    modes = ModeManager(ModesConfig(), TICK_S)
    assert modes.step(False, False, STILL, True) is Mode.SAFE
    modes.reset()
    assert modes.mode is Mode.STANDBY
