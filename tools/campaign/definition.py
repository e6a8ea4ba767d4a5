"""A campaign file to a `Campaign`: read, overridden, checked; every problem at its place. docs/campaigns.md has all keys."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from bus.errors import ConfigError, UsageError
from bus.words import suggest
from tools.campaign.campaign import Campaign
from tools.campaign.inspection import inspect
from tools.config.scenario_files import SHIPPED

CAMPAIGNS = SHIPPED / "campaigns"
TRIED_TO_FLY = 40  # runs that are tried out before a campaign is flown; `hilsat check` tries more


def load_campaign(path: str | Path, overrides: Sequence[str] = ()) -> Campaign:
    """The campaign of a file, with `key.path=value` overrides applied.

    Raises ConfigError with every problem found, each as `file:line:col: key.path: message` and the line with a caret.
    """
    found = inspect(os.fspath(path), overrides, TRIED_TO_FLY)
    if found.campaign is None:
        more = [f"and {found.unlisted} more problems"] if found.unlisted else []
        raise ConfigError(*map(str, found.findings), *more)
    return found.campaign


def list_campaigns() -> list[str]:
    """Names of the campaigns that ship with hilsat."""
    return sorted(path.stem for path in CAMPAIGNS.glob("*.yaml"))


def find_campaign(name: str) -> Path:
    """The file of a path or of a shipped name. Raises UsageError with the near miss."""
    path = Path(name)
    if path.exists() or path.suffix in (".yaml", ".yml") or "/" in name:
        return path
    known = list_campaigns()
    if name in known:
        return CAMPAIGNS / f"{name}.yaml"
    raise UsageError(
        f"campaign {name!r} is not a file and not shipped; {suggest(name, known)}there are: {', '.join(known) or 'none'}"
    )
