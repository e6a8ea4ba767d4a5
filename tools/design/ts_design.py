"""H-infinity banks of the Takagi-Sugeno gyro observers: synthesis, certificate, and the gains file that flies.

    python -m tools.design.ts_design            check the committed gains against a new synthesis
    python -m tools.design.ts_design --write    write them again

Wang, Li & Ma 2010, with the generalised plant made regular as docs/gyro-fdi.md says: the plant as printed has no
H-infinity solution.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus.errors import DesignError
from bus.linear import invert_symmetric
from bus.units import Mat3
from fsw.gyro_fdi.ts_model import OPERATING_RATE_RAD_S, VERTEX_SIGNS, make_a, make_f
from tools.design.hinf import Array, Controller, GeneralisedPlant, close_loop, compute_norm, discretise, synthesise

GAINS_DIR = Path(__file__).resolve().parents[2] / "fsw" / "gyro_fdi"
INERTIAS: dict[str, Mat3] = {
    "wang2010": ((55.3, 0.21, 0.41), (0.21, 51.5, -0.34), (0.41, -0.34, 41.8)),
    "zhang2018": ((45.0, 3.0, 2.0), (3.0, 38.0, -1.5), (2.0, -1.5, 50.0)),
}
RATES_HZ = (10, 20, 50, 100)


@dataclass(frozen=True, slots=True)
class Weighting:
    """What a synthesis may choose. Defaults are those of the committed banks, `eps` excepted."""

    eps: float  # 1/process input: large trusts the model (known premise), small trusts the gyro (unknown premise)
    gamma_ratio: float = 2.0  # gamma over the best reachable one
    b: float = 20.0  # fault weight b/(s + c), Wang et al. 2010
    c: float = 0.001  # [rad/s]
    rho: float = 0.1  # weight of the injection v [s]; roll-off at 1/rho
    filter_pole_rad_s: float = 10.0

    @property
    def gamma_opt(self) -> float:
        """eps b / c: the weighted fault transfer at zero frequency, where no stable observer does better."""
        return self.eps * self.b / self.c

    @property
    def t_mid(self) -> float:
        """|T_ef| between its slow pole and its roll-off, closed form for the operating point at rest."""
        return 1.0 / (1.0 + self.eps * self.b * math.sqrt(1.0 - 1.0 / self.gamma_ratio**2))


BANKS = {"a": Weighting(eps=100.0), "b": Weighting(eps=5.0)}


def make_plant(a_i: Array, weighting: Weighting) -> GeneralisedPlant:
    """Return the regularised plant of one operating point: states [fault weight; e], disturbances [Phi; tau; n]."""
    eye, zero = np.eye(3), np.zeros((3, 3))
    gain = weighting.eps * weighting.b
    return GeneralisedPlant(
        a=np.block([[-weighting.c * eye, zero], [zero, a_i]]),
        b1=np.block([[zero, eye, zero], [eye, zero, zero]]),
        b2=np.vstack([zero, -eye]),
        c1=np.block([[zero, eye], [zero, zero]]),
        c2=np.hstack([gain * eye, eye]),
        d12=np.vstack([zero, weighting.rho * eye]),
        d21=np.hstack([zero, zero, gain / weighting.filter_pole_rad_s * eye]),
    )


def design_bank(inertia_kgm2: Mat3, weighting: Weighting) -> tuple[list[Controller], list[dict[str, Any]]]:
    """Return the nine controllers (6 states each) and one certificate record per rule.

    Raises DesignError where a rule cannot be designed, or its sampled loop is not stable at one of RATES_HZ.
    """
    controllers, records = [], []
    j_inv = invert_symmetric(inertia_kgm2)
    for rule, signs in enumerate(VERTEX_SIGNS):
        x, y, z = (OPERATING_RATE_RAD_S * s for s in signs)
        a_i = np.array(make_a(inertia_kgm2, j_inv, (x, y, z)))
        plant = make_plant(a_i, weighting)
        gamma = weighting.gamma_ratio * weighting.gamma_opt
        controller = synthesise(plant, gamma, f"rule {rule} at {x:g}, {y:g}, {z:g} rad/s, eps = {weighting.eps:g}")
        controllers.append(controller)
        records.append(_certify(rule, a_i, plant, controller, weighting))
    return controllers, records


def compute_t_ef(a_i: Array, controller: Controller, omega_rad_s: float) -> Array:
    """Return T_ef(j omega), shape (3, 3): from gyro fault to estimation error, e' = A_i e - K (e + f)."""
    s = 1j * omega_rad_s
    k = controller.c @ np.linalg.solve(s * np.eye(len(controller.a)) - controller.a, controller.b)
    return np.asarray(np.linalg.solve(s * np.eye(3) - a_i + k, -k))


def certify_static(inertia_kgm2: Mat3) -> float:
    """Return a gain l [rad/s] above which x' = A(xh) xh + J^-1 u + l (y - xh) is stable anywhere in the cube.

    V = |J e|^2 decreases for l above the largest eigenvalue of the symmetric part of J F J^-1 at the vertices; F is
    linear in the rate, so the vertices bound the cube. Sufficient: a common P by LMI reaches lower.
    """
    j, j_inv = np.array(inertia_kgm2), invert_symmetric(inertia_kgm2)
    worst = 0.0
    for signs in VERTEX_SIGNS:
        x, y, z = (OPERATING_RATE_RAD_S * s for s in signs)
        g = j @ np.array(make_f(inertia_kgm2, j_inv, (x, y, z))) @ np.array(j_inv)
        worst = max(worst, float(np.linalg.eigvalsh(0.5 * (g + g.T))[-1]))
    return worst


