"""Gyro fault observers of Wang, Li & Ma 2010: the rate that the torques imply, and the gyro's departure from it.

    xh' = sum_i h_i(z) (A_i xh + v_i) + J^-1 u,   v = K_i r,   r = y - xh

Differs from the paper: the interpolation is exact, A(z) being linear in z, so A is used instead of the sum; wheel
momentum may be counted; the controllers are sampled exactly and the body by a fourth-order Runge-Kutta step.
"""

from __future__ import annotations

from bus.linear import ZERO3, invert_symmetric
from bus.units import Mat3, Vec3
from fsw.gyro_fdi.gains import Rule, load_bank, require_stable_static
from fsw.gyro_fdi.ts_model import clip_premise, is_inside, weigh_exact9

OBSERVERS = ("linear", "ts_a", "ts_b", "ts_bx", "static")
_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class GyroObserver:
    """One observer of the family.

    linear : no gyroscopic term, the controller of the operating point at rest
    ts_a   : bank A, premise known (given to `predict`), clipped to the operating range
    ts_b   : bank B, premise is the observer's own rate, clipped to the operating range: the paper's practical form
    ts_bx  : as ts_b, but only the weights are clipped; the rate equation keeps the true premise
    static : v = l r, rate equation with its own rate; forgets a constant fault in 1/l, so it detects and does not hold
    """

    def __init__(self, kind: str, inertia_kgm2: Mat3, tick_s: float, static_gain_rad_s: float = 0.05) -> None:
        """tick_s: period between calls [s]. Raises DesignError where no stable design is there for it."""
        if kind not in OBSERVERS:
            raise ValueError(f'gyro observer "{kind}" is not known; there are: {", ".join(OBSERVERS)}')
        self._kind = kind
        self._tick_s = tick_s
        self._j, self._j_inv = inertia_kgm2, invert_symmetric(inertia_kgm2)
        self._gain = static_gain_rad_s
        self._rules: tuple[Rule, ...] = ()
        if kind == "static":
            require_stable_static(static_gain_rad_s, tick_s)
        else:
            self._rules = load_bank(inertia_kgm2, "b" if kind in ("ts_b", "ts_bx") else "a", tick_s)
            if kind == "linear":
                self._rules = self._rules[:1]
        self.reset(ZERO3)

    def reset(self, omega_bi_b_rad_s: Vec3) -> None:
        """Start from a rate [rad/s] at rest: no residual so far."""
        self.omega_hat_b_rad_s = omega_bi_b_rad_s
        self.premise_out_of_range = False
        self._states: list[tuple[float, ...]] = [_REST] * len(self._rules)
        self._v = ZERO3
        self._premise = omega_bi_b_rad_s
        self._h = ZERO3

    def predict(self, tau_b_nm: Vec3, h_rw_b_nms: Vec3 = ZERO3, premise_rad_s: Vec3 | None = None) -> Vec3:
        """Return the rate [rad/s] expected at this tick, before the gyro is seen.

        tau_b_nm      : torque on the body over the tick that ends now, body axes [N m]
        h_rw_b_nms    : wheel momentum in body axes at this tick [N m s]; zeros for a body without wheels
        premise_rad_s : for ts_a, the true rate at this tick; PREMISE_OUT_OF_RANGE is flagged, not raised
        """
        before, after = self._premise, premise_rad_s if premise_rad_s is not None else self.omega_hat_b_rad_s
        h0, h1 = self._h, h_rw_b_nms
        drive = self._drive(tau_b_nm)
        x, dt = self.omega_hat_b_rad_s, self._tick_s
        half = 0.5 * dt
        z_mid = (0.5 * (before[0] + after[0]), 0.5 * (before[1] + after[1]), 0.5 * (before[2] + after[2]))
        h_mid = (0.5 * (h0[0] + h1[0]), 0.5 * (h0[1] + h1[1]), 0.5 * (h0[2] + h1[2]))
        a = self._slope(x, before, h0, drive)
        b = self._slope((x[0] + half * a[0], x[1] + half * a[1], x[2] + half * a[2]), z_mid, h_mid, drive)
        c = self._slope((x[0] + half * b[0], x[1] + half * b[1], x[2] + half * b[2]), z_mid, h_mid, drive)
        d = self._slope((x[0] + dt * c[0], x[1] + dt * c[1], x[2] + dt * c[2]), after, h1, drive)
        sixth = dt / 6.0
        self.omega_hat_b_rad_s = (
            x[0] + sixth * (a[0] + 2.0 * (b[0] + c[0]) + d[0]),
            x[1] + sixth * (a[1] + 2.0 * (b[1] + c[1]) + d[1]),
            x[2] + sixth * (a[2] + 2.0 * (b[2] + c[2]) + d[2]),
        )
        self._premise = after if premise_rad_s is not None else self.omega_hat_b_rad_s
        self._h = h_rw_b_nms
        self.premise_out_of_range = not is_inside(self._premise)
        return self.omega_hat_b_rad_s

    def correct(self, residual_b_rad_s: Vec3) -> None:
        """Feed the residual of this tick [rad/s], gyro minus `predict`; it acts over the next tick."""
        x, y, z = residual_b_rad_s
        if self._kind == "static":
            g = self._gain
            self._v = (g * x, g * y, g * z)
            return
        states = self._states
        for i, rule in enumerate(self._rules):
            p, q, r, s, t, u = states[i]
            states[i] = tuple([
                a * p + b * q + c * r + d * s + e * t + f * u + g * x + h * y + k * z
                for a, b, c, d, e, f, g, h, k in rule.rows
            ])  # fmt: skip
        self._v = self._inject()

    def step(
        self, omega_meas_b_rad_s: Vec3, tau_b_nm: Vec3, h_rw_b_nms: Vec3 = ZERO3, premise_rad_s: Vec3 | None = None
    ) -> Vec3:
        """Return the residual y - xh [rad/s] of this tick: the paper's estimate of the gyro fault, body axes."""
        x, y, z = self.predict(tau_b_nm, h_rw_b_nms, premise_rad_s)
        residual = (omega_meas_b_rad_s[0] - x, omega_meas_b_rad_s[1] - y, omega_meas_b_rad_s[2] - z)
        self.correct(residual)
        return residual

    def _drive(self, tau_b_nm: Vec3) -> Vec3:
        x, y, z = tau_b_nm
        v = self._v
        (a, b, c), (d, e, f), (g, h, i) = self._j_inv
        return (a * x + b * y + c * z + v[0], d * x + e * y + f * z + v[1], g * x + h * y + i * z + v[2])

    def _slope(self, x: Vec3, premise: Vec3, h_b: Vec3, drive: Vec3) -> Vec3:
        """A(z) x + J^-1 [h x] x + drive, with the premise z that the kind of observer uses."""
        kind = self._kind
        if kind == "linear":
            return drive
        if kind == "ts_a":
            zx, zy, zz = clip_premise(premise)
        elif kind == "ts_b":
            zx, zy, zz = clip_premise(x)
        else:
            zx, zy, zz = x
        xx, xy, xz = x
        hx, hy, hz = h_b
        (a, b, c), (d, e, f), (g, h, i) = self._j
        mx, my, mz = a * xx + b * xy + c * xz, d * xx + e * xy + f * xz, g * xx + h * xy + i * xz
        tx = my * zz - mz * zy + hy * xz - hz * xy
        ty = mz * zx - mx * zz + hz * xx - hx * xz
        tz = mx * zy - my * zx + hx * xy - hy * xx
        (a, b, c), (d, e, f), (g, h, i) = self._j_inv
        return (
            a * tx + b * ty + c * tz + drive[0],
            d * tx + e * ty + f * tz + drive[1],
            g * tx + h * ty + i * tz + drive[2],
        )

    def _inject(self) -> Vec3:
        """v = sum_i h_i(z) C_i x_i [rad/s^2]."""
        weights = (1.0,) if self._kind == "linear" else weigh_exact9(self._premise)
        vx = vy = vz = 0.0
        for weight, rule, (p, q, r, s, t, u) in zip(weights, self._rules, self._states, strict=True):
            if weight == 0.0:
                continue
            (a, b, c, d, e, f), second, third = rule.output
            vx += weight * (a * p + b * q + c * r + d * s + e * t + f * u)
            a, b, c, d, e, f = second
            vy += weight * (a * p + b * q + c * r + d * s + e * t + f * u)
            a, b, c, d, e, f = third
            vz += weight * (a * p + b * q + c * r + d * s + e * t + f * u)
        return (vx, vy, vz)
