"""The practical detector flown on the bench: separation, recovery, healing, dead axes, blind trackers, kinds.

Flight software and plant talk through CAN frames here as everywhere. Flights are minutes of 20 Hz, so the longer ones are
marked slow.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from fsw.gyro_fdi import REGISTRY
from fsw.gyro_fdi.classification import FaultKind
from fsw.gyro_fdi.settings import PracticalDetectorConfig, Wang2010DetectorConfig
from fsw.records import Sensors, WheelReading
from fsw.settings import ModelConfig
from fsw.vehicle import Vehicle
from plant_server.faults import Fault, make_fault
from tools.config.scenario import Resolved
from tools.design import fdi_campaign
from tools.design.fdi_campaign import Watch, vary
from tools.design.fdi_flight import (
    INERTIA_KGM2,
    WHEEL_FAULTS,
    FlightSettings,
    Moment,
    fly,
    make_scenario,
    with_detector,
)  # fmt: skip
from tools.run.bench import Bench

ONSET_S = 60.0
BASE = FlightSettings(seed=1, duration_s=100.0)
ALARM = 2
slow = pytest.mark.slow


def drift(unit: str, rate_rad_s: float, **more: Any) -> Fault:
    return make_fault(unit=unit, kind="constant", at_s=ONSET_S, rate_rad_s=rate_rad_s, **more)


def record(settings: FlightSettings) -> tuple[list[Moment], Bench]:
    """Every moment of a flight, its sensors copied, and the bench at its end."""
    moments: list[Moment] = []

    def keep(moment: Moment) -> None:
        wheels = tuple(WheelReading(**wheel.values()) for wheel in moment.sensors.wheels)
        moments.append(moment._replace(sensors=Sensors(**moment.sensors.values() | {"wheels": wheels})))

    bench = fly(settings, keep)
    return moments, bench


@pytest.mark.parametrize("seed", [4, 5])
def test_wheel_faults_raise_no_gyro_alarm_even_while_the_tracker_is_blind(seed: int) -> None:
    """These two flights turn faster than the star tracker can follow while a stuck wheel misleads the observer: its
    residual is past what 10 deg of misalignment explains, and only what was learnt before keeps it from accusing.
    """
    watch = Watch(math.inf, ())
    fly(vary(BASE, seed=seed, published_start=True, faults=WHEEL_FAULTS, duration_s=60.0), watch)
    assert min(watch.alarm_s) == math.inf
    for wheel, onset_s in enumerate((30.0, 10.0, 20.0, 30.0)):
        assert 0.0 <= watch.wheel_alarm_s[wheel] - onset_s <= 15.0


def test_gyro_faults_raise_no_wheel_alarm() -> None:
    """The other way round: a drift of 0.05 rad/s is the gyro's, named by axis, and no wheel is accused."""
    for axis, unit in enumerate(fdi_campaign.AXES):
        watch = Watch(ONSET_S, (axis,))
        fly(vary(BASE, seed=axis, faults=(drift(unit, 0.05),)), watch)
        assert 0.0 <= watch.delays_s[0] <= 0.35
        assert watch.wrong_axes == 0
        assert min(watch.wheel_alarm_s) == math.inf


@pytest.mark.parametrize(
    ("amplitude", "limit_s"),
    [
        (0.01, 2.0),
        pytest.param(0.1, 0.35, marks=slow),
        pytest.param(0.001, 8.0, marks=slow),
        pytest.param(0.0005, 30.0, marks=slow),
    ],
)
def test_delays_on_three_axes(amplitude: float, limit_s: float) -> None:
    """Drift on all axes with wheel faults: found in time, none missed, none before onset."""
    found = fdi_campaign.measure_delays(BASE, 3, amplitude, True, limit_s + 5.0)
    assert found["missed"] == found["wrong_axis"] == 0
    assert found["delay_max_s"] <= limit_s
    assert found["estimate_rmse_rad_s"] <= 2e-4


@slow
def test_recovery_keeps_the_satellite_and_its_absence_loses_it() -> None:
    """0.1 rad/s on three axes: torque error <= 0.05 N m and pointing unmoved with recovery, a tumble without."""
    kept, lost = (fdi_campaign.measure_coupling(BASE, 0.1, recovery) for recovery in ("on", "off"))
    assert kept["torque_error_peak_nm"] <= 0.05
    assert kept["pointing_max_deg"] <= 1.0
    assert kept["rate_max_deg_s"] <= 0.3
    assert lost["pointing_max_deg"] > 90.0
    assert lost["torque_error_peak_nm"] > 5.0


