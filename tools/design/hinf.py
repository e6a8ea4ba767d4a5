"""Central H-infinity controllers from two Riccati equations, with scipy alone.

Doyle, Glover, Khargonekar & Francis, "State-space solutions to standard H2 and H-infinity control problems", IEEE TAC
34(8), 1989, in the form with D11 = D22 = 0. scipy's solver takes the indefinite weight that the equations need.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_are, solve_continuous_lyapunov

from bus.errors import DesignError

Array = NDArray[np.float64]

NEWTON_STEPS = 8  # two or three are enough; more than this is a solution that does not settle


@dataclass(frozen=True, slots=True)
class GeneralisedPlant:
    """x' = A x + B1 w + B2 v, z = C1 x + D12 v, r = C2 x + D21 w."""

    a: Array
    b1: Array
    b2: Array
    c1: Array
    c2: Array
    d12: Array
    d21: Array


@dataclass(frozen=True, slots=True)
class Controller:
    """x_k' = a x_k + b r, v = c x_k."""

    a: Array
    b: Array
    c: Array


def synthesise(plant: GeneralisedPlant, gamma: float, what: str) -> Controller:
    """Return the central controller that keeps ||T_zw||_inf below gamma.

    Doyle et al. 1989, theorem 3, after normalising v and r so that D12' D12 = I and D21 D21' = I.
    what : name of the design, for messages
    Raises DesignError where gamma cannot be reached: no stabilising solution of a Riccati equation, a solution that is
    not positive semidefinite, or a spectral radius of X Y that is not below gamma^2.
    """
    r_root_inv, s_root_inv = _inverse_root(plant.d12.T @ plant.d12), _inverse_root(plant.d21 @ plant.d21.T)
    b2n, c2n = plant.b2 @ r_root_inv, s_root_inv @ plant.c2
    x = _solve(plant.a, plant.b1, b2n, plant.c1, gamma, f"{what}: state equation")
    y = _solve(plant.a.T, plant.c1.T, c2n.T, plant.b1.T, gamma, f"{what}: output equation")
    coupling = float(np.max(np.abs(np.linalg.eigvals(x @ y))))
    if not coupling < gamma**2:
        raise DesignError(
            f"{what}: gamma = {gamma:.6g} cannot be reached: spectral radius of X Y is {coupling:.4g}, it must be"
            f" below gamma^2 = {gamma**2:.4g}; use a larger gamma"
        )
    f, lf = -b2n.T @ x, -y @ c2n.T
    z = np.linalg.inv(np.eye(len(x)) - y @ x / gamma**2)
    a_k = plant.a + plant.b1 @ plant.b1.T @ x / gamma**2 + b2n @ f + z @ lf @ c2n
    controller = Controller(a_k, -z @ lf @ s_root_inv, r_root_inv @ f)
    require_stable(close_loop(plant, controller)[0], what)
    return controller


def close_loop(plant: GeneralisedPlant, controller: Controller) -> tuple[Array, Array, Array]:
    """Return (A, B, C) of the closed loop from w to z; its direct term is zero."""
    a = np.block([
        [plant.a, plant.b2 @ controller.c],
        [controller.b @ plant.c2, controller.a],
    ])  # fmt: skip
    return a, np.vstack([plant.b1, controller.b @ plant.d21]), np.hstack([plant.c1, plant.d12 @ controller.c])


def require_stable(a: Array, what: str) -> None:
    """Raise DesignError unless every eigenvalue of `a` has a negative real part [rad/s]."""
    worst = float(np.max(np.linalg.eigvals(a).real))
    if not worst < 0.0:
        raise DesignError(f"{what}: the closed loop is not stable, largest real part {worst:.3g} rad/s")


def compute_norm(a: Array, b: Array, c: Array, tolerance: float = 1e-4) -> float:
    """Return ||C (sI - A)^-1 B||_inf by bisection on the Hamiltonian (Boyd, Balakrishnan & Kabamba 1989).

    A level is above the norm exactly when the Hamiltonian of that level has no eigenvalue on the imaginary axis.
    """
    low = float(np.linalg.norm(c @ np.linalg.solve(a, b), 2))
    for w in np.abs(np.linalg.eigvals(a)):
        low = max(low, float(np.linalg.norm(c @ np.linalg.solve(1j * w * np.eye(len(a)) - a, b), 2)))
    high = 2.0 * low
    while _crosses(a, b, c, high):
        low, high = high, 2.0 * high
    while high - low > tolerance * high:
        middle = 0.5 * (low + high)
        if _crosses(a, b, c, middle):
            low = middle
        else:
            high = middle
    return high


def discretise(a: Array, b: Array, tick_s: float) -> tuple[Array, Array]:
    """Return (Phi, Gamma) of x' = a x + b u for u held over tick_s [s]: exact, by the matrix exponential."""
    n, m = len(a), b.shape[1]
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a * tick_s, b * tick_s
    block = expm(block)
    return block[:n, :n], block[:n, n:]


def _solve(a: Array, b1: Array, b2: Array, c: Array, gamma: float, what: str) -> Array:
    weight = np.diag(np.r_[-(gamma**2) * np.ones(b1.shape[1]), np.ones(b2.shape[1])])
    try:
        x = solve_continuous_are(a, np.hstack([b1, b2]), c.T @ c, weight)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DesignError(
            f"{what}: gamma = {gamma:.6g} cannot be reached: no stabilising solution ({error}); use a larger gamma"
        ) from error
    x = _refine(0.5 * (x + x.T), a, b2 @ b2.T - b1 @ b1.T / gamma**2, c.T @ c)
    smallest, largest = (float(v) for v in np.linalg.eigvalsh(x)[[0, -1]])
    if smallest < -1e-9 * max(largest, 1.0):
        raise DesignError(
            f"{what}: gamma = {gamma:.6g} cannot be reached: the solution has eigenvalue {smallest:.3g}, none may be"
            " negative; use a larger gamma"
        )
    return np.asarray(x)


def _refine(x: Array, a: Array, s: Array, q: Array) -> Array:
    """Return the solution of a' x + x a - x s x + q = 0 near x, by Newton's method (Kleinman 1968).

    scipy's own is right to 1e-4 for the weights of the gyro banks, which span seven decades, and those four digits
    depend on the processor's BLAS. The correction solves a Lyapunov equation, and its error shrinks with it.
    """
    size = float("inf")
    for _ in range(NEWTON_STEPS):
        residual = a.T @ x + x @ a - x @ s @ x + q
        closed = a - s @ x
        step = solve_continuous_lyapunov(closed.T, -0.5 * (residual + residual.T))
        before, size = size, float(np.linalg.norm(step))
        if not size < before:  # down to rounding
            break
        x = x + 0.5 * (step + step.T)
    return x


def _inverse_root(square: Array) -> Array:
    values, vectors = np.linalg.eigh(square)
    return np.asarray(vectors @ np.diag(values**-0.5) @ vectors.T)


def _crosses(a: Array, b: Array, c: Array, level: float) -> bool:
    hamiltonian = np.block([[a, b @ b.T / level], [-c.T @ c / level, -a.T]])
    values = np.linalg.eigvals(hamiltonian)
    return bool(np.any(np.abs(values.real) <= 1e-9 * np.maximum(np.abs(values), 1e-9)))
