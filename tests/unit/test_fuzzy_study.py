"""The study of fuzzy against plain PID: its plant against recorded flights, its draws, its judgement."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.design.fuzzy_plant import ROTOR_KGM2, Draw, FuzzyPlant
from tools.design.fuzzy_study import INERTIA_KGM2, ROWS, draw_run, fly, main

RECORD = np.load(Path(__file__).resolve().parents[1] / "data" / "wheel" / "closed_loop_excerpt.npz")
S003 = Draw(
    theta_rad=(0.03490658503988659, 0.026179938779914945, 0.017453292519943295),
    omega_rad_s=(0.0, 0.0, 0.0),
    speeds_rad_s=(0.0, 0.0, 0.0),
    gain=(0.6, 0.5, 0.7),
    onset_s=0.0,
    ramp_s=0.0,
    inertia_kgm2=INERTIA_KGM2,
    disturbance_nm=1e-5,
)


@pytest.mark.parametrize(
    ("row", "case"),
    [("paper PID", "A_pid"), ("paper fuzzy", "A_fuzzy"), ("tuned PID", "B_pid")],
)
def test_study_flies_as_the_record(row: str, case: str) -> None:
    """S003 without noise for 100 s: an independent integration's angles within 5e-6 rad, for all its steps of 0.1 s."""
    thetas = np.array(fly(row, S003, noise_seed=0, keep=True, noisy=False, until_s=100.0).thetas)[::10]
    assert np.abs(thetas - RECORD[f"{case}_fault1_dist1/theta_1s"][:100]).max() <= 5e-6


def test_plant_keeps_its_momentum() -> None:
    """No disturbance: the momentum of body and rotors, seen from outside, keeps its length to 1e-7 while the wheels work."""
    plant = FuzzyPlant(replace(draw_run(1, 3), disturbance_nm=0.0, onset_s=2.0))

    def find_momentum() -> float:
        omega, speeds = plant.omega, plant.find_speeds()
        body = np.array(plant._draw.inertia_kgm2) * omega
        return float(np.linalg.norm(body + ROTOR_KGM2 * (np.array(speeds) + omega)))

    before = find_momentum()
    for k in range(600):
        plant.advance(0.1, 0.1 * k, (3.0 if k < 200 else -2.0, -1.0, 0.5))
    assert find_momentum() == pytest.approx(before, rel=1e-7)


def test_draws_depend_on_seed_and_number_alone() -> None:
    """Equal for equal numbers, others for others, within what the study says of them."""
    assert draw_run(1, 5) == draw_run(1, 5)
    assert len({draw_run(seed, run).theta_rad for seed in (1, 2) for run in range(50)}) == 100
    for run in range(200):
        draw = draw_run(1, run)
        assert max(map(abs, draw.theta_rad)) <= 0.04
        assert 0.3 <= min(draw.gain) <= max(draw.gain) <= 1.0
        assert 50.0 <= draw.onset_s <= 150.0
        assert 1e-6 <= draw.disturbance_nm <= 5e-5


def test_filters_take_the_fault_out_of_the_pointing() -> None:
    """One drawn fault: after it the angle stays at a third of what it is without the wheel filters, or less."""
    without, with_it = (fly(row, draw_run(1, 1), 7, until_s=150.0) for row in ("tuned PID", "tuned + drag + filter"))
    assert with_it.post_fault_mrad < without.post_fault_mrad / 3.0


def test_study_prints_the_same_twice(capsys: pytest.CaptureFixture[str]) -> None:
    """One JSON object with the rows asked for; the same digits for the same seed."""
    printed = []
    for _ in range(2):
        main(["--runs", "2", "--rows", "tuned PID", "tuned + drag + filter", "--json"])
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]
    assert list(json.loads(printed[0])["rows"]) == ["tuned PID", "tuned + drag + filter"]
    assert len(ROWS) == 9
