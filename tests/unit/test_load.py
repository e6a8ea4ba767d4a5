"""Worst-case bus load against numbers worked out by hand, and the refusal of what a real bus could not carry."""

from __future__ import annotations

import pytest

from bus.errors import BusLoadError
from bus.icd.load import bus_load, check_load, fitting_tick_rate_hz, required_bits_per_s, worst_case_bits


@pytest.mark.parametrize(
    ("data_bytes", "extended", "bits"),
    [
        (0, False, 55),  # 34 + 13 + 33 // 4
        (1, False, 65),
        (3, False, 85),
        (8, False, 135),  # the published figure for an 11-bit id
        (0, True, 80),
        (8, True, 160),  # the published figure for a 29-bit id
    ],
)
def test_worst_case_frame_lengths(data_bytes: int, extended: bool, bits: int) -> None:
    """Davis et al. 2007 state 55 + 10 s bits for 11-bit and 80 + 10 s bits for 29-bit ids."""
    assert worst_case_bits(data_bytes, extended=extended) == bits
    assert bits == (80 if extended else 55) + 10 * data_bytes


@pytest.mark.parametrize("data_bytes", [-1, 9])
def test_frame_length_outside_classic_can(data_bytes: int) -> None:
    """More than 8 bytes is not classic CAN."""
    with pytest.raises(ValueError, match=r"0\.\.8"):
        worst_case_bits(data_bytes)


def test_published_mix_of_short_and_long_frames() -> None:
    """An earlier draft of the schedule, summed frame by frame, gives the 36.5 % of 500 kbit/s worked out for it.

    Per tick: a SYNC of one byte, 12 frames of 8 bytes, two star-tracker halves every other tick; 5 heartbeats a second.
    """
    per_tick = worst_case_bits(1) + 12 * worst_case_bits(8) + 2 * worst_case_bits(8) / 2
    load = {
        (rate, hz): 100 * (hz * per_tick + 5 * worst_case_bits(8)) / rate
        for rate in (125_000, 250_000, 500_000, 1_000_000)
        for hz in (10, 50, 100)
    }
    assert {key: round(percent, 1) for key, percent in load.items() if key[1] == 100} == {
        (125_000, 100): 146.1, (250_000, 100): 73.1, (500_000, 100): 36.5, (1_000_000, 100): 18.3,
    }  # fmt: skip
    assert round(load[125_000, 10], 1) == 15.1
    assert round(load[250_000, 50], 1) == 36.7


def test_load_of_the_schedule_in_closed_form() -> None:
    """13 frames a tick, 2 a star measurement, 3 a second, 135 bits each: 178605 bit/s at 100 Hz and 10 Hz."""
    assert required_bits_per_s(100, 10) == 135 * (13 * 100 + 2 * 10 + 3) == 178_605
    assert bus_load(100, 10, 500_000) == pytest.approx(0.35721, abs=1e-12)
    assert required_bits_per_s(50, 0) == 135 * (13 * 50 + 3)  # no star tracker


def test_load_with_slow_telemetry_in_closed_form() -> None:
    """Each wheel with a motor adds 2 frames a second, all of them a request a tick; one that follows a setpoint, 1."""
    assert required_bits_per_s(100, 10, motor_wheels=4) == 135 * (14 * 100 + 2 * 10 + 3 + 8)
    assert required_bits_per_s(100, 10, motor_wheels=1) == 135 * (14 * 100 + 2 * 10 + 3 + 2)
    assert required_bits_per_s(100, 10, 4, setpoint_wheels=4) == 135 * (18 * 100 + 2 * 10 + 3 + 8)


def test_slow_telemetry_counts_in_the_refusal() -> None:
    """At 108 Hz on 250 kbit/s ideal wheels fit (77.0 %), wheels that report do not (83.4 %); 103 Hz is offered and fits."""
    assert check_load(108, 10, 250_000) == pytest.approx(0.7706, abs=1e-4)
    with pytest.raises(BusLoadError, match=r"slow telemetry of 4 wheels.* at most 103 Hz"):
        check_load(108, 10, 250_000, 4)
    check_load(103, 10, 250_000, 4)


@pytest.mark.parametrize(("tick_hz", "bit_rate"), [(50, 125_000), (100, 250_000), (100, 500_000), (200, 1_000_000)])
def test_schedules_that_fit_return_their_load(tick_hz: int, bit_rate: int) -> None:
    """What fits is let through with the figure that reports print."""
    assert check_load(tick_hz, 10, bit_rate) == bus_load(tick_hz, 10, bit_rate) <= 0.8


def test_refusal_names_figure_and_what_fits() -> None:
    """100 Hz on 125 kbit/s needs 142.9 %; 55 Hz (79.6 %) or 250 kbit/s (71.4 %) would do."""
    with pytest.raises(BusLoadError) as refusal:
        check_load(100, 10, 125_000)
    message = str(refusal.value)
    for part in ("100 Hz", "10 Hz", "178605 bit/s", "142.9 %", "125000 bit/s", "80 %", "at most 55 Hz", "250000 bit/s"):
        assert part in message
    assert refusal.value.exit_code == 2


def test_limit_is_exactly_eighty_percent() -> None:
    """Just at 80 % is let through, one bit per second less is not."""
    needed = required_bits_per_s(100, 10)
    assert check_load(100, 10, needed / 0.8) == pytest.approx(0.8)
    with pytest.raises(BusLoadError):
        check_load(100, 10, needed / 0.8 - 2)


@pytest.mark.parametrize(("star_hz", "bit_rate"), [(0, 125_000), (10, 125_000), (50, 250_000), (10, 1_000_000)])
def test_fitting_tick_rate_is_the_highest_that_fits(star_hz: int, bit_rate: int) -> None:
    """The rate that a refusal offers must pass, and one more must not."""
    fitting = fitting_tick_rate_hz(star_hz, bit_rate)
    check_load(fitting, star_hz, bit_rate)
    with pytest.raises(BusLoadError):
        check_load(fitting + 1, star_hz, bit_rate)


def test_refusal_where_only_a_slower_tick_fits() -> None:
    """1 kHz fits on no classic CAN bus: only the tick rate is offered."""
    with pytest.raises(BusLoadError, match=r"what fits: a tick rate of at most 454 Hz$"):
        check_load(1000, 10, 1_000_000)


def test_refusal_where_nothing_fits() -> None:
    """A star tracker that alone fills the bus: the message says so and offers no rate."""
    assert fitting_tick_rate_hz(6000, 1_000_000) == 0
    with pytest.raises(BusLoadError, match="nothing on classic CAN"):
        check_load(1000, 6000, 1_000_000)


def test_refusal_without_star_tracker_does_not_mention_it() -> None:
    """A scenario without a star tracker reads no advice about one."""
    with pytest.raises(BusLoadError) as refusal:
        check_load(100, 0, 125_000)
    assert "star" not in str(refusal.value)
