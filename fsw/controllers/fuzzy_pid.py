"""PID whose gains are scheduled by fuzzy rules over error and error rate: the law of paper 003."""

from __future__ import annotations

from typing import NamedTuple

from bus.linear import ZERO3
from bus.units import Vec3
from fsw.controllers.error_integral import ErrorIntegral
from fsw.controllers.fuzzy import FuzzyTables
from fsw.controllers.fuzzy_tables import find_rules
from fsw.controllers.pid_gains import choose_gains, place_poles
from fsw.controllers.rate_slope import RateSlope
from fsw.controllers.settings import FuzzyPidConfig
from fsw.families import Controller
from fsw.records import PointingError, WheelHealth
from fsw.vehicle import Vehicle

PAPER_KP: Vec3 = (0.7, 0.7, 0.7)  # Kp0 [N m s/rad], Ki0 [N m/rad] and Kd0 [N m s^2/rad] of scenario S003, section 6.5
PAPER_KI: Vec3 = (3.0, 3.0, 3.0)
RATE_SCALES = (0.04, 0.04)  # of the angle [rad] and of the rate [rad/s], base `rate`: the paper's
ENGINEERING_SCALES = (0.02, 0.005)  # base `engineering`: ours


class FuzzyPidInternals(NamedTuple):
    """What the law held and computed last, for telemetry. Per body axis."""

    sigma_b_rad: Vec3
    f_kp: Vec3  # what the rules gave, -1 .. 1
    f_ki: Vec3
    f_kd: Vec3
    kp: Vec3  # the gains flown: [N m s/rad], [N m/rad], [N m s^2/rad] with base `rate`,
    ki: Vec3  # [N m/rad], [N m/(rad s)], [N m s/rad] with base `engineering`
    kd: Vec3
    alpha_b_rad_s2: Vec3  # smoothed acceleration; zeros with base `engineering`
    integral_b_rad_s: Vec3  # zeros with base `rate`


