"""Rate without a gyro: total momentum from wheel speeds and star tracker.

The body's rate follows from its total momentum, w = J^-1 (p - D0 h), and the momentum of a free body changes only by
the turn of the axes. Wheel torques, faulty or not, move momentum between wheels and body and so cancel: no wheel fault
can disturb this rate. The star tracker corrects attitude, momentum and a slow external torque.
"""

from __future__ import annotations

from typing import Final

from bus.attitude import conjugate, log_map, multiply, normalise
from bus.linear import ZERO3, invert_symmetric, times
from bus.units import Mat3, Vec3, Vec4
from fsw.rotation import turn

_GATE_RAD: Final = 0.005  # a star-tracker frame further off than gate + rate * age is a glitch ...
_GATE_RATE_RAD_S: Final = 0.02
_GLITCHES_IN_A_ROW: Final = 3  # ... unless as many come in a row
_RESTART_AFTER_S: Final = 5.0  # without frames for this long, the next one is taken as it is
_TORQUE_MEMORY_S: Final = 20.0  # without frames the external torque estimate fades over this time
_GYRO_PULL_RAD_S: Final = 0.5  # without frames a trusted gyro pulls the momentum at this rate


class MomentumFilter:
    """Attitude, rate and external torque from star tracker and wheel momentum alone."""

    def __init__(self, inertia_kgm2: Mat3, bandwidth_rad_s: float, gyroscopic: bool) -> None:
        """gyroscopic: the wheels' momentum turns with the body (False: the papers' plant, where it does not)."""
        self._j, self._j_inv = inertia_kgm2, invert_symmetric(inertia_kgm2)
        self._bandwidth = bandwidth_rad_s
        self._gyroscopic = gyroscopic
        self.reset()

    def reset(self) -> None:
        """Forget everything; `start` must follow."""
        self.started = False
        self.q_ib: Vec4 = (1.0, 0.0, 0.0, 0.0)
        self.omega_bi_b_rad_s = ZERO3
        self.since_frame_s = 0.0  # since the last accepted star-tracker frame
        self.glitches = 0
        self._p = self._torque = self._h = ZERO3
        self._in_a_row = 0

    def start(self, q_ib: Vec4, omega_bi_b_rad_s: Vec3, h_rw_b_nms: Vec3) -> None:
        """Begin at an attitude with a first guess of the rate [rad/s]."""
        self.reset()
        self.started = True
        self.q_ib, self.omega_bi_b_rad_s, self._h = q_ib, omega_bi_b_rad_s, h_rw_b_nms
        m = times(self._j, omega_bi_b_rad_s)
        self._p = (m[0] + h_rw_b_nms[0], m[1] + h_rw_b_nms[1], m[2] + h_rw_b_nms[2])

    def read_rate(self, h_rw_b_nms: Vec3) -> Vec3:
        """Return the rate [rad/s] that a new wheel momentum implies, nothing else having changed."""
        p, h = self._p, h_rw_b_nms
        return times(self._j_inv, (p[0] - h[0], p[1] - h[1], p[2] - h[2]))

    def propagate(self, h_rw_b_nms: Vec3, dt_s: float) -> None:
        """Carry the state over dt_s (midpoint rule) with the wheel momentum of its end, body axes [N m s]."""
        self._h = h = h_rw_b_nms
        p, d, dt = self._p, self._torque, dt_s
        w = self.read_rate(h)
        t = self._turn_rate(w, p)
        half = 0.5 * dt
        middle = (p[0] + half * (t[0] + d[0]), p[1] + half * (t[1] + d[1]), p[2] + half * (t[2] + d[2]))
        wm = times(self._j_inv, (middle[0] - h[0], middle[1] - h[1], middle[2] - h[2]))
        t = self._turn_rate(wm, middle)
        self._p = (p[0] + dt * (t[0] + d[0]), p[1] + dt * (t[1] + d[1]), p[2] + dt * (t[2] + d[2]))
        self.omega_bi_b_rad_s = w = self.read_rate(h)
        self.q_ib = turn(self.q_ib, w[0] * dt, w[1] * dt, w[2] * dt)
        self.since_frame_s += dt

    def correct(self, q_ib_meas: Vec4) -> bool:
        """Use a star-tracker attitude of this tick; return False where it is taken for a glitch.

        Poles at the bandwidth, or at half of one over the time since the last frame where that is slower.
        """
        age = self.since_frame_s
        if age > _RESTART_AFTER_S:
            self.q_ib = normalise(q_ib_meas)
            self.since_frame_s = 0.0
            self._in_a_row = 0
            return True
        x, y, z = log_map(multiply(conjugate(self.q_ib), q_ib_meas))
        if max(abs(x), abs(y), abs(z)) > _GATE_RAD + _GATE_RATE_RAD_S * age and self._in_a_row < _GLITCHES_IN_A_ROW:
            self._in_a_row += 1
            self.glitches += 1
            return False
        self._in_a_row = 0
        w = min(self._bandwidth, 0.5 / age) if age > 0.0 else self._bandwidth
        k_q, k_p, k_d = 2.0 * w * age, 2.0 * w * w * age, w * w * w * age
        self.q_ib = normalise(turn(self.q_ib, k_q * x, k_q * y, k_q * z))
        jx, jy, jz = times(self._j, (x, y, z))
        p, d = self._p, self._torque
        self._p = (p[0] + k_p * jx, p[1] + k_p * jy, p[2] + k_p * jz)
        self._torque = (d[0] + k_d * jx, d[1] + k_d * jy, d[2] + k_d * jz)
        self.omega_bi_b_rad_s = self.read_rate(self._h)
        self.since_frame_s = 0.0
        return True

    def follow_gyro(self, error_b_rad_s: Vec3, dt_s: float) -> None:
        """Without a star tracker: pull the momentum after trusted gyro axes, error = gyro - this rate [rad/s]."""
        k = min(1.0, _GYRO_PULL_RAD_S * dt_s)
        jx, jy, jz = times(self._j, error_b_rad_s)
        p, d = self._p, self._torque
        self._p = (p[0] + k * jx, p[1] + k * jy, p[2] + k * jz)
        fade = max(0.0, 1.0 - dt_s / _TORQUE_MEMORY_S)
        self._torque = (fade * d[0], fade * d[1], fade * d[2])
        self.omega_bi_b_rad_s = self.read_rate(self._h)

    def _turn_rate(self, w: Vec3, p: Vec3) -> Vec3:
        """-w x p, of the body's own momentum only where the wheels are not gyroscopic."""
        px, py, pz = p
        if not self._gyroscopic:
            h = self._h
            px, py, pz = px - h[0], py - h[1], pz - h[2]
        return (py * w[2] - pz * w[1], pz * w[0] - px * w[2], px * w[1] - py * w[0])
