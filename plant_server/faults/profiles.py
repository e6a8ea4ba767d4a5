"""How a fault comes on: the level from 0, not there, to 1, fully there, over the time since its onset.

What a fault changes is base + level (value - base). A profile is one class: its keys as annotated fields, and `open`, which
starts its course in one run. It is chosen with the key `profile`, or by the keys that are given. Those that fall by chance
draw from a stream of the fault's own, as many numbers as simulated time asks for: the course is the same whatever the
integration step and whatever else is in the scenario.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

from bus.units import Ge, Gt, Le, Lt, Positive, Seconds
from plant_server.noise import Draw, open_normals, open_uniforms

WALK_STEP_S = 0.1  # between the drawn points of a random walk; straight lines join them


class Course(Protocol):
    """A profile in one run: asked for times that do not go back."""

    def level(self, elapsed_s: float) -> float:
        """Return how far the fault has come on, 0..1, so long after its onset [s]."""
        ...

    def settled(self, elapsed_s: float) -> bool:
        """Return whether the level stays what it is from so long after the onset on [s]."""
        ...


class Profile:
    """What the timeline needs of a profile; one that does not fall by chance is its own course."""

    __slots__ = ()
    switches: ClassVar[bool] = False  # none or full, nothing between: what a fault that is there or not can have
    recurs: ClassVar[bool] = False  # comes again by itself after it has gone

    @property
    def span_s(self) -> float | None:
        """After which the fault is over [s]; None: it does not end by itself."""
        return None

    def open(self, seed: int, stream: str) -> Course:
        """Return its course in the run with this seed, chance from the stream of this name."""
        raise NotImplementedError


class FixedProfile(Profile):
    """A profile without chance: the same course every time."""

    __slots__ = ()

    def open(self, seed: int, stream: str) -> Course:
        """Return itself."""
        return self

    def level(self, elapsed_s: float) -> float:
        """Return how far the fault has come on, 0..1, so long after its onset [s]."""
        raise NotImplementedError

    def settled(self, elapsed_s: float) -> bool:
        """Return whether the level stays what it is from so long after the onset on [s]."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class Step(FixedProfile):
    """There at once."""

    switches = True

    def level(self, elapsed_s: float) -> float:
        """Return 1: a fault that acts is there."""
        return 1.0

    def settled(self, elapsed_s: float) -> bool:
        """Return True."""
        return True


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearRise(FixedProfile):
    """From none to full along a straight line."""

    rise_s: Annotated[Seconds, Ge(0)]  # from none to full; 0: at once

    def level(self, elapsed_s: float) -> float:
        """Return the part of the rise that has passed, at most 1."""
        if elapsed_s >= self.rise_s or self.rise_s == 0.0:
            return 1.0
        return elapsed_s / self.rise_s if elapsed_s > 0.0 else 0.0

    def settled(self, elapsed_s: float) -> bool:
        """Return whether the rise is over."""
        return elapsed_s >= self.rise_s


