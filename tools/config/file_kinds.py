"""What a YAML file is meant as: a scenario, or a campaign of many runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from tools.config.findings import Source
from tools.config.merge import read_text_file
from tools.config.yaml_nodes import Node, read_yaml

CAMPAIGN_KEYS: Final = ("base", "axes", "samples", "repeats", "where", "strategy", "combine")
SCENARIO_KEYS: Final = ("plant", "fsw", "duration_s", "faults", "clock", "bus")


def is_campaign(path: Path) -> bool:
    """Whether a file is meant as a campaign: it has keys of one and none of a scenario, or lies among campaigns."""
    text, complaint = read_text_file(os.fspath(path))
    if text is None or complaint:
        return False
    node, _ = read_yaml(Source(os.fspath(path), text))
    if node is None or not isinstance(node.value, dict):
        return path.parent.name == "campaigns"
    keys: dict[str, Node] = node.value
    return any(key in keys for key in CAMPAIGN_KEYS) and not any(key in keys for key in SCENARIO_KEYS)
