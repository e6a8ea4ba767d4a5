"""A target at rest."""

from __future__ import annotations

from fsw.families import Guide
from fsw.guidance.attitudes import read_attitude
from fsw.guidance.settings import HoldConfig
from fsw.records import Target


class Hold(Guide):
    """One attitude."""

    __slots__ = ("_target",)

    def __init__(self, config: HoldConfig, start: Target, t_s: float) -> None:
        """start, t_s: where the target stood before, and when. Raises ConfigError where target_q is no attitude."""
        self._target = Target(start.q_it if config.target_q is None else read_attitude("target_q", config.target_q))

    def point(self, t_s: float) -> Target:
        """Return the target."""
        return self._target
