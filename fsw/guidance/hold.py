"""A target at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bus.units import Ge, Seconds, Vec4
from fsw.guidance.attitudes import read_attitude
from fsw.records import Target


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldConfig:
    """Point to an attitude at once and stay there: a step, which the control law takes as it can."""

    do: Literal["hold"]
    at_s: Annotated[Seconds, Ge(0)]
    target_q: Vec4 | None = None  # q_it, scalar first; normalised when read; none: where the target stands at that time


class Hold:
    """One attitude."""

    __slots__ = ("_target",)

    def __init__(self, config: HoldConfig, start: Target, t_s: float) -> None:
        """start, t_s: where the target stood before, and when. Raises ConfigError where target_q is no attitude."""
        self._target = Target(start.q_it if config.target_q is None else read_attitude("target_q", config.target_q))

    def point(self, t_s: float) -> Target:
        """Return the target."""
        return self._target
