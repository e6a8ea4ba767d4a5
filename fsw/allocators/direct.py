"""Direct allocation of a body torque to the four wheels: all of the torque that they can give in its direction."""

from __future__ import annotations

from typing import NamedTuple

from bus.linear import ZERO4, subtract
from bus.units import Vec3, Vec4
from fsw.allocators.attainable_set import AttainableSet
from fsw.allocators.settings import DirectAllocationConfig
from fsw.families import Allocator
from fsw.records import ONES4, Allocation, WheelHealth
from fsw.vehicle import Vehicle

SAME_SHARE = 1e-4  # change of a share below which the attainable set is kept: making it takes far longer than using it
MOST_SHOWN = 1e6  # reach as telemetry shows it of a torque that is next to nothing


class DirectInternals(NamedTuple):
    """How far the last torque was from what the wheels can give."""

    reach: float  # factor by which it could be had, less the wheels' biases; 1e6 or more counts as 1e6
    rank: float  # directions of torque that the wheels span, 0 .. 3
    facets: float  # of the attainable set
    rebuilds: float  # times that the set was made anew since the start


class Direct(Allocator):
    """The commands of the least max |u_k| / limit_k that give the torque, by the attainable set: see AttainableSet.

    Patent CN103699131B (Wang, Duan, Liu & He 2016), claim 1. A torque out of reach keeps its direction and is as long as
    can be. With wheels that span fewer than three axes, the part of the torque that lies in their span.

    A wheel that delivers a share e of its command counts as e axis, one that is dead, not available or below dead_below
    not at all, and what wheels give whatever they are told is left to the others to make up for. The shares reckoned with
    are told with the result: they differ from those of wheel health by share_min, dead_below, and by 1e-4 at most, the
    change that makes the set worth making anew.
    """

    __slots__ = ("_dead_below", "_rebuilds", "_set", "_share_min", "_shares", "_shown", "_use_health", "_wheels")

    def __init__(self, config: DirectAllocationConfig, vehicle: Vehicle, period_s: float) -> None:
        self._wheels = vehicle.wheels
        self._use_health = config.use_health
        self._dead_below = config.dead_below
        self._share_min = config.share_min
        self.reset()

    def reset(self) -> None:
        """Whole wheels again."""
        self._shares: Vec4 = ONES4
        self._set = self._make_set(ONES4)
        self._rebuilds = 0
        self._shown = MOST_SHOWN

    @property
    def internals(self) -> DirectInternals:
        """Reach of the last torque, and the set that it was held to."""
        found = self._set
        return DirectInternals(self._shown, float(found.rank), float(found.count_facets()), float(self._rebuilds))

    def allocate(self, tau_cmd_b_nm: Vec3, health: WheelHealth) -> Allocation:
        """Return wheel torques within limits [N m] for a body torque, body axes [N m]."""
        wheels, bias_nm = self._wheels, ZERO4
        if self._use_health and health.bias_nm != ZERO4:
            bias_nm = health.bias_nm
            tau_cmd_b_nm = subtract(tau_cmd_b_nm, wheels.combine(bias_nm))
        shares = self._find_shares(health)
        if shares != self._shares and self._has_changed(shares):
            self._shares = shares
            self._set = self._make_set(shares)
            self._rebuilds += 1
        reach, commands = self._set.solve(tau_cmd_b_nm)
        self._shown = reach if reach < MOST_SHOWN else MOST_SHOWN
        a, b, c, d = commands
        tau_rw_nm = (a, b, c, d)
        return Allocation(
            tau_rw_nm,
            wheels.combine(tau_rw_nm),
            1.0 - wheels.find_load(tau_rw_nm),
            self._shares,
            bias_nm,
            self._set.rank,
        )

    def _make_set(self, shares: Vec4) -> AttainableSet:
        a, b, c, d = self._wheels.max_torque_nm
        return AttainableSet(self._wheels.axes_b, shares, (-a, -b, -c, -d), (a, b, c, d))

    def _has_changed(self, shares: Vec4) -> bool:
        """Whether a share has changed by more than can be passed over, or a wheel has gone or come back."""
        for new, old in zip(shares, self._shares, strict=True):
            if abs(new - old) > SAME_SHARE or (new == 0.0) != (old == 0.0):
                return True
        return False

    def _find_shares(self, health: WheelHealth) -> Vec4:
        a, b, c, d = health.effectiveness if self._use_health else ONES4
        p, q, r, s = health.find_usable()
        return (
            self._floor(a) if p else 0.0,
            self._floor(b) if q else 0.0,
            self._floor(c) if r else 0.0,
            self._floor(d) if s else 0.0,
        )

    def _floor(self, share: float) -> float:
        """The share to reckon with: raised to share_min; nothing where it is then still below dead_below."""
        raised = share if share > self._share_min else self._share_min
        return raised if raised >= self._dead_below else 0.0