@dataclass(frozen=True, slots=True, kw_only=True)
class ExponentialRise(FixedProfile):
    """Towards full as 1 - exp(-t / `tau_s`)."""

    tau_s: Annotated[Seconds, Gt(0)]  # time constant

    def level(self, elapsed_s: float) -> float:
        """Return 1 - exp(-t / tau)."""
        return -math.expm1(-elapsed_s / self.tau_s) if elapsed_s > 0.0 else 0.0

    def settled(self, elapsed_s: float) -> bool:
        """Return whether nothing is left of the way, to the last bit."""
        return elapsed_s >= 40.0 * self.tau_s  # exp(-40) is less than half an ulp of 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse(FixedProfile):
    """There at once, and over after `length_s`."""

    switches = True
    length_s: Annotated[Seconds, Gt(0)]  # fully there for so long; at least one integration step or sample

    @property
    def span_s(self) -> float | None:
        """After which the fault is over [s]."""
        return self.length_s

    def level(self, elapsed_s: float) -> float:
        """Return 1: the timeline ends it, on a whole step."""
        return 1.0

    def settled(self, elapsed_s: float) -> bool:
        """Return True."""
        return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Window(FixedProfile):
    """Up along a straight line, full for `length_s`, down along another, and over."""

    rise_s: Annotated[Seconds, Ge(0)] = 0.0  # from none to full; 0: at once
    length_s: Annotated[Seconds, Gt(0)]  # fully there for so long; at least one integration step or sample
    fall_s: Annotated[Seconds, Ge(0)] = 0.0  # from full to none; 0: at once

    @property
    def span_s(self) -> float | None:
        """After which the fault is over [s]."""
        return self.rise_s + self.length_s + self.fall_s

    def level(self, elapsed_s: float) -> float:
        """Return the height of the trapezium."""
        if elapsed_s < self.rise_s:
            return max(elapsed_s, 0.0) / self.rise_s
        after_s = elapsed_s - self.rise_s - self.length_s
        if after_s <= 0.0 or self.fall_s == 0.0:
            return 1.0
        return max(1.0 - after_s / self.fall_s, 0.0)

    def settled(self, elapsed_s: float) -> bool:
        """Return whether it has no slope left to go through."""
        return elapsed_s >= (self.rise_s + self.length_s + self.fall_s if self.fall_s > 0.0 else self.rise_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Intermittent(Profile):
    """In every `period_s` there for the part `duty`; with `jitter` each time late by chance."""

    switches = True
    recurs = True
    period_s: Annotated[Seconds, Gt(0)]  # from one coming to the next, without jitter
    duty: Annotated[float, Gt(0), Lt(1)] = 0.5  # part of each period in which it is there
    jitter: Annotated[float, Ge(0), Le(1)] = 0.0  # the most that it can be late, as part of its pause; uniform

    def open(self, seed: int, stream: str) -> Course:
        """Return its course in the run with this seed."""
        return _Spells(self, open_uniforms(seed, stream) if self.jitter > 0.0 else None)


class _Spells:
    """Course of an intermittent fault: one number of chance a period, drawn when that begins."""

    __slots__ = ("_draw", "_late_s", "_number", "_profile")

    def __init__(self, profile: Intermittent, draw: Draw | None) -> None:
        self._profile = profile
        self._draw = draw
        self._number = -1  # of the period that is under way
        self._late_s = 0.0

    def level(self, elapsed_s: float) -> float:
        """Return 1 in a spell, 0 between two."""
        profile = self._profile
        number = max(math.floor(elapsed_s / profile.period_s), 0)
        while self._draw is not None and self._number < number:
            self._late_s = self._draw() * profile.jitter * (1.0 - profile.duty) * profile.period_s
            self._number += 1
        since_s = elapsed_s - number * profile.period_s - self._late_s
        return 1.0 if 0.0 <= since_s < profile.duty * profile.period_s else 0.0

    def settled(self, elapsed_s: float) -> bool:
        """Return False: it goes on."""
        return False


@dataclass(frozen=True, slots=True, kw_only=True)
class Poisson(Profile):
    """At random moments, `rate_per_h` an hour in the mean, for `length_s` each."""

    switches = True
    recurs = True
    rate_per_h: Annotated[float, Gt(0), Le(36000)]  # mean number of spells an hour
    length_s: Annotated[Seconds, Gt(0)] = 0.5  # fully there for so long each time; spells that overlap join

    def open(self, seed: int, stream: str) -> Course:
        """Return its course in the run with this seed."""
        return _Strikes(self, open_uniforms(seed, stream))


class _Strikes:
    """Course of a Poisson process: the time from each strike to the next is exponential."""

    __slots__ = ("_draw", "_last_s", "_length_s", "_mean_s", "_next_s")

    def __init__(self, profile: Poisson, draw: Draw) -> None:
        self._draw = draw
        self._length_s = profile.length_s
        self._mean_s = 3600.0 / profile.rate_per_h
        self._last_s = -math.inf
        self._next_s = self._draw_gap()

    def _draw_gap(self) -> float:
        return -self._mean_s * math.log1p(-self._draw())

    def level(self, elapsed_s: float) -> float:
        """Return 1 while a strike lasts, else 0."""
        while self._next_s <= elapsed_s:
            self._last_s = self._next_s
            self._next_s += self._draw_gap()
        return 1.0 if elapsed_s - self._last_s < self._length_s else 0.0

    def settled(self, elapsed_s: float) -> bool:
        """Return False: the next one comes."""
        return False


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk(Profile):
    """A random walk from none, thrown back at none and at full; `sigma_per_sqrt_s` is its spread after a second."""

    sigma_per_sqrt_s: Positive  # standard deviation of the level after 1 s, growing with the square root of time

    def open(self, seed: int, stream: str) -> Course:
        """Return its course in the run with this seed."""
        return _Steps(self.sigma_per_sqrt_s, open_normals(seed, stream))


class _Steps:
    """Course of a random walk: drawn at points of simulated time, straight between them."""

    __slots__ = ("_draw", "_from", "_number", "_sigma", "_to")

    def __init__(self, sigma_per_sqrt_s: float, draw: Draw) -> None:
        self._draw = draw
        self._sigma = sigma_per_sqrt_s * math.sqrt(WALK_STEP_S)
        self._number = 0  # of the point before now
        self._from = 0.0
        self._to = self._walk(0.0)

    def _walk(self, level: float) -> float:
        """Return the level at the next point: folded back into 0..1, whatever the step."""
        place = math.fmod(abs(level + self._sigma * self._draw()), 2.0)
        return 2.0 - place if place > 1.0 else place

    def level(self, elapsed_s: float) -> float:
        """Return the level between the points on both sides."""
        place = max(elapsed_s, 0.0) / WALK_STEP_S
        number = math.floor(place)
        while self._number < number:
            self._from, self._to = self._to, self._walk(self._to)
            self._number += 1
        part = max(place - self._number, 0.0)
        return self._from + part * (self._to - self._from)

    def settled(self, elapsed_s: float) -> bool:
        """Return False: it walks on."""
        return False


# In the order in which they are tried where the key `profile` is left out: the first that takes all keys given.
PROFILES: dict[str, type[Profile]] = {
    "step": Step,
    "linear": LinearRise,
    "exp": ExponentialRise,
    "pulse": Pulse,
    "window": Window,
    "intermittent": Intermittent,
    "poisson": Poisson,
    "walk": Walk,
}
STEP = Step()
