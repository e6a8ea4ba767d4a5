"""Fly the whole plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tools.campaign.plan import Evaluate
from tools.campaign.strategies.answers import Space
from tools.campaign.strategies.settings import PlanSettings


class WholePlan:
    """Every run of the plan, in one batch."""

    def __init__(self, settings: PlanSettings, space: Space) -> None:
        self._space = space

    def run(self, evaluate: Evaluate) -> Mapping[str, Any]:
        """Fly all; nothing is found beside the results."""
        evaluate(self._space.points())
        return {}
