"""What one wheel gives of what it is told: share and bias by a Kalman filter of two random walks."""

from __future__ import annotations

import math
from typing import Final

from fsw.wheel_health.settings import ShareKalmanConfig

# Noise of a torque from a quantised speed, in steps of the speed: 1/sqrt(6) = 0.41 if both ends of the interval are rounded
# evenly. The reference filter was tuned to a bit more, R = 6.1e-4 at 0.1 rad/s, 0.01 kg m^2, 0.2 s and 0.1 N m.
NOISE_STEPS: Final = 0.494


class ShareFilter:
    """theta = [e, b] with z = e u + b, u and z the torque told and given, over the largest torque.

    Torques are over the wheel's largest one, e, b and the variances P without a unit.

    e and b are one and the same while u is constant: the cap keeps P from winding up then. A CUSUM of r^2/S - drift over
    its threshold opens P to the cap, so that a wheel that breaks is learnt anew at once.
    """

    __slots__ = (
        "_bias_cap",
        "_bias_start",
        "_bias_walk",
        "_drift",
        "_jump",
        "_most_share",
        "_noise_floor",
        "_noise_steps",
        "_share_cap",
        "_share_start",
        "_share_walk",
        "bias",
        "cusum",
        "p_bb",
        "p_eb",
        "p_ee",
        "resets",
        "share",
    )

    def __init__(self, config: ShareKalmanConfig, inertia_kgm2: float, max_torque_nm: float) -> None:
        """inertia_kgm2: of the rotor; max_torque_nm: what torques are divided by."""
        self._share_walk = config.share_walk_sqrt_s**2  # variance per second
        self._bias_walk = config.bias_walk_sqrt_s**2
        self._share_cap = config.share_sigma_max**2
        self._bias_cap = config.bias_sigma_max**2
        self._share_start = config.share_sigma_start**2
        self._bias_start = config.bias_sigma_start**2
        self._noise_floor = (config.torque_noise_nm / max_torque_nm) ** 2
        # standard deviation of a measured torque by the speed's steps, times the interval [s]
        self._noise_steps = NOISE_STEPS * inertia_kgm2 * config.speed_quantum_rad_s / max_torque_nm
        self._most_share = config.share_max
        self._drift = config.cusum_drift
        self._jump = config.cusum_jump
        self.reset()

    def reset(self) -> None:
        """Trust the wheel again."""
        self.share, self.bias = 1.0, 0.0
        self.p_ee, self.p_eb, self.p_bb = self._share_start, 0.0, self._bias_start
        self.cusum = 0.0
        self.resets = 0

    def update(self, span_s: float, told: float, given: float) -> None:
        """Take in one measurement: means over span_s of what was told and given, over the largest torque."""
        self._spread(span_s)
        steps = self._noise_steps / span_s
        noise = self._noise_floor + steps * steps
        toward_e = self.p_ee * told + self.p_eb
        toward_b = self.p_eb * told + self.p_bb
        variance = told * toward_e + toward_b + noise
        off = given - told * self.share - self.bias
        cusum = self.cusum + off * off / variance - self._drift
        if cusum >= self._jump:
            self.p_ee, self.p_eb, self.p_bb = self._share_cap, 0.0, self._bias_cap
            cusum = 0.0
            self.resets += 1
            toward_e, toward_b = self._share_cap * told, self._bias_cap
            variance = told * toward_e + toward_b + noise
        self.cusum = cusum if cusum > 0.0 else 0.0
        gain_e, gain_b = toward_e / variance, toward_b / variance
        share = self.share + gain_e * off
        self.share = 0.0 if share < 0.0 else self._most_share if share > self._most_share else share
        self.bias += gain_b * off
        p_ee, p_bb = self.p_ee - gain_e * toward_e, self.p_bb - gain_b * toward_b
        self.p_eb -= gain_e * toward_b
        self.p_ee = p_ee if p_ee > 0.0 else 0.0
        self.p_bb = p_bb if p_bb > 0.0 else 0.0

    def _spread(self, span_s: float) -> None:
        """Both walk on; a variance beyond its cap is scaled back to it, correlation kept."""
        p_ee, p_bb = self.p_ee + self._share_walk * span_s, self.p_bb + self._bias_walk * span_s
        if p_ee > self._share_cap:
            self.p_eb *= math.sqrt(self._share_cap / p_ee)
            p_ee = self._share_cap
        if p_bb > self._bias_cap:
            self.p_eb *= math.sqrt(self._bias_cap / p_bb)
            p_bb = self._bias_cap
        self.p_ee, self.p_bb = p_ee, p_bb