def sampled_radius(a_i: Array, controller: Controller, tick_s: float) -> float:
    """Return the spectral radius of observer error and controller, both discretised exactly for tick_s [s]."""
    e_phi, e_gamma = discretise(a_i, np.eye(3), tick_s)
    k_phi, k_gamma = discretise(controller.a, controller.b, tick_s)
    loop = np.block([[e_phi, -e_gamma @ controller.c], [k_gamma, k_phi]])
    return float(np.max(np.abs(np.linalg.eigvals(loop))))


def _certify(
    rule: int, a_i: Array, plant: GeneralisedPlant, controller: Controller, weighting: Weighting
) -> dict[str, Any]:
    loop = close_loop(plant, controller)
    poles = np.linalg.eigvals(loop[0]).real
    radii = {f"{rate}": sampled_radius(a_i, controller, 1.0 / rate) for rate in RATES_HZ}
    for rate, radius in radii.items():
        if not radius < 1.0:
            raise DesignError(f"rule {rule}, eps = {weighting.eps:g}: sampled at {rate} Hz its spectral radius is"
                              f" {radius:.9f}, it must be below 1")  # fmt: skip
    gamma_opt = weighting.gamma_opt
    return {
        "rule": rule,
        "gamma": weighting.gamma_ratio * gamma_opt,
        "achieved_norm": float(f"{compute_norm(*loop):.6g}"),
        "t_ef_at_0.01_rad_s": float(f"{np.linalg.norm(compute_t_ef(a_i, controller, 0.01), 2):.6g}"),
        "slowest_pole_rad_s": float(f"{poles.max():.6g}"),
        "fastest_pole_rad_s": float(f"{poles.min():.6g}"),
        "one_minus_spectral_radius": {rate: float(f"{1.0 - radius:.3g}") for rate, radius in radii.items()},
    }


def make_documents(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the gains file and the certificate of one inertia of INERTIAS."""
    inertia = INERTIAS[name]
    head = {"name": name, "inertia_kgm2": inertia, "operating_rate_rad_s": OPERATING_RATE_RAD_S}
    gains: dict[str, Any] = {**head, "banks": {}}
    static = certify_static(inertia)
    certificate: dict[str, Any] = {**head, "static_gain_above_rad_s": float(f"{static:.4g}"), "banks": {}}
    for bank, weighting in BANKS.items():
        controllers, records = design_bank(inertia, weighting)
        gains["banks"][bank] = [{"a": k.a.tolist(), "b": k.b.tolist(), "c": k.c.tolist()} for k in controllers]
        certificate["banks"][bank] = {
            "eps": weighting.eps, "gamma_ratio": weighting.gamma_ratio, "gamma_opt": weighting.gamma_opt,
            "t_mid_closed_form": float(f"{weighting.t_mid:.6g}"), "rules": records,
        }  # fmt: skip
    return gains, certificate


def compare_gains(committed: dict[str, Any], fresh: dict[str, Any]) -> float:
    """Return the largest difference of T_ef between two gains files, relative to its size, over both banks."""
    inertia, worst = fresh["inertia_kgm2"], 0.0
    j_inv = invert_symmetric(inertia)
    for bank, rules in fresh["banks"].items():
        for rule, (new, old) in enumerate(zip(rules, committed["banks"][bank], strict=True)):
            x, y, z = (OPERATING_RATE_RAD_S * s for s in VERTEX_SIGNS[rule])
            a_i = np.array(make_a(inertia, j_inv, (x, y, z)))
            pair = [Controller(*(np.array(k[key]) for key in "abc")) for k in (new, old)]
            for omega in (1e-4, 1e-2, 0.5, 10.0):
                t_new, t_old = (compute_t_ef(a_i, k, omega) for k in pair)
                worst = max(worst, float(np.max(np.abs(t_new - t_old)) / np.max(np.abs(t_new))))
    return worst


def main(arguments: list[str] | None = None) -> int:
    """Check or write the gains of every inertia; return 0, or 1 where the committed ones do not match."""
    parser = argparse.ArgumentParser(description="H-infinity observer banks: check the committed gains, or write them")
    parser.add_argument("--write", action="store_true", help="write gains and certificates")
    options = parser.parse_args(arguments)
    bad = 0
    for name in INERTIAS:
        gains, certificate = make_documents(name)
        path, record = GAINS_DIR / f"gains_{name}.json", GAINS_DIR / f"certificate_{name}.json"
        if options.write:
            path.write_text(json.dumps(gains, separators=(",", ":")) + "\n")
            record.write_text(json.dumps(certificate, indent=1) + "\n")
        difference = compare_gains(json.loads(path.read_text()), gains)
        bad += difference > 1e-6
        print(f"{name}: T_ef differs by {difference:.1e}; static gain stable above"
              f" {certificate['static_gain_above_rad_s']:g} rad/s")  # fmt: skip
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
