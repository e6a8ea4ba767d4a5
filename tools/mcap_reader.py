"""The documented way to open a log in Python: `from tools.mcap_reader import read_run` (docs/telemetry.md)."""

from __future__ import annotations

from tools.log.mcap_reader import Run, TopicInfo, read_run

__all__ = ["Run", "TopicInfo", "read_run"]
