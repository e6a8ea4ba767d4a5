"""Attitude law that follows a braking profile, as fast as the wheels that are left allow.

The body turns towards the target at the rate from which it can still be stopped there. What "can" means is learnt in
flight from the commanded wheel torques and from the fault torque that the observer reports; no fault is known beforehand.
Derivation and study: docs/ilo-smc.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from bus.units import Vec3, Vec4
from fsw.config import BrakingProfileConfig, ModelConfig
from fsw.records import Demand
from fsw.wheel_axes import S, combine_wheels

NO_TORQUE: Vec4 = (0.0, 0.0, 0.0, 0.0)
HEALTHY: Vec4 = (1.0, 1.0, 1.0, 1.0)
BRAKING_MIN_RAD_S2 = 2e-4  # slowest braking planned on: a wheel set judged dead would otherwise never move again
SHARE_MIN = 0.15  # a wheel judged weaker is still asked for this share, so that its recovery shows
LEARN_FLOOR_NM = 0.02  # commands far below it teach nothing: there, misalignment and drag look like lost torque
NOTHING_NM = 1e-12  # far below any torque, keeps a quotient finite
VECTOR_MIN = 1e-9  # |q| below which the eigenaxis has no direction


class BrakingProfileInternals(NamedTuple):
    """What the law holds, for telemetry."""

    s_b_rad_s: Vec3
    profile_rad_s: float  # length of w_d
    braking_rad_s2: float  # deceleration along the eigenaxis planned on, before eta
    effectiveness: Vec4  # share of its command that each wheel is thought to deliver


def find_authority(t_b: Vec3, limit_nm: Vec4) -> tuple[float, float]:
    """Return the largest m with D0 y = m t, |y_i| <= limit_i, for these wheels and after the worst loss of one [1].

    With y_4 free, y_i = m t_i - S y_4 for i = 1..3. Eliminating y_4 between the two-sided limits of every pair of
    wheels leaves m |t_i - t_j| <= limit_i + limit_j and m |t_i| <= limit_i + S limit_4: exact for these four axes.
    Losing a wheel takes its term out of each sum it is in, so the worst loss leaves the smaller term of each.
    Infinite for t = 0.
    """
    x, y, z = t_b
    a, b, c, d = limit_nm
    d *= S
    xy, yz, zx = abs(x - y), abs(y - z), abs(z - x)
    x, y, z = abs(x), abs(y), abs(z)
    n = NOTHING_NM  # two dead wheels leave a room of zero
    full = max(x / (a + d + n), y / (b + d + n), z / (c + d + n), xy / (a + b + n), yz / (b + c + n), zx / (c + a + n))
    worst = max(
        x / ((a if a < d else d) + n),
        y / ((b if b < d else d) + n),
        z / ((c if c < d else d) + n),
        xy / ((a if a < b else b) + n),
        yz / ((b if b < c else c) + n),
        zx / ((c if c < a else a) + n),
    )
    return (1.0 / full if full > 0.0 else math.inf, 1.0 / worst if worst > 0.0 else math.inf)


def spread_weighted(torque_b_nm: Vec3, share: Vec4) -> Vec4:
    """Return the wheel commands u with D0 diag(share) u = torque and the least sum of squares [N m].

    u = C D0^T z with (D0 C^2 D0^T) z = torque, C = diag(share): a diagonal plus c4^2 S^2 1 1^T, solved by
    Sherman-Morrison. A weaker wheel is asked for less. Every share must be > 0.
    """
    a, b, c, d = share
    ia, ib, ic = 1.0 / (a * a), 1.0 / (b * b), 1.0 / (c * c)
    x, y, z = torque_b_nm
    skew = d * d * S * S
    k = skew * (x * ia + y * ib + z * ic) / (1.0 + skew * (ia + ib + ic))
    zx, zy, zz = (x - k) * ia, (y - k) * ib, (z - k) * ic
    return (a * zx, b * zy, c * zz, d * S * (zx + zy + zz))


class BrakingProfile:
    """s = w - w_d, w_d = -e f(theta); wheels are commanded for J (-k_s s + w_d') + w x J w - v.

    e and theta are eigenaxis and angle of the error, f is the profile:

        f   = k_theta theta                                         for theta <= theta_1 = a eta / k_theta^2
        f^2 = 2 a (eta theta_1 / 2 + eta_far x + (eta - eta_far) far (1 - exp(-x/far))),  x = theta - theta_1,  beyond

    so that the deceleration along it is a (eta_far + (eta - eta_far) exp(-x/far)): gentle far out, where a wheel that
    fails while the body is fast costs a long overshoot, firm close to the target.

    a = (1 - reserve) a_now + reserve a_worst: the braking accelerations along e of the wheels as they are thought to
    be, and after one more loss. The wheels' shares e_i are learnt by a normalised gradient step on the residual r of
    v = -D0 (1 - e) tau + r, with tau the commands seen through the observer's lag. What the shares do not explain
    (misalignment, bias) stays in r and is fed forward.

    With `adapt` off, a is that of braking_torque_nm per wheel, eta_far is not used, and the shares stay at 1.
    """

    __slots__ = (
        "_a", "_adapt", "_config", "_effectiveness", "_fixed_nm", "_gyroscopic", "_inertia", "_limit", "_profile", "_s",
        "_tau_rw", "_tau_seen",
    )  # fmt: skip

    def __init__(self, config: BrakingProfileConfig, model: ModelConfig) -> None:
        self._config = config
        self._adapt = config.adapt
        self._inertia = model.inertia_kgm2
        self._limit = model.wheel_max_torque_nm
        fixed = min(config.braking_torque_nm, model.wheel_max_torque_nm)
        self._fixed_nm: Vec4 = (fixed, fixed, fixed, fixed)
        # With the wheels' momentum in play w x (J w + h) is near w x (total momentum): small. Without, w x J w is all.
        self._gyroscopic = not model.wheel_momentum
        self.reset()

    def reset(self) -> None:
        """Trust every wheel again."""
        self._effectiveness = HEALTHY
        self._tau_rw = NO_TORQUE  # commanded over the interval that ends at the next step
        self._tau_seen = NO_TORQUE  # the commands, through the observer's lag
        self._s: Vec3 = (0.0, 0.0, 0.0)
        self._profile = 0.0
        self._a = 0.0

    @property
    def internals(self) -> BrakingProfileInternals:
        """Surface, profile rate, deceleration planned on, and the share each wheel is thought to deliver."""
        return BrakingProfileInternals(self._s, self._profile, self._a, self._effectiveness)

    def step(self, dt_s: float, q_err: Vec4, omega_err_b_rad_s: Vec3, tau_fault_hat_b_nm: Vec3) -> Demand:
        """Return wheel torques within limits [N m] and the body torque they add up to.

        q_err              : body with respect to target, scalar first, q0 >= 0 chosen by the caller
        omega_err_b_rad_s  : body rate with respect to the target at rest, body axes [rad/s]
        tau_fault_hat_b_nm : v, the observer's fault torque for the interval that ends now, body axes [N m]
        """
        if self._adapt:
            self._learn(dt_s, tau_fault_hat_b_nm)
        q0, qx, qy, qz = q_err
        norm = math.sqrt(qx * qx + qy * qy + qz * qz)
        theta = 2.0 * math.atan2(norm, q0)
        scale = 1.0 / norm if norm > VECTOR_MIN else 0.0
        ex, ey, ez = qx * scale, qy * scale, qz * scale
        rate, slope = self._plan(theta, (ex, ey, ez))
        wx, wy, wz = omega_err_b_rad_s
        sx, sy, sz = wx + rate * ex, wy + rate * ey, wz + rate * ez
        self._s = (sx, sy, sz)
        # w_d' = -e f'(theta) theta', theta' = w.e; the turning of e itself is left to the feedback.
        along = slope * (wx * ex + wy * ey + wz * ez)
        k = self._config.k_s
        torque = self._turn_into_torque(
            (-k * sx - along * ex, -k * sy - along * ey, -k * sz - along * ez), (wx, wy, wz)
        )
        tau_rw_nm = self._tau_rw = self._allocate(torque, tau_fault_hat_b_nm)
        return Demand(combine_wheels(tau_rw_nm), tau_rw_nm)

    def _learn(self, dt_s: float, tau_fault_hat_b_nm: Vec3) -> None:
        """Move the wheels' shares towards what explains the reported fault torque."""
        config = self._config
        lag = 1.0 - math.exp(-dt_s / config.observer_lag_s)
        a, b, c, d = self._tau_seen
        new_a, new_b, new_c, new_d = self._tau_rw
        a += lag * (new_a - a)
        b += lag * (new_b - b)
        c += lag * (new_c - c)
        d += lag * (new_d - d)
        self._tau_seen = (a, b, c, d)
        ea, eb, ec, ed = self._effectiveness
        vx, vy, vz = tau_fault_hat_b_nm
        skew = S * (1.0 - ed) * d
        rx = vx + (1.0 - ea) * a + skew
        ry = vy + (1.0 - eb) * b + skew
        rz = vz + (1.0 - ec) * c + skew
        gain = (1.0 - math.exp(-dt_s / config.learn_s)) / (LEARN_FLOOR_NM**2 + a * a + b * b + c * c + d * d)
        ea += gain * a * rx
        eb += gain * b * ry
        ec += gain * c * rz
        ed += gain * d * S * (rx + ry + rz)
        self._effectiveness = (
            0.0 if ea < 0.0 else 1.0 if ea > 1.0 else ea,
            0.0 if eb < 0.0 else 1.0 if eb > 1.0 else eb,
            0.0 if ec < 0.0 else 1.0 if ec > 1.0 else ec,
            0.0 if ed < 0.0 else 1.0 if ed > 1.0 else ed,
        )

    def _plan(self, theta: float, axis: Vec3) -> tuple[float, float]:
        """Return the profile's rate [rad/s] and its slope over the angle [1/s]."""
        config = self._config
        ex, ey, ez = axis
        (j00, j01, j02), (j10, j11, j12), (j20, j21, j22) = self._inertia
        per_accel = (
            j00 * ex + j01 * ey + j02 * ez,
            j10 * ex + j11 * ey + j12 * ez,
            j20 * ex + j21 * ey + j22 * ez,
        )
        eta = eta_far = config.eta
        if self._adapt:
            top = self._limit
            ea, eb, ec, ed = self._effectiveness
            now, worst = find_authority(per_accel, (top * ea, top * eb, top * ec, top * ed))
            eta_far = config.eta_far
            a = now + config.reserve * (worst - now) if now < math.inf else BRAKING_MIN_RAD_S2
        else:
            a = find_authority(per_accel, self._fixed_nm)[0]
        if not BRAKING_MIN_RAD_S2 <= a < math.inf:
            a = BRAKING_MIN_RAD_S2
        self._a = a
        k = config.k_theta
        linear_to = a * eta / (k * k)
        if theta <= linear_to:
            self._profile = rate = k * theta
            return rate, k
        x = theta - linear_to
        near = (eta - eta_far) * math.exp(-x / config.far_rad)
        energy = 0.5 * eta * linear_to + eta_far * x + (eta - eta_far - near) * config.far_rad
        self._profile = rate = math.sqrt(2.0 * a * energy)
        return rate, a * (eta_far + near) / rate

    def _turn_into_torque(self, accel_b_rad_s2: Vec3, omega_b_rad_s: Vec3) -> Vec3:
        """Return the body torque for an acceleration [N m], the gyroscopic torque counted where it stands alone."""
        ax, ay, az = accel_b_rad_s2
        (j00, j01, j02), (j10, j11, j12), (j20, j21, j22) = self._inertia
        tx = j00 * ax + j01 * ay + j02 * az
        ty = j10 * ax + j11 * ay + j12 * az
        tz = j20 * ax + j21 * ay + j22 * az
        if self._gyroscopic:
            wx, wy, wz = omega_b_rad_s
            hx = j00 * wx + j01 * wy + j02 * wz
            hy = j10 * wx + j11 * wy + j12 * wz
            hz = j20 * wx + j21 * wy + j22 * wz
            tx += wy * hz - wz * hy
            ty += wz * hx - wx * hz
            tz += wx * hy - wy * hx
        return (tx, ty, tz)

    def _allocate(self, torque_b_nm: Vec3, tau_fault_hat_b_nm: Vec3) -> Vec4:
        """Return wheel commands within limits [N m] that leave `torque_b_nm` on the body, as far as they can."""
        ea, eb, ec, ed = self._effectiveness
        a, b, c, d = self._tau_seen
        skew = S * (1.0 - ed) * d
        # Take off what the shares do not explain of v; spread_weighted makes up for the rest. The commands must be those
        # seen through the observer's lag: the last one alone, against a late v, makes a loop that rings when the bus is
        # one period late.
        x = torque_b_nm[0] - tau_fault_hat_b_nm[0] - (1.0 - ea) * a - skew
        y = torque_b_nm[1] - tau_fault_hat_b_nm[1] - (1.0 - eb) * b - skew
        z = torque_b_nm[2] - tau_fault_hat_b_nm[2] - (1.0 - ec) * c - skew
        low = SHARE_MIN
        share = (ea if ea > low else low, eb if eb > low else low, ec if ec > low else low, ed if ed > low else low)
        a, b, c, d = spread_weighted((x, y, z), share)
        top = self._limit
        return (
            -top if a < -top else top if a > top else a,
            -top if b < -top else top if b > top else b,
            -top if c < -top else top if c > top else c,
            -top if d < -top else top if d > top else d,
        )
