"""Which points a campaign flies, and what it makes of the answers: all of a plan, until a rate is known, to a boundary."""

from __future__ import annotations

from typing import Any, Final

from bus.errors import ConfigError
from tools.campaign.plan import Strategy
from tools.campaign.strategies.boundary import BoundarySearch
from tools.campaign.strategies.indices import SobolIndices
from tools.campaign.strategies.plan import WholePlan
from tools.campaign.strategies.settings import list_problems
from tools.campaign.strategies.until import UntilKnown
from tools.campaign.strategies.worst import WorstSearch

KINDS: Final[dict[str, Any]] = {
    "plan": WholePlan,
    "until": UntilKnown,
    "boundary": BoundarySearch,
    "worst": WorstSearch,
    "indices": SobolIndices,
}


def make_strategy(campaign: Any) -> Strategy:
    """The strategy that a campaign's settings ask for. Raises ConfigError when they do not fit its axes or metrics.

    campaign : has strategy (settings), seed, axes, metrics, points() and sample(u)
    """
    settings = campaign.strategy
    if problems := list_problems(settings, campaign.axes, list(campaign.metrics)):
        raise ConfigError(*(f"{campaign.name}: strategy.{key}: {words}" for key, words in problems))
    strategy: Strategy = KINDS[settings.kind](settings, campaign)
    return strategy
