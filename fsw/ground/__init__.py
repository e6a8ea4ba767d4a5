"""The flight software as a MAVLink vehicle: what it says to the ground, and what the ground may tell it."""

from __future__ import annotations

from fsw.ground.vehicle_link import FswGround, open_ground

__all__ = ["FswGround", "open_ground"]
