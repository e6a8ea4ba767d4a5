"""H-infinity synthesis against independent designs, closed forms and scipy; and what must be refused."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from bus.errors import DesignError
from bus.linear import invert_symmetric
from fsw.gyro_fdi.gains import exponentiate, load_bank, require_stable_static
from fsw.gyro_fdi.observers import GyroObserver
from fsw.gyro_fdi.ts_model import OPERATING_RATE_RAD_S, VERTEX_SIGNS, make_a, make_f
from tools.design import hinf, ts_design
from tools.design.ts_design import BANKS, INERTIAS, Weighting, compute_t_ef, design_bank, make_plant

DATA = Path(__file__).parents[1] / "data" / "gyro"
J = INERTIAS["wang2010"]


def a_of(rule: int) -> np.ndarray:
    x, y, z = (OPERATING_RATE_RAD_S * s for s in VERTEX_SIGNS[rule])
    return np.array(make_a(J, invert_symmetric(J), (x, y, z)))


def test_designs_match_the_reference() -> None:
    """T_ef of 90 combinations of eps, gamma and vertex is that of independent designs to 1 % (median 2e-7, worst 0.3 %)."""
    data = np.load(DATA / "hinf_designs.npz")
    for row, reference in zip(data["table"], data["svd_Tef"], strict=True):
        eps, ratio, rule = float(row[0]), float(row[1]), int(row[2])
        weighting = Weighting(eps=eps, gamma_ratio=ratio)
        plant = make_plant(a_of(rule), weighting)
        controller = hinf.synthesise(plant, ratio * weighting.gamma_opt, "test")
        for omega, expected in list(zip(data["w"], reference, strict=True))[::8]:
            got = np.linalg.svd(compute_t_ef(a_of(rule), controller, omega), compute_uv=False)
            assert got == pytest.approx(expected, rel=0.01, abs=1e-6)


def test_slow_gain_has_its_closed_form() -> None:
    """At rest |T_ef| between slow pole and roll-off is 1/(1 + eps b sqrt(1 - (gamma_opt/gamma)^2)) within 6 %."""
    for eps in (1.0, 5.0, 100.0):
        for ratio in (1.05, 1.2, 2.0, 20.0):
            weighting = Weighting(eps=eps, gamma_ratio=ratio)
            plant = make_plant(a_of(0), weighting)
            controller = hinf.synthesise(plant, ratio * weighting.gamma_opt, "test")
            t_ef = compute_t_ef(a_of(0), controller, 0.02)
            assert np.linalg.norm(t_ef, 2) == pytest.approx(float(weighting.t_mid), rel=0.06)


def test_achieved_norm_is_below_gamma_and_above_the_bound() -> None:
    """Each rule's closed-loop norm lies between gamma_opt = eps b / c, which no stable loop beats, and gamma."""
    for name in INERTIAS:
        certificate = json.loads((ts_design.GAINS_DIR / f"certificate_{name}.json").read_text())
        for bank in certificate["banks"].values():
            for rule in bank["rules"]:
                assert bank["gamma_opt"] < rule["achieved_norm"] <= rule["gamma"]
                assert rule["slowest_pole_rad_s"] < 0.0
                assert all(margin > 0.0 for margin in rule["one_minus_spectral_radius"].values())


def test_norm_by_bisection_matches_a_frequency_sweep() -> None:
    """The certified norm is the peak over frequency of the largest singular value, found by brute force."""
    a = np.array([[0.0, 1.0], [-4.0, -0.2]])
    b, c = np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    peak = max(abs((c @ np.linalg.solve(1j * w * np.eye(2) - a, b))[0, 0]) for w in np.linspace(1.9, 2.1, 20001))
    assert hinf.compute_norm(a, b, c) == pytest.approx(peak, rel=2e-4)


