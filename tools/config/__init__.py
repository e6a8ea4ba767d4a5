"""Scenarios: YAML files read, checked and resolved into what each process of a run is told.

`load_scenario(path)` gives a `Resolved`, or raises ConfigError with every problem found.
"""

from __future__ import annotations

from tools.config.loader import Examination, examine, examine_text, load_scenario, load_text
from tools.config.scenario import Resolved, Scenario

__all__ = [
    "Examination",
    "Resolved",
    "Scenario",
    "examine",
    "examine_text",
    "load_scenario",
    "load_text",
]
