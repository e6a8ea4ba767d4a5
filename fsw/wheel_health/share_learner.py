"""Learns the share of its command that each wheel delivers, from the fault torque that the observer reports."""

from __future__ import annotations

import math
from typing import Final

from bus.linear import ZERO4
from bus.units import Vec3, Vec4
from fsw.families import WheelHealthMonitor
from fsw.records import ALL_WHEELS, NO_WHEEL, FourReadings, WheelHealth
from fsw.vehicle import Vehicle
from fsw.wheel_health.settings import ShareLearnerConfig

HEALTHY_SHARES: Vec4 = (1.0, 1.0, 1.0, 1.0)
# Share of a wheel's torque: commands far below it teach nothing; there, misalignment and drag look like lost torque.
LEARN_FLOOR: Final = 0.2


class ShareLearner(WheelHealthMonitor):
    """Shares e_i by a normalised gradient step on the residual r of v = -D0 (1 - e) tau + r.

    tau are the commands seen through the observer's lag: the last one alone, against a late v, makes a loop that rings when
    the bus is one period late. What the shares do not explain of v (misalignment, bias) stays in r.
    """

    __slots__ = ("_config", "_floor_nm2", "_shares", "_tau_seen", "_wheels")

    def __init__(self, config: ShareLearnerConfig, vehicle: Vehicle, period_s: float) -> None:
        self._config = config
        self._wheels = vehicle.wheels
        self._floor_nm2 = (LEARN_FLOOR * max(vehicle.wheels.max_torque_nm)) ** 2
        self.reset()

    def reset(self) -> None:
        """Trust every wheel again."""
        self._shares = HEALTHY_SHARES
        self._tau_seen = ZERO4

    def step(
        self, dt_s: float, wheels: FourReadings, tau_rw_cmd_nm: Vec4, tau_fault_hat_b_nm: Vec3 | None
    ) -> WheelHealth:
        """Return the shares, and the part of the fault torque that they explain; without one nothing is learnt."""
        if tau_fault_hat_b_nm is None:
            self._tau_seen = tau_rw_cmd_nm
            return WheelHealth(self._shares, ALL_WHEELS, NO_WHEEL)
        config = self._config
        lag = 1.0 - math.exp(-dt_s / config.observer_lag_s)
        a, b, c, d = self._tau_seen
        new_a, new_b, new_c, new_d = tau_rw_cmd_nm
        a += lag * (new_a - a)
        b += lag * (new_b - b)
        c += lag * (new_c - c)
        d += lag * (new_d - d)
        self._tau_seen = (a, b, c, d)
        ea, eb, ec, ed = self._shares
        vx, vy, vz = tau_fault_hat_b_nm
        lx, ly, lz = self._wheels.combine(((1.0 - ea) * a, (1.0 - eb) * b, (1.0 - ec) * c, (1.0 - ed) * d))
        ra, rb, rc, rd = self._wheels.project((vx + lx, vy + ly, vz + lz))
        gain = (1.0 - math.exp(-dt_s / config.learn_s)) / (self._floor_nm2 + a * a + b * b + c * c + d * d)
        ea = _bound(ea + gain * a * ra)
        eb = _bound(eb + gain * b * rb)
        ec = _bound(ec + gain * c * rc)
        ed = _bound(ed + gain * d * rd)
        self._shares = (ea, eb, ec, ed)
        x, y, z = self._wheels.combine(((1.0 - ea) * a, (1.0 - eb) * b, (1.0 - ec) * c, (1.0 - ed) * d))
        return WheelHealth(self._shares, ALL_WHEELS, NO_WHEEL, (-x, -y, -z))


def _bound(share: float) -> float:
    return 0.0 if share < 0.0 else 1.0 if share > 1.0 else share
