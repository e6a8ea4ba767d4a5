"""Guidance: where the body is to point at every tick, how that moves, and how far off it is."""

from __future__ import annotations

from fsw.guidance.guidance import Guidance
from fsw.guidance.timeline import GUIDES, TimelineEntry

__all__ = ["GUIDES", "Guidance", "TimelineEntry"]
