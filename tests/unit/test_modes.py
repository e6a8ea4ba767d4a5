"""The mode manager: every way into and out of every mode."""

from __future__ import annotations

import pytest

from bus.units import DEG
from fsw.modes import MODE_VERBS, Mode, ModeManager
from fsw.settings import ModesConfig

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
def test_losing_what_a_mode_needs_is_safe_mode(
    attitude: bool, rate: bool, request_safe: bool, reason: str, start: tuple[float, float, float]
) -> None:
    """From point and from detumble, each loss leads to safe and the reason is kept; detumble needs no attitude."""
    modes = ModeManager(ModesConfig(), TICK_S)
    modes.step(True, True, start, False)
    mode = modes.step(attitude, rate, start, request_safe)
    if start is SPINNING and not attitude:
        assert mode is Mode.DETUMBLE
    else:
        assert mode is Mode.SAFE
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


@pytest.mark.parametrize(
    ("initial", "damping"), [("point", Mode.DETUMBLE), ("detumble", Mode.DETUMBLE), ("safe", Mode.SAFE)]
)
def test_a_good_rate_alone_leads_to_damping_at_once_when_it_is_high(initial: str, damping: Mode) -> None:
    """A star tracker that is blind at speed must not keep the satellite from being slowed down."""
    modes = ModeManager(ModesConfig(initial=initial), TICK_S)  # type: ignore[arg-type]
    assert modes.step(False, False, SPINNING, False) is Mode.STANDBY
    assert modes.waits_for == "a rate from the gyro"
    assert modes.step(False, True, SPINNING, False) is damping
    assert modes.reason == "rate good, no attitude yet"


@pytest.mark.parametrize(
    ("initial", "damping"), [("point", Mode.DETUMBLE), ("detumble", Mode.DETUMBLE), ("safe", Mode.SAFE)]
)
def test_a_good_rate_alone_leads_to_damping_after_a_while_when_it_is_low(initial: str, damping: Mode) -> None:
    """Without an attitude for star_stale_after_s in a row; a bad rate in between starts the wait again."""
    modes = ModeManager(ModesConfig(initial=initial, star_stale_after_s=1.0), TICK_S)  # type: ignore[arg-type]
    for _ in range(9):
        assert modes.step(False, True, STILL, False) is Mode.STANDBY
        assert modes.waits_for == "an attitude from the star tracker"
    modes.step(False, False, STILL, False)
    for _ in range(9):
        assert modes.step(False, True, STILL, False) is Mode.STANDBY
    assert modes.step(False, True, STILL, False) is damping
    assert modes.waits_for == ""


def test_standby_to_stay_in_is_not_left_for_damping() -> None:
    """`initial: standby` asks for no torque, whatever the rate, and waits for nothing."""
    modes = ModeManager(ModesConfig(initial="standby"), TICK_S)
    for _ in range(100):
        assert modes.step(False, True, SPINNING, False) is Mode.STANDBY
        assert modes.waits_for == ""


def test_every_wait_is_named() -> None:
    """Detumble waits for the rate, then for an attitude; safe for the rate, the attitude, the request, and the count."""
    modes = ModeManager(ModesConfig(recover_after_ticks=3), TICK_S)
    modes.step(False, True, SPINNING, False)
    modes.step(False, True, SPINNING, False)
    assert (modes.mode, modes.waits_for) == (Mode.DETUMBLE, "the rate to fall")
    modes.step(False, True, SLOW, False)
    assert (modes.mode, modes.waits_for) == (Mode.DETUMBLE, "an attitude from the star tracker")
    modes.step(False, False, SLOW, False)
    assert (modes.mode, modes.waits_for) == (Mode.SAFE, "")
    waits = [(False, False, False), (False, True, False), (True, True, True), (True, True, False)]
    said = []
    for attitude, rate, request_safe in waits:
        modes.step(attitude, rate, SLOW, request_safe)
        said.append(modes.waits_for)
    assert said == [
        "a rate from the gyro",
        "an attitude from the star tracker",
        "the request for safe mode to end",
        "the sensors to stay good",
    ]
    modes.step(True, True, SLOW, False)
    modes.step(True, True, SLOW, False)
    assert (modes.mode, modes.waits_for) == (Mode.STANDBY, "")


def test_pointing_goes_on_with_the_axes_that_are_left() -> None:
    """Point becomes degraded, with the reason, while the wheels do not reach three axes, and point again when they do."""
    modes = ModeManager(ModesConfig(), TICK_S)
    modes.step(True, True, STILL, False)
    assert modes.step(True, True, STILL, False, "wheels 1 and 2 are out") is Mode.DEGRADED
    assert modes.reason == "wheels 1 and 2 are out"
    assert modes.step(True, True, STILL, False, "wheels 1 and 2 are out") is Mode.DEGRADED
    assert modes.changes == 2
    assert modes.step(True, True, STILL, False) is Mode.POINT


def test_degraded_is_left_as_pointing_is() -> None:
    """A high rate leads to detumble, the loss of attitude or rate or a request to safe; damping is not called degraded."""
    for attitude, rate, request, left in (
        (False, True, False, Mode.SAFE),
        (True, False, False, Mode.SAFE),
        (True, True, True, Mode.SAFE),
    ):
        modes = ModeManager(ModesConfig(), TICK_S)
        modes.step(True, True, STILL, False)
        modes.step(True, True, STILL, False, "out")
        assert modes.step(attitude, rate, STILL, request, "out") is left
        assert modes.step(True, True, STILL, False, "out") is left
    modes = ModeManager(ModesConfig(), TICK_S)
    modes.step(True, True, STILL, False)
    modes.step(True, True, STILL, False, "out")
    assert modes.step(True, True, SPINNING, False, "out") is Mode.DETUMBLE
    assert modes.step(True, True, SPINNING, False, "out") is Mode.DETUMBLE


