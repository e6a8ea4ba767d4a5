"""The driver of a wheel's motor: current against command."""

from __future__ import annotations

import math
from typing import Final

from fsw.wheel_motor import WheelMotor

# Variances that a second adds: of the current, which the driver's lag does not explain, and of the gain, which may wander.
CURRENT_WALK_A2_S: Final = 4e-6
GAIN_WALK_S: Final = 1e-5
FIRST_CURRENT_A2: Final = 1e-6
FIRST_GAIN: Final = 0.01
GAIN_LIMIT: Final = 1.5  # a gain beyond it is a current that is not the command's
NIS_S: Final = 1.0  # time constant of the mean of the normalised innovation squared,
MOST_NIS: Final = 100.0  # of which no sample counts for more than this: a step is soon forgotten


class DriverFilter:
    """Kalman filter of x = [I, C_d]: I' = a I + (1 - a) G_d C_d V, a = exp(-w_d T); I is measured.

    Rederived, see docs/wheel-health.md. Linear in the state while V is held, and discretised exactly.
    """

    __slots__ = (
        "_constant",
        "_decay",
        "_dt_s",
        "_gain_a_v",
        "_noise_a2",
        "_p_cc",
        "_p_ic",
        "_p_ii",
        "_rate_s",
        "_share",
        "current_a",
        "gain",
        "mean_nis",
        "torque_nm",
        "variance",
    )

    def __init__(self, motor: WheelMotor, noise_a: float) -> None:
        self._gain_a_v = motor.driver_gain_a_v
        self._rate_s = motor.bandwidth_rad_s
        self._constant = motor.torque_constant_nm_a
        self._noise_a2 = noise_a * noise_a
        self._dt_s = -1.0
        self._decay = self._share = 0.0
        self.restart(0.0)

    def restart(self, current_a: float) -> None:
        """Start from a current, and from a sound driver."""
        self.current_a = current_a
        self.gain = 1.0
        self.variance = self._p_cc = FIRST_GAIN
        self._p_ii, self._p_ic = FIRST_CURRENT_A2, 0.0
        self.mean_nis = 1.0
        self.torque_nm = 0.0

    def anchor(self, current_a: float) -> None:
        """Take a current as it is measured, after a time in which there was none; the gain stays."""
        self.current_a = current_a
        self._p_ii, self._p_ic = FIRST_CURRENT_A2, 0.0

    def doubt(self) -> None:
        """Forget how sure the gain was, not what it is: it then follows within a few measurements."""
        self.variance = self._p_cc = FIRST_GAIN
        self._p_ic = 0.0

    def step(self, dt_s: float, command_v: float, measured_a: float, heard: bool) -> None:
        """Advance over dt_s, in which the command was held; then `torque_nm` is k_t times the mean current of that time.

        heard : whether there is a measurement; without one it predicts
        """
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._decay = math.exp(-self._rate_s * dt_s)
            self._share = (1.0 - self._decay) / (self._rate_s * dt_s)
        a, before = self._decay, self.current_a
        g = (1.0 - a) * self._gain_a_v * command_v
        current, gain, p_cc = a * before + g * self.gain, self.gain, self._p_cc
        p_ii = a * a * self._p_ii + g * (2.0 * a * self._p_ic + g * p_cc) + CURRENT_WALK_A2_S * dt_s
        p_ic = a * self._p_ic + g * p_cc
        p_cc += GAIN_WALK_S * dt_s
        if heard:
            s = p_ii + self._noise_a2
            innovation = measured_a - current
            k_i, k_c = p_ii / s, p_ic / s
            current += k_i * innovation
            gain += k_c * innovation
            gain = -GAIN_LIMIT if gain < -GAIN_LIMIT else GAIN_LIMIT if gain > GAIN_LIMIT else gain
            p_cc -= k_c * p_ic
            p_ic -= k_i * p_ic
            p_ii -= k_i * p_ii
            nis = innovation * innovation / s
            self.mean_nis += dt_s / (NIS_S + dt_s) * ((nis if nis < MOST_NIS else MOST_NIS) - self.mean_nis)
        self.current_a, self.gain = current, gain
        self._p_ii, self._p_ic, self._p_cc, self.variance = p_ii, p_ic, p_cc, p_cc
        final = self._gain_a_v * gain * command_v
        self.torque_nm = self._constant * (final + (before - final) * self._share)