def test_a_healed_axis_is_used_again() -> None:
    """A drift of 20 s: alarm at once, released about 30 s after it ends, the gyro's rate in use again and right."""
    moments, _ = record(vary(BASE, duration_s=150.0, faults=(drift("gyro.y", 0.02, until_s=80.0),)))
    states = np.array([m.detection.gyro_state[1] for m in moments])
    assert states[round(61.0 / 0.05)] >= ALARM
    released = 0.05 * (np.flatnonzero(states >= ALARM)[-1] + 1)
    assert 110.0 <= released <= 125.0
    last = moments[-1]
    b = last.detection.estimate.bias_b_rad_s[1]
    assert last.detection.estimate.omega_bi_b_rad_s[1] == last.sensors.omega_meas_b_rad_s[1] - b
    errors = [m.detection.estimate.omega_bi_b_rad_s[1] - m.truth.omega_bi_b_rad_s[1] for m in moments[-400:]]
    assert np.sqrt(np.mean(np.square(errors))) < 2e-4


@pytest.mark.parametrize("rate_hz", [20, pytest.param(100, marks=slow)])
def test_a_dead_axis_is_replaced_at_once(rate_hz: int) -> None:
    """No frames from one axis: replaced as soon as the inputs say so, attitude and rate stay right and valid."""
    dead = make_fault(unit="gyro.z", kind="dead", at_s=ONSET_S)
    moments, bench = record(vary(BASE, rate_hz=rate_hz, faults=(dead,), star_latency_s=0.1, manoeuvre_every_s=40.0))
    lost = next(m.tick for m in moments if not m.sensors.gyro_valid[2])
    replaced = next(m.tick for m in moments if m.detection.gyro_state[2] >= ALARM)
    assert 0 <= replaced - lost < rate_hz / 20 + 1
    after = moments[replaced:]
    assert all(m.detection.estimate.valid and not m.detection.request_safe for m in after)
    errors = [m.detection.estimate.omega_bi_b_rad_s[2] - m.truth.omega_bi_b_rad_s[2] for m in after]
    assert np.sqrt(np.mean(np.square(errors))) < 5e-4
    assert bench.read("fsw.detector.fault_kind")[2] == FaultKind.DEAD
    assert bench.read("fsw.detector.alarm_t_s")[:2] == (-1.0, -1.0)


def test_star_tracker_and_gyro_both_lost_asks_for_safe_mode() -> None:
    """Drift first, then no stars: the gyro-less rate coasts on the wheels for 30 s, then safe mode is asked for."""
    blind = make_fault(unit="star_tracker", kind="dropout", at_s=70.0)
    moments, _ = record(vary(BASE, duration_s=115.0, faults=(drift("gyro.x", 0.01), blind), manoeuvre_every_s=0.0))
    asked = next(m.t_s for m in moments if m.detection.request_safe)
    assert asked == pytest.approx(100.0, abs=1.0)
    before = [m for m in moments if 62.0 < m.t_s < 100.0]
    assert max(abs(m.detection.estimate.omega_bi_b_rad_s[0] - m.truth.omega_bi_b_rad_s[0]) for m in before) < 3e-3
    assert all(m.detection.rate_good for m in moments)


def test_without_stars_the_observer_finds_the_drift() -> None:
    """Blind from 40 s on, a drift of 0.01 rad/s at 60 s is found by bounds and torque observer, on its axis only."""
    blind = make_fault(unit="star_tracker", kind="dropout", at_s=40.0)
    for axis, unit in enumerate(fdi_campaign.AXES):
        watch = Watch(ONSET_S, (axis,))
        settings = vary(
            BASE, duration_s=70.0, faults=(blind, drift(unit, 0.01)), tilt_max_deg=3.0, manoeuvre_every_s=0.0
        )
        fly(settings, watch)
        assert 0.0 <= watch.delays_s[0] <= 2.0
        assert watch.wrong_axes == 0


@pytest.mark.parametrize(
    ("rate_hz", "star_hz", "latency_s"),
    [
        (10, 5, 0.1),
        pytest.param(50, 5, 0.0, marks=slow),
        pytest.param(100, 4, 0.06, marks=slow),
    ],
)
def test_other_rates_and_late_frames(rate_hz: int, star_hz: int, latency_s: float) -> None:
    """10 to 100 Hz, late star-tracker frames between detection cycles: quiet before, found after, right axis."""
    faults = (*WHEEL_FAULTS, drift("gyro.z", -0.02))
    watch = Watch(ONSET_S, (2,))
    fly(vary(BASE, rate_hz=rate_hz, star_rate_hz=star_hz, star_latency_s=latency_s, faults=faults), watch)
    assert 0.0 <= watch.delays_s[0] <= 0.6 + latency_s
    assert watch.wrong_axes == 0
    assert np.sqrt(np.mean(np.square(watch.estimate_errors))) < 2e-4