def test_riccati_solution_is_right_to_seven_digits() -> None:
    """The equation's remainder in exact rational arithmetic, turned into an error of the solution, is below 1e-7.

    scipy's solver alone is wrong by 3e-4 here, and by other digits on another processor.
    """

    def exact(matrix: np.ndarray) -> np.ndarray:
        return np.array([[Fraction(float(value)) for value in row] for row in matrix], dtype=object)

    weighting = BANKS["a"]
    plant, gamma = make_plant(a_of(1), weighting), weighting.gamma_ratio * weighting.gamma_opt
    a, b1, b2, c = plant.a.T, plant.c1.T, plant.c2.T / np.sqrt((plant.d21 @ plant.d21.T)[0, 0]), plant.b1.T
    y = hinf._solve(a, b1, b2, c, gamma, "test")
    s = exact(b2) @ exact(b2).T - exact(b1) @ exact(b1).T / Fraction(gamma) ** 2
    remainder = exact(a).T @ exact(y) + exact(y) @ exact(a) - exact(y) @ s @ exact(y) + exact(c).T @ exact(c)
    error = solve_continuous_lyapunov((a - s.astype(float) @ y).T, -remainder.astype(float))
    assert np.linalg.norm(error) < 1e-7 * np.linalg.norm(y)


def test_committed_gains_are_rederived() -> None:
    """The gains that fly are those the synthesis gives today: a new synthesis agrees in T_ef to 1e-6."""
    assert ts_design.main([]) == 0


def test_a_changed_gains_file_is_noticed() -> None:
    """The comparison can fail: one gain off by 1 % is far outside its tolerance."""
    gains, _ = ts_design.make_documents("wang2010")
    other = json.loads(json.dumps(gains))
    other["banks"]["a"][3]["c"] = (1.01 * np.array(other["banks"]["a"][3]["c"])).tolist()
    assert ts_design.compare_gains(other, gains) > 1e-3


@pytest.mark.parametrize("ratio", [0.5, 0.99])
def test_gamma_below_the_optimum_is_refused(ratio: float) -> None:
    """No controller exists below gamma_opt; the message names design and gamma and says what to do."""
    with pytest.raises(DesignError, match=r"cannot be reached.*use a larger gamma"):
        design_bank(J, Weighting(eps=5.0, gamma_ratio=ratio))


def test_an_unstable_sampled_loop_is_refused() -> None:
    """A static gain held too long oscillates apart (|1 - l T| > 1): refused when made, not found in flight."""
    require_stable_static(0.05, 0.05)
    with pytest.raises(DesignError, match="not stable"):
        GyroObserver("static", J, 0.05, static_gain_rad_s=41.0)
    with pytest.raises(DesignError, match="spectral radius"):
        load_bank(J, "b", 2000.0)


def test_explicit_euler_would_be_unstable_where_the_exact_form_is_not() -> None:
    """Why the banks are sampled exactly: rule 1 of bank A grows at 20 Hz when stepped by explicit Euler."""
    controllers, _ = design_bank(J, BANKS["a"])
    loop = np.block([[a_of(1), -controllers[1].c], [controllers[1].b, controllers[1].a]])
    assert np.max(np.abs(np.linalg.eigvals(np.eye(9) + 0.05 * loop))) > 1.0 + 1e-5
    assert ts_design.sampled_radius(a_of(1), controllers[1], 0.05) < 1.0


def test_no_design_for_this_inertia_is_refused() -> None:
    """Gains belong to an inertia; another one is named, with what to do."""
    with pytest.raises(DesignError, match=r"no H-infinity observer gains.*ts_design --write"):
        load_bank(((10.0, 0.0, 0.0), (0.0, 11.0, 0.0), (0.0, 0.0, 12.0)), "a", 0.05)


def test_exponential_matches_scipy() -> None:
    """The flight side's own matrix exponential agrees with scipy's on the matrices it is used for."""
    controllers, _ = design_bank(J, BANKS["a"])
    for controller in controllers:
        exact = expm(0.05 * controller.a)
        assert np.max(np.abs(exponentiate(0.05 * controller.a) - exact)) < 1e-10 * np.max(np.abs(exact))


def test_static_gain_certificate_holds_throughout_the_cube() -> None:
    """Above the certified gain |J e|^2 decreases at 2000 random rates in the cube, not only at its vertices."""
    rng = np.random.default_rng(5)
    for inertia in INERTIAS.values():
        gain, j, j_inv = ts_design.certify_static(inertia), np.array(inertia), invert_symmetric(inertia)
        assert gain < 0.05
        for w in rng.uniform(-0.15, 0.15, (2000, 3)):
            g = j @ (np.array(make_f(inertia, j_inv, tuple(w))) - gain * np.eye(3)) @ np.array(j_inv)
            assert np.linalg.eigvalsh(g + g.T)[-1] < 1e-9