class FuzzyPid(Controller):
    """The law of `rate_pid` or of `pid`; gains per axis from F(e / angle scale, ec / rate scale), e = -sigma, ec = -w.

    base `rate`        : K = K0 + span (1 + F)/2, so that the gains are never below K0 (spec of paper 003, section 6.1);
                         what the rules add on the average does more than what they vary: docs/fuzzy-pid.md
    base `engineering` : K = K0 (1 + rho F) (section 6.4); ki multiplies the integral as it stands, so that a change of ki
                         is a step of torque
    """

    __slots__ = (
        "_engineering",
        "_f",
        "_gains",
        "_integral",
        "_kd",
        "_ki",
        "_kp",
        "_per_rad",
        "_per_rad_s",
        "_rho",
        "_sigma",
        "_slope",
        "_spans",
        "_tables",
    )

    def __init__(self, config: FuzzyPidConfig, vehicle: Vehicle, period_s: float) -> None:
        """Raises ConfigError where one or two of the three gains are given."""
        self._engineering = config.base == "engineering"
        if self._engineering:
            placed = place_poles(config.frequency_rad_s, config.damping, config.integral_rad_s, vehicle)
            angle, rate = ENGINEERING_SCALES
        else:
            placed = (PAPER_KP, PAPER_KI, ZERO3)
            angle, rate = RATE_SCALES
        self._kp, self._ki, self._kd = choose_gains((config.kp, config.ki, config.kd), placed, "fuzzy_pid")
        self._per_rad = 1.0 / (angle if config.angle_scale_rad is None else config.angle_scale_rad)
        self._per_rad_s = 1.0 / (rate if config.rate_scale_rad_s is None else config.rate_scale_rad_s)
        self._spans: Vec3 = (config.kp_span, config.ki_span, config.kd_span)
        self._rho = config.rho
        self._tables = FuzzyTables(find_rules(config.tables), config.inference == "prod")
        self._slope = RateSlope(config.alpha_share)
        self._integral = ErrorIntegral(config.limit_nm, vehicle)
        self.reset()

    def reset(self) -> None:
        """Forget the rates, and back to an integral of zero."""
        self._slope.reset()
        self._integral.reset()
        self._sigma: Vec3 = ZERO3
        self._f: tuple[Vec3, Vec3, Vec3] = (ZERO3, ZERO3, ZERO3)  # of Kp, Ki and Kd, each per body axis
        self._gains: tuple[Vec3, Vec3, Vec3] = (self._kp, self._ki, self._kd)

    @property
    def internals(self) -> FuzzyPidInternals:
        """Angle, what the rules gave, gains, acceleration and integral."""
        (f_kp, f_ki, f_kd), (kp, ki, kd) = self._f, self._gains
        alpha, integral = self._slope.alpha_b_rad_s2, self._integral.z_b_rad_s
        return FuzzyPidInternals(self._sigma, f_kp, f_ki, f_kd, kp, ki, kd, alpha, integral)

    def step(self, dt_s: float, error: PointingError, tau_fault_hat_b_nm: Vec3, health: WheelHealth) -> Vec3:
        """Return the body torque [N m].

        tau_fault_hat_b_nm : v, the observer's fault torque, body axes; subtracted as `rate_pid` and `pid` do
        health             : for the integral's limit of torque; not used with base `rate`
        """
        _, qx, qy, qz = error.q_tb
        wx, wy, wz = omega = error.omega_bt_b_rad_s
        sx, sy, sz = self._sigma = (2.0 * qx, 2.0 * qy, 2.0 * qz)
        self._schedule(self._sigma, omega)
        (px, py, pz), (ix, iy, iz), (dx, dy, dz) = self._gains
        vx, vy, vz = tau_fault_hat_b_nm
        if not self._engineering:
            ax, ay, az = self._slope.step(dt_s, omega)
            return (
                -px * wx - ix * sx - dx * ax - vx,
                -py * wy - iy * sy - dy * ay - vy,
                -pz * wz - iz * sz - dz * az - vz,
            )
        zx, zy, zz = self._integral.z_b_rad_s
        torque = (
            -px * sx + ix * zx - dx * wx - vx,
            -py * sy + iy * zy - dy * wy - vy,
            -pz * sz + iz * zz - dz * wz - vz,
        )
        self._integral.step(dt_s, self._sigma, torque, health)
        return torque

    def _schedule(self, sigma_b_rad: Vec3, omega_b_rad_s: Vec3) -> None:
        """Set the gains of this period."""
        tables, per_rad, per_rad_s = self._tables, self._per_rad, self._per_rad_s
        (sx, sy, sz), (wx, wy, wz) = sigma_b_rad, omega_b_rad_s
        fx, gx, hx = tables.infer(-sx * per_rad, -wx * per_rad_s)
        fy, gy, hy = tables.infer(-sy * per_rad, -wy * per_rad_s)
        fz, gz, hz = tables.infer(-sz * per_rad, -wz * per_rad_s)
        self._f = ((fx, fy, fz), (gx, gy, gz), (hx, hy, hz))
        (px, py, pz), (ix, iy, iz), (dx, dy, dz) = self._kp, self._ki, self._kd
        if self._engineering:
            rho = self._rho
            self._gains = (
                (px * (1.0 + rho * fx), py * (1.0 + rho * fy), pz * (1.0 + rho * fz)),
                (ix * (1.0 + rho * gx), iy * (1.0 + rho * gy), iz * (1.0 + rho * gz)),
                (dx * (1.0 + rho * hx), dy * (1.0 + rho * hy), dz * (1.0 + rho * hz)),
            )
            return
        p, i, d = self._spans
        p, i, d = 0.5 * p, 0.5 * i, 0.5 * d
        self._gains = (
            (px + p * (1.0 + fx), py + p * (1.0 + fy), pz + p * (1.0 + fz)),
            (ix + i * (1.0 + gx), iy + i * (1.0 + gy), iz + i * (1.0 + gz)),
            (dx + d * (1.0 + hx), dy + d * (1.0 + hy), dz + d * (1.0 + hz)),
        )
