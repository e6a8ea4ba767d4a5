"""The plant on the link to the ground: it takes faults by command, and tells of every one that begins, bites and ends."""

from __future__ import annotations

from plant_server.ground.ground import PlantGround, open_ground

__all__ = ["PlantGround", "open_ground"]