# -- commands ----------------------------------------------------------------------------------------------------------


def test_standby_and_safe_are_entered_at_once_and_kept() -> None:
    """From pointing: no waiting for anything, and no way back but a command."""
    for mode in (Mode.STANDBY, Mode.SAFE):
        modes = ModeManager(ModesConfig(recover_after_ticks=1), TICK_S)
        modes.step(True, True, STILL, False)
        modes.command(mode)
        assert (modes.mode, modes.reason, modes.intended) == (mode, "commanded", mode)
        for _ in range(50):
            assert modes.step(True, True, SPINNING, False) is mode
        changes = modes.changes
        modes.command(mode)
        assert modes.changes == changes


def test_point_is_entered_by_the_rules_out_of_whatever_mode() -> None:
    """From a commanded standby at once, from a commanded safe after the count, from a kept detumble when the rate is low."""
    modes = ModeManager(ModesConfig(recover_after_ticks=3), TICK_S)
    modes.step(True, True, STILL, False)
    modes.command(Mode.STANDBY)
    modes.step(True, True, STILL, False)
    modes.command(Mode.POINT)
    assert modes.step(True, True, STILL, False) is Mode.POINT
    modes.command(Mode.SAFE)
    modes.step(False, True, STILL, False)
    modes.command(Mode.POINT)
    assert [modes.step(True, True, STILL, False) for _ in range(4)] == [
        Mode.SAFE, Mode.SAFE, Mode.STANDBY, Mode.POINT,
    ]  # fmt: skip
    modes.command(Mode.DETUMBLE)
    assert (modes.mode, modes.reason) == (Mode.DETUMBLE, "commanded")
    assert [modes.step(True, True, STILL, False) for _ in range(3)] == [Mode.DETUMBLE] * 3
    modes.command(Mode.POINT)
    assert modes.step(True, True, SPINNING, False) is Mode.DETUMBLE
    assert modes.step(True, True, SLOW, False) is Mode.POINT


def test_a_commanded_detumble_takes_the_way_over_standby_out_of_safe() -> None:
    """Safe is left when the sensors have been good for a while, for the mode that was asked for."""
    modes = ModeManager(ModesConfig(recover_after_ticks=2), TICK_S)
    modes.command(Mode.SAFE)
    modes.command(Mode.DETUMBLE)
    assert [modes.step(True, True, STILL, False) for _ in range(3)] == [Mode.SAFE, Mode.STANDBY, Mode.DETUMBLE]


def test_safe_is_stronger_than_a_command_and_reset_forgets_it() -> None:
    """A commanded standby gives way to a request for safe mode, and is taken up again; boot is by the settings."""
    modes = ModeManager(ModesConfig(recover_after_ticks=2), TICK_S)
    modes.step(True, True, STILL, False)
    modes.command(Mode.STANDBY)
    assert modes.step(True, True, STILL, True) is Mode.SAFE
    assert [modes.step(True, True, STILL, False) for _ in range(4)] == [
        Mode.SAFE, Mode.STANDBY, Mode.STANDBY, Mode.STANDBY,
    ]  # fmt: skip
    modes.reset()
    assert modes.intended is Mode.POINT
    assert modes.step(True, True, STILL, False) is Mode.POINT


def test_degraded_cannot_be_commanded_and_is_left_by_detumble() -> None:
    """It has no verb; a commanded detumble leaves it."""
    assert {verb: mode.name.lower() for verb, mode in MODE_VERBS.items()} == {
        "mode.standby": "standby", "mode.detumble": "detumble", "mode.point": "point", "mode.safe": "safe",
    }  # fmt: skip
    modes = ModeManager(ModesConfig(), TICK_S)
    modes.step(True, True, STILL, False)
    assert modes.step(True, True, STILL, False, "two axes") is Mode.DEGRADED
    modes.command(Mode.POINT)
    assert modes.mode is Mode.DEGRADED
    modes.command(Mode.DETUMBLE)
    assert modes.mode is Mode.DETUMBLE


def test_the_two_rates_can_be_changed() -> None:
    """Detumble above 3 deg/s instead of 5, and back below 1 instead of 2."""
    modes = ModeManager(ModesConfig(), TICK_S)
    assert (modes.detumble_above_rad_s, modes.point_below_rad_s) == pytest.approx((5.0 * DEG, 2.0 * DEG))
    modes.detumble_above_rad_s, modes.point_below_rad_s = 3.0 * DEG, 1.0 * DEG
    assert (modes.detumble_above_rad_s, modes.point_below_rad_s) == pytest.approx((3.0 * DEG, 1.0 * DEG))
    modes.step(True, True, STILL, False)
    assert modes.step(True, True, (3.1 * DEG, 0.0, 0.0), False) is Mode.DETUMBLE
    assert modes.step(True, True, SLOW, False) is Mode.DETUMBLE
    assert modes.step(True, True, (0.9 * DEG, 0.0, 0.0), False) is Mode.POINT