@slow
def test_kind_within_the_spec_of_a_strong_sinusoid() -> None:
    """0.05 sin 0.5 t: periodic, frequency within 0.2 %, amplitude within 0.5 %, three seeds out of three."""
    settings = vary(BASE, duration_s=0.0)
    found = fdi_campaign.judge_kind(settings, 3, 0.05, 0.5)
    assert found["right"] == 3
    assert found["frequency_error_rms"] < 0.002
    assert found["size_error_rms"] < 0.005


def test_campaign_repeats(capsys: pytest.CaptureFixture[str]) -> None:
    """The same command gives the same figures, to the last digit."""
    command = ["delays", "--runs", "1", "--amplitude", "0.02", "--wait", "2"]
    texts = []
    for _ in range(2):
        fdi_campaign.main(command)
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1]
    assert json.loads(texts[0])[0]["missed"] == 0


@slow
@pytest.mark.parametrize("fog", ["tactical", "space"])
def test_no_false_alarm_in_a_quarter_of_an_hour(fog: str) -> None:
    """Healthy gyro, with and without wheel faults, manoeuvring: nothing is found, nothing is suspect."""
    settings = with_detector(vary(BASE, fog=fog), fog=fog)
    found = fdi_campaign.count_false_alarms(settings, 2, 0.125)
    assert found["gyro_alarms"] == found["suspect_ticks"] == 0


@slow
@pytest.mark.parametrize("fog", ["tactical", "space"])
def test_no_false_alarm_in_five_hours(fog: str) -> None:
    """Five seeds of one hour each without a single alarm."""
    settings = with_detector(vary(BASE, fog=fog), fog=fog)
    assert fdi_campaign.count_false_alarms(settings, 5, 1.0)["gyro_alarms"] == 0


def test_recovery_off_changes_nothing_in_flight() -> None:
    """With recovery off the estimator's estimate goes through untouched while the finding is the same."""
    settings = with_detector(vary(BASE, duration_s=62.0, faults=(drift("gyro.x", 0.005),)), recovery="off")
    moments, _ = record(settings)
    last = moments[-1].detection
    assert last.gyro_state[0] >= ALARM
    y, b = moments[-1].sensors.omega_meas_b_rad_s, last.estimate.bias_b_rad_s
    assert last.estimate.omega_bi_b_rad_s == (y[0] - b[0], y[1] - b[1], y[2] - b[2])
    assert all(m.detection.rate_step_b_rad_s == (0.0, 0.0, 0.0) for m in moments)


def test_reset_repeats_bit_for_bit() -> None:
    """Nothing survives a reset, in either detector."""
    moments, _ = record(vary(BASE, duration_s=64.0, faults=(drift("gyro.x", 0.01),)))
    vehicle = Vehicle(ModelConfig(inertia_kgm2=INERTIA_KGM2))
    for config in (PracticalDetectorConfig(kind="practical"), Wang2010DetectorConfig(kind="wang2010")):
        detector = REGISTRY.make(config, vehicle, 0.05)
        passes = []
        for _ in range(2):
            detector.reset()
            passes.append([detector.step(m.sensors, m.detection.estimate, (0.0,) * 4) for m in moments])
        assert passes[0] == passes[1]
        assert any(max(d.gyro_state) >= ALARM for d in passes[0])


def test_what_is_healthy_is_a_setting() -> None:
    """A drift below `bias_max_rad_s` is no fault; the same drift is one with the class's own bound."""
    for bound, expected in ((1e-2, False), (None, True)):
        settings = with_detector(vary(BASE, faults=(drift("gyro.x", 1e-3),)), bias_max_rad_s=bound)
        bench = fly(settings, lambda moment: None)
        assert (bench.read("fsw.detector.alarm_t_s")[0] >= 0.0) == expected


@slow
@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "noise", "factor": 3.0},
        {"kind": "noise", "factor": 10.0},
        {"kind": "spikes", "rate_rad_s": 0.01, "probability": 0.01},
        {"kind": "spikes", "rate_rad_s": 0.001, "probability": 0.3},
        {"kind": "intermittent", "probability": 0.3},
    ],
)
def test_noise_spikes_and_drop_outs_are_not_constant(fault: dict[str, Any]) -> None:
    """An axis that lies without a mean, if it is accused at all, is never said to be off by a constant."""
    shaky = make_fault(unit="gyro.x", at_s=62.0, **fault)
    bench = Bench(Resolved.of(make_scenario(vary(BASE, duration_s=130.0, faults=(*WHEEL_FAULTS, shaky)))))
    kinds: set[float] = set()
    while bench.tick < bench.ticks:
        kinds.add(bench.step().read("fsw.detector.fault_kind")[0])
    assert kinds <= {FaultKind.NONE, FaultKind.OTHER, FaultKind.DEAD}
    assert FaultKind.OTHER in kinds
