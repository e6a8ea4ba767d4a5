"""Rigid body and momentum exchange against closed forms, conservation laws, scipy and published trajectories."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from plant_server.config import BodyConfig, ConstantTorque, GyroConfig, PlantConfig, WheelConfig
from plant_server.dynamics import RigidBody
from plant_server.faults import make_fault
from plant_server.plant import Plant

DATA = Path(__file__).parent.parent / "data"
J = ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0))
ZERO = (0.0, 0.0, 0.0)
IDENTITY = (1.0, 0.0, 0.0, 0.0)
MOUNTS = ("x", "y", "z", "skew")
MISALIGNED = ((10.0, 12.0), (8.0, 15.0), (5.0, 8.0), (6.0, 10.0))


def make_wheels(**settings):
    return tuple(
        WheelConfig(mount=mount, tilt_deg=tilt, clock_deg=clock, **settings)
        for mount, (tilt, clock) in zip(MOUNTS, MISALIGNED, strict=True)
    )


def read_truth(plant):
    """Truth as arrays by field name."""
    return {name: np.array(value) for name, value in plant.truth()._asdict().items()}


def tumble(inertia, omega, dt_s, steps):
    """Attitude, rate and angle history of a torque-free rigid body without wheels."""
    body, angle = RigidBody(inertia, IDENTITY, omega, ZERO, dt_s), np.zeros(3)
    history = [(IDENTITY, omega, angle.copy())]
    for _ in range(steps):
        body.advance(ZERO, ZERO, ZERO)
        angle += body.turn_b_rad
        history.append((body.q_ib, body.omega_bi_b_rad_s, angle.copy()))
    return history


def test_axisymmetric_body_precesses_as_the_closed_form_says():
    """Torque-free axisymmetric body: w turns about the symmetry axis at (1 - C/A) w3, exactly, and so does attitude.

    Attitude of the closed form: a turn of H/A about H, then a turn of (1 - C/A) w3 about the symmetry axis.
    """
    a, c = 30.0, 50.0
    inertia = ((a, 0.0, 0.0), (0.0, a, 0.0), (0.0, 0.0, c))
    w1, w3, dt = 0.05, 0.12, 0.01
    history = tumble(inertia, (w1, 0.0, w3), dt, 20000)
    momentum_i = np.array([a * w1, 0.0, c * w3])
    body_rate = (1.0 - c / a) * w3  # of the body relative to the precessing frame, about its own z
    for k in range(0, 20001, 1000):
        q, omega, _ = history[k]
        t = k * dt
        expected = (w1 * math.cos(body_rate * t), -w1 * math.sin(body_rate * t), w3)
        np.testing.assert_allclose(omega, expected, atol=1e-11)
        attitude = Rotation.from_rotvec(momentum_i / a * t) * Rotation.from_rotvec([0.0, 0.0, body_rate * t])
        ours = Rotation.from_quat([q[1], q[2], q[3], q[0]])
        assert (ours.inv() * attitude).magnitude() < 1e-9


def test_energy_and_momentum_of_a_tumbling_body_are_kept():
    """A general body tumbling at 6 deg/s for 300 s keeps energy and inertial momentum to 1e-10, norm to 1e-12."""
    history = tumble(J, (0.05, 0.08, -0.04), 0.01, 30000)
    matrix = np.array(J)

    def measure(sample):
        q, omega, _ = sample
        attitude = Rotation.from_quat([q[1], q[2], q[3], q[0]])
        return np.array(omega) @ matrix @ omega, attitude.apply(matrix @ omega), math.hypot(*q)

    energy_0, momentum_0, _ = measure(history[0])
    for sample in history[::3000]:
        energy, momentum, norm = measure(sample)
        assert energy == pytest.approx(energy_0, rel=1e-10)
        np.testing.assert_allclose(momentum, momentum_0, atol=1e-10 * np.linalg.norm(momentum_0))
        assert norm == pytest.approx(1.0, abs=1e-12)


def test_the_step_is_of_fourth_order():
    """Halving the step divides the error by 16, for attitude, rate and integrated angle alike."""
    omega = (0.5, 0.8, -0.4)
    exact = tumble(J, omega, 0.005, 2000)[-1]

    def err(dt_s, steps):
        return [np.abs(np.subtract(a, b)).max() for a, b in zip(tumble(J, omega, dt_s, steps)[-1], exact, strict=True)]

    for coarse, fine in zip(err(0.2, 50), err(0.1, 100), strict=True):
        assert 3.7 < math.log2(coarse / fine) < 4.8


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_spin_about_a_principal_axis_is_exact_whatever_the_step(axis):
    """Half a turn a step, ten thousand steps: the angle is rate times time to rounding, and the norm is kept by the step."""
    rate, dt, steps = 2.0, 0.5 * math.pi, 10000
    omega = tuple(rate if k == axis else 0.0 for k in range(3))
    q, _, turned = tumble(((30.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 50.0)), omega, dt, steps + 1)[-1]
    half = 0.5 * rate * dt * (steps + 1)
    expected = [math.cos(half), 0.0, 0.0, 0.0]
    expected[1 + axis] = math.sin(half)
    np.testing.assert_allclose(q, expected, atol=1e-11)
    assert turned[axis] == pytest.approx(2.0 * half, rel=1e-12)
    assert math.hypot(*q) == pytest.approx(1.0, abs=1e-11)


def test_attitude_is_closer_to_the_truth_than_runge_kutta_would_be():
    """Tumbling at 1 rad/s, 0.1 s steps, 20 s: 8.3e-8 rad from DOP853, where Runge-Kutta for both is 1.2e-6 rad away."""
    omega, matrix = (0.5, 0.8, -0.4), np.array(J)

    def rates(_, y):
        q, w = y[:4], y[4:]
        q_rate = 0.5 * np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])
        return np.concatenate([q_rate, np.linalg.solve(matrix, -np.cross(w, matrix @ w))])

    start = np.concatenate([IDENTITY, omega])
    exact = solve_ivp(rates, (0.0, 20.0), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:4, -1]
    q = np.array(tumble(J, omega, 0.1, 200)[-1][0])
    assert 2.0 * np.linalg.norm(q - math.copysign(1.0, q @ exact) * exact) < 2e-7


# -- momentum exchange ---------------------------------------------------------------------------------------------


def test_total_momentum_is_conserved_over_300_s_of_wheel_activity():
    """Without external torque, total inertial momentum stays within 1e-9 relative, the norm within 1e-12.

    The momentum is put together here from the logged attitude, rate and rotor momentum, not taken from the integrator.
    """
    body = BodyConfig(inertia_kgm2=J, attitude_q=(0.85, 0.25, -0.3, 0.35), rate_deg_s=(0.51, 0.3, 0.009))
    wheels = make_wheels(speed_rad_s=150.0, viscous_nm_s=1e-4, coulomb_nm=1e-3, torque_lag_s=0.05)
    faults = (make_fault(unit="wheel.2", kind="bias", torque_nm=0.03, at_s=40.0, rise_s=20.0),)
    plant = Plant(PlantConfig(body=body, wheels=wheels), faults, 0.01, 1)
    matrix = np.array(J)

    def measure():
        truth = read_truth(plant)
        q = truth["q_ib"]
        attitude = Rotation.from_quat([q[1], q[2], q[3], q[0]])
        total = attitude.apply(matrix @ truth["omega_bi_b_rad_s"] + truth["h_rw_b_nms"])
        np.testing.assert_allclose(truth["h_total_i_nms"], total, atol=1e-13 * np.linalg.norm(total))
        return total, np.linalg.norm(q)

    start, _ = measure()
    for k in range(30000):
        phase = 0.02 * k
        plant.step((0.08 * math.sin(phase), 0.08 * math.cos(1.3 * phase), -0.05 * math.sin(0.7 * phase), 0.03))
        if k % 1000 == 999:
            total, norm = measure()
            assert np.linalg.norm(total - start) < 1e-9 * np.linalg.norm(start)
            assert norm == pytest.approx(1.0, abs=1e-12)


def oracle(matrix, axes, rotor_inertia, external, t, state, torque):
    """Right-hand side written with relative wheel speeds and the inertia with wheels locked.

    J_l w' + sum a_i I_i s_i' = -w x (J_l w + sum a_i I_i s_i) + d and I_i (s_i' + a_i.w') = -tau_i, solved as one
    linear system of seven unknowns: nothing here knows of absolute spin momentum.
    """
    q, omega, speed = state[:4], state[4:7], state[7:]
    locked = matrix + rotor_inertia * axes @ axes.T
    system = np.zeros((7, 7))
    system[:3, :3] = locked
    system[:3, 3:] = rotor_inertia * axes
    system[3:, :3] = rotor_inertia * axes.T
    system[3:, 3:] = rotor_inertia * np.eye(4)
    total = locked @ omega + rotor_inertia * axes @ speed
    rates = np.linalg.solve(system, np.concatenate([-np.cross(omega, total) + external, -torque]))
    q_rate = 0.5 * np.concatenate([[-q[1:] @ omega], q[0] * omega + np.cross(q[1:], omega)])
    return np.concatenate([q_rate, rates])


def test_gyrostat_equals_an_independent_integration():
    """Large rotors, misaligned axes, stepped torques and an external torque: equal to DOP853 of another formulation."""
    rotor_inertia, external = 0.5, (2e-3, -1e-3, 3e-3)
    body = BodyConfig(inertia_kgm2=J, attitude_q=(0.5, 0.5, -0.5, 0.5), rate_deg_s=(3.0, -2.0, 1.0))
    config = PlantConfig(
        body=body,
        wheels=make_wheels(inertia_kgm2=rotor_inertia, speed_rad_s=20.0, max_torque_nm=1.0),
        torques=(ConstantTorque(kind="constant", torque_nm=external),),
        gyro=GyroConfig(preset="space", arw_rad_sqrt_s=0.0, bias_instability_rad_s=0.0, rrw_rad_s_sqrt_s=0.0,
                        angle_lsb_rad=0.0, scale_factor=ZERO),
    )  # fmt: skip
    plant = Plant(config, (), 0.1, 1)
    r = [math.radians(x) for pair in MISALIGNED for x in pair]
    s = math.asin(1.0 / math.sqrt(3.0)) + r[6]
    z = math.radians(45.0) + r[7]
    sin, cos = math.sin, math.cos
    axes = np.array(
        [
            [cos(r[0]), sin(r[0]) * cos(r[1]), sin(r[0]) * sin(r[1])],
            [sin(r[2]) * cos(r[3]), cos(r[2]), sin(r[2]) * sin(r[3])],
            [sin(r[4]) * cos(r[5]), sin(r[4]) * sin(r[5]), cos(r[4])],
            [cos(s) * cos(z), cos(s) * sin(z), sin(s)],
        ]
    ).T
    state = np.concatenate([[0.5, 0.5, -0.5, 0.5], np.radians([3.0, -2.0, 1.0]), [20.0] * 4])
    random = np.random.default_rng(5)
    plant.sample()
    for _ in range(300):
        torque = random.uniform(-0.8, 0.8, 4)
        solution = solve_ivp(
            lambda t, y, u=torque: np.concatenate(
                [oracle(np.array(J), axes, rotor_inertia, external, t, y[:11], u), y[4:7]]
            ),
            (0.0, 0.1), np.concatenate([state, ZERO]), method="DOP853", rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        state, angle = solution.y[:11, -1], solution.y[11:, -1]
        plant.step(tuple(torque.tolist()))
        # what an integrating gyro reports: the mean of each body rate over the tick
        np.testing.assert_allclose(plant.sample().gyro_rate_rad_s, angle / 0.1, atol=1e-10)
    truth = read_truth(plant)
    np.testing.assert_allclose(truth["q_ib"], state[:4], atol=1e-8)
    np.testing.assert_allclose(truth["omega_bi_b_rad_s"], state[4:7], atol=1e-9)
    np.testing.assert_allclose(truth["speed_rad_s"], state[7:], atol=1e-8)


def test_zero_net_momentum_makes_the_gyroscopic_term_vanish():
    """From rest, 0.15 N m on three axes from 10 s: w = J^-1 (0.15, 0.15, 0.15) (t - 10) exactly (analytic reference).

    Wang, Li & Ma 2010, satellite and torque of the second example, with the wheels' momentum in the plant.
    """
    data = np.load(DATA / "plant_wheel_zero_momentum.npz")
    inertia = tuple(tuple(float(x) for x in row) for row in data["J"])
    wheels = tuple(WheelConfig(mount=mount, max_torque_nm=0.2, inertia_kgm2=0.1) for mount in MOUNTS)
    plant = Plant(PlantConfig(body=BodyConfig(inertia_kgm2=inertia), wheels=wheels), (), 0.1, 1)
    push = float(data["u"])
    worst = 0.0
    for k, omega in enumerate(data["omega"]):
        worst = max(worst, float(np.abs(read_truth(plant)["omega_bi_b_rad_s"] - omega).max()))
        u = push if k >= 100 else 0.0
        plant.step((u, u, u, 0.0))
    assert worst < 1e-9


@pytest.mark.parametrize("name", ["published", "lyapunov"])
def test_published_trajectories(name):
    """Driven with the recorded torques and the paper's faults, the paper's plant follows the reference for 300 s.

    Zhang, Ye & Sun 2018, their scenario. The fault torque is equal to rounding. Rates are to 5e-6 rad/s and the
    attitude to 1e-3, as the reference states: its last Runge-Kutta stage (weight 1/6) sees some of the fault edges
    early, which the open loop carries to the end. Up to the first such edge, at 20 s, the two are equal to 1e-13.
    """
    data = np.load(DATA / f"plant_zhang2018_{name}.npz")
    body = BodyConfig(
        inertia_kgm2=J, attitude_q=(0.85, 0.25, -0.3, 0.35), rate_deg_s=(0.51, 0.3, 0.009), wheel_gyroscopic=False
    )
    faults = (
        make_fault(unit="wheel.1", kind="loss", effectiveness=0.6, at_s=30.0, until_s=100.0),
        make_fault(unit="wheel.1", kind="loss", effectiveness=0.4, at_s=100.0),
        make_fault(unit="wheel.2", kind="loss", effectiveness=0.5, at_s=10.0, until_s=50.0),
        make_fault(unit="wheel.3", kind="stuck_torque", torque_nm=0.015, at_s=20.0, until_s=40.0),
        make_fault(unit="wheel.4", kind="dead", at_s=30.0),
    )
    plant = Plant(PlantConfig(body=body, wheels=make_wheels()), faults, 0.1, 1)
    for k, tau in enumerate(data["tau_c"]):
        before = read_truth(plant)
        plant.step(tuple(tau.tolist()))
        if k % 20 == 0:
            row = k // 20
            early = k < 200
            np.testing.assert_allclose(before["q_ib"], data["q"][row], atol=1e-13 if early else 1e-3)
            np.testing.assert_allclose(before["omega_bi_b_rad_s"], data["omega"][row], atol=1e-13 if early else 5e-6)
            np.testing.assert_allclose(read_truth(plant)["tau_fault_b_nm"], data["u_f"][row], atol=1e-15)


def test_the_papers_plant_is_euler_with_body_torque():
    """wheel_gyroscopic: false integrates J w' = -w x J w + D tau whatever the rotors carry, against DOP853."""
    body = BodyConfig(inertia_kgm2=J, rate_deg_s=(5.0, -4.0, 3.0), wheel_gyroscopic=False)
    plant = Plant(PlantConfig(body=body, wheels=make_wheels(speed_rad_s=300.0)), (), 0.1, 1)
    for _ in range(200):
        plant.step((0.05, -0.02, 0.03, 0.01))
    truth = read_truth(plant)
    matrix = np.array(J)
    torque = truth["tau_fault_b_nm"] + np.array([0.05, -0.02, 0.03]) + 0.01 / math.sqrt(3.0)
    solution = solve_ivp(
        lambda t, w: np.linalg.solve(matrix, torque - np.cross(w, matrix @ w)),
        (0.0, 20.0), np.radians([5.0, -4.0, 3.0]), method="DOP853", rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(truth["omega_bi_b_rad_s"], solution.y[:, -1], atol=1e-9)
    spun_up = 0.01 * 300.0 - 0.05 * 20.0
    assert truth["speed_rad_s"][0] == pytest.approx(spun_up / 0.01, abs=0.2)  # h' = -tau holds here too


def test_two_step_sizes_give_one_truth():
    """A tick of ten steps and one of a hundred agree to 1e-9: substeps and their means are added up rightly."""
    ends = []
    for step_s in (0.01, 0.001):
        body = BodyConfig(inertia_kgm2=J, rate_deg_s=(2.0, 1.0, -1.0))
        plant = Plant(PlantConfig(body=body, wheels=make_wheels(), step_s=step_s), (), 0.1, 1)
        for k in range(100):
            plant.step((0.05 * math.sin(k), 0.02, -0.03, 0.04 * math.cos(k)))
        ends.append(np.concatenate([np.ravel(value) for value in plant.truth()]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_truth_knows_of_no_target():
    """The plant cannot tell a pointing error: its place in the log is left to whoever knows the target."""
    plant = Plant(PlantConfig(body=BodyConfig(inertia_kgm2=J), wheels=make_wheels()), (), 0.1, 0)
    assert math.isnan(plant.truth().error_deg)
