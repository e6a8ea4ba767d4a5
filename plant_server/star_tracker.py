"""Star tracker: attitude with noise at its own rate, late by its latency, blind when fast or near a bright body."""

from __future__ import annotations

import math
from collections import deque
from typing import Final, cast

from bus.attitude import IDENTITY, exp_map, multiply, rotate
from bus.record import Record
from bus.units import DEG, Vec3, Vec4
from plant_server.config import StarTrackerConfig
from plant_server.faults import STAR_TRACKER, FaultTimeline
from plant_server.faults.effects import StarEffect, StarSample
from plant_server.faults.timeline import ActiveFault, FaultChain
from plant_server.noise import open_normals

ARCSEC: Final = DEG / 3600.0  # rad per arc second
RESOLUTION: Final = 2.0**-23  # of a component in its frames: what is less does not leave the unit
NOT_VALID: Final = 15  # AGE of a frame without an attitude


class StarFrame(Record):
    """One message of the star tracker."""

    __slots__ = ("age_ticks", "q_ib")

    def __init__(self, q_ib: Vec4, age_ticks: int) -> None:
        self.q_ib = q_ib  # measured attitude; the identity when not valid
        self.age_ticks = age_ticks  # since the measurement, 0..14; NOT_VALID: the tracker is blind


class StarTracker:
    """Attitude sensor. A blind tracker still sends its frames, marked not valid; a dropped-out frame is never sent."""

    __slots__ = (
        "_boresight_b", "_chain", "_cos_exclusion", "_direction_i", "_draw", "_every", "_last_q_ib", "_latency",
        "_max_rate_squared", "_queue", "_sigma", "_timeline", "next_tick",
    )  # fmt: skip

    def __init__(self, config: StarTrackerConfig, timeline: FaultTimeline, dt_s: float, seed: int) -> None:
        self._timeline = timeline
        self._chain = cast(FaultChain[StarEffect], timeline.chains[STAR_TRACKER])
        self._every = round(1.0 / (config.rate_hz * dt_s))
        self._latency = round(config.latency_s / dt_s)
        x, y, z = config.noise_arcsec
        self._sigma: Vec3 | None = (x * ARCSEC, y * ARCSEC, z * ARCSEC) if x or y or z else None
        self._draw = open_normals(seed, STAR_TRACKER)
        self._max_rate_squared = (config.max_rate_deg_s * DEG) ** 2
        self._queue: deque[tuple[int, StarFrame]] = deque()  # tick of delivery, frame
        self._last_q_ib: Vec4 = IDENTITY  # of the last frame that was not lost, for one that repeats it
        self.next_tick = 0  # before this one nothing is measured and nothing goes out
        exclusion = config.exclusion
        self._boresight_b = self._direction_i = (0.0, 0.0, 1.0)
        self._cos_exclusion = 2.0  # nothing is excluded
        if exclusion is not None:
            self._boresight_b = _point(exclusion.boresight_b)
            self._direction_i = _point(exclusion.direction_i)
            self._cos_exclusion = math.cos(exclusion.angle_deg * DEG)

    def sample(self, tick: int, q_ib: Vec4, omega_bi_b_rad_s: Vec3, step: int, t_s: float) -> StarFrame | None:
        """Return the frame that goes out on this tick, None when none does."""
        every, queue = self._every, self._queue
        answer = None
        if tick % every == 0:
            frame: StarFrame | None = self._measure(q_ib, omega_bi_b_rad_s)
            chain, late_ticks = self._chain, 0
            if step >= chain.next_edge:
                chain.refresh(step)
            if chain.active:
                frame, late_ticks = self._pass_faults(frame, step, t_s)
            if frame is not None:
                self._last_q_ib = frame.q_ib
                due = tick + self._latency + late_ticks
                while queue and queue[-1][0] >= due:  # one that was held back for longer is overtaken, and lost
                    queue.pop()
                queue.append((due, frame))
        if queue and queue[0][0] == tick:
            answer = queue.popleft()[1]
        self.next_tick = tick - tick % every + every
        if queue and queue[0][0] < self.next_tick:
            self.next_tick = queue[0][0]
        return answer

    def _measure(self, q_ib: Vec4, omega: Vec3) -> StarFrame:
        if self._sigma is not None:  # drawn for every frame, so that a blind spell shifts nothing
            x, y, z = self._sigma
            draw = self._draw
            error = exp_map((x * draw(), y * draw(), z * draw()))
        if omega[0] * omega[0] + omega[1] * omega[1] + omega[2] * omega[2] > self._max_rate_squared:
            return StarFrame(IDENTITY, NOT_VALID)
        if self._cos_exclusion <= 1.0:
            x, y, z = rotate(q_ib, self._boresight_b)
            a, b, c = self._direction_i
            if x * a + y * b + z * c > self._cos_exclusion:
                return StarFrame(IDENTITY, NOT_VALID)
        return StarFrame(q_ib if self._sigma is None else multiply(q_ib, error), self._latency)

    def _pass_faults(self, frame: StarFrame | None, step: int, t_s: float) -> tuple[StarFrame | None, int]:
        """Return the frame as the faults leave it, None where they lose it, and for how many ticks they hold it back.

        Notes which of them first change that.
        """
        chain = self._chain
        for fault in chain.active:
            fault.bring_to(t_s)
        sample = self._disturb(None)
        shown = self._show(frame, sample)
        for fault in chain.without_effect_yet():
            without = self._disturb(fault)
            if without.late_ticks != sample.late_ticks or _differ(self._show(frame, without), shown):
                self._timeline.note_effect(fault, step)
        return shown, sample.late_ticks

    def _show(self, frame: StarFrame | None, sample: StarSample) -> StarFrame | None:
        """Return a frame as a sample's faults leave it; a blind tracker's stays what it is."""
        if sample.lost or frame is None:
            return None
        if frame.age_ticks == NOT_VALID:
            return frame
        if sample.frozen:
            return StarFrame(self._last_q_ib, frame.age_ticks)
        if sample.random is not None:
            return StarFrame(_pick_attitude(sample.random), frame.age_ticks)
        if sample.turn_b_rad == (0.0, 0.0, 0.0):
            return frame
        return StarFrame(multiply(frame.q_ib, exp_map(sample.turn_b_rad)), frame.age_ticks)

    def _disturb(self, left_out: ActiveFault[StarEffect] | None) -> StarSample:
        """Return the message after all active faults but one."""
        sample = StarSample()
        for fault in self._chain.active:
            if fault is not left_out:
                fault.effect.disturb(sample, fault.now)
        return sample


def _point(v: Vec3) -> Vec3:
    norm = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return (v[0] / norm, v[1] / norm, v[2] / norm)


def _differ(frame: StarFrame | None, other: StarFrame | None) -> bool:
    """Return whether two frames say something else."""
    if frame is None or other is None:
        return frame is not other
    a, b, c, d = frame.q_ib
    p, q, r, s = other.q_ib
    return max(abs(a - p), abs(b - q), abs(c - r), abs(d - s)) > RESOLUTION


def _pick_attitude(numbers: Vec3) -> Vec4:
    """Return the attitude that three uniform numbers on [0, 1) stand for, all attitudes alike (Shoemake 1992)."""
    a, b, c = numbers
    r, s = math.sqrt(1.0 - a), math.sqrt(a)
    t, u = 2.0 * math.pi * b, 2.0 * math.pi * c
    return (s * math.cos(u), r * math.sin(t), r * math.cos(t), s * math.sin(u))
