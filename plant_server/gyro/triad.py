"""Fiber-optic gyro triad: three axes with noise, bias, scale factor, quantisation, range, bandwidth and faults.

Per axis and tick (IEEE Std 952-1997 terms):

    y = (1 + s) w + b + n,   b = b_turn_on + b_instability + b_walk,   n = N x / sqrt(dt)

w is the mean rate over the tick about the sensing axis (angle increment over dt, as an integrating gyro gives it), x
standard normal. b_instability is a first-order Gauss-Markov process of correlation time tau and standard deviation
1.075 B: the flicker floor of a bias instability B is an Allan deviation of 0.664 B, and that of a Gauss-Markov process
peaks at 0.617 sigma. b_walk is a random walk K. Then faults, range, and quantisation of the integrated angle.

The preset `ideal` gives the instantaneous rate at the tick instead of the mean: the published figures need it.
"""

from __future__ import annotations

from bus.attitude import dcm_from_quaternion, exp_map
from bus.linear import times
from bus.units import DEG, Mat3, Vec3
from plant_server.config import GyroConfig
from plant_server.faults import GYRO_AXES, FaultTimeline
from plant_server.gyro.axis import GyroAxis


class Gyro:
    """The triad, and how each of its axes stands after the last sample.

    status      : STATUS of each axis's frame
    silent      : which axes send no frame
    bias_rad_s  : bias of each axis in the last sample [rad/s]
    fault_rad_s : what the faults of each axis added to it [rad/s]; 0 while it is silent
    """

    __slots__ = ("_sensing", "axes", "bias_rad_s", "fault_rad_s", "instantaneous", "silent", "status")

    def __init__(self, config: GyroConfig, timeline: FaultTimeline, dt_s: float, seed: int) -> None:
        self.instantaneous = config.preset == "ideal"
        x, y, z = (angle * DEG for angle in config.misalignment_deg)
        # rows: sensing axes in body axes, the triad turned by the rotation vector `misalignment`
        (a, b, c), (d, e, f), (g, h, i) = dcm_from_quaternion(exp_map((x, y, z)))
        self._sensing: Mat3 | None = ((a, d, g), (b, e, h), (c, f, i)) if x or y or z else None
        self.axes = tuple(GyroAxis(unit, config, axis, timeline, dt_s, seed) for axis, unit in enumerate(GYRO_AXES))
        self._note(*self.axes)

    def sample(self, rate_b_rad_s: Vec3, step: int, t_s: float) -> Vec3:
        """Return the rates of this tick's frames [rad/s], one per axis.

        rate_b_rad_s : true rate, body axes: mean over the tick, instantaneous for the ideal preset
        step, t_s    : integration step and time of the tick
        """
        x, y, z = rate_b_rad_s if self._sensing is None else times(self._sensing, rate_b_rad_s)
        ax, ay, az = self.axes
        rates = (ax.sample(x, step, t_s), ay.sample(y, step, t_s), az.sample(z, step, t_s))
        self._note(ax, ay, az)
        return rates

    def _note(self, x: GyroAxis, y: GyroAxis, z: GyroAxis) -> None:
        self.status = (x.status, y.status, z.status)
        self.silent = (x.silent, y.silent, z.silent)
        self.bias_rad_s = (x.bias_rad_s, y.bias_rad_s, z.bias_rad_s)
        self.fault_rad_s = (x.fault_rad_s, y.fault_rad_s, z.fault_rad_s)
