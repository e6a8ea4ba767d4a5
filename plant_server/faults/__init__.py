"""Faults of the plant's units: what kinds there are, one fault and its keys, and when which one acts.

A new kind is one class in a module under `kinds` (docs/plant.md, Faults).
"""

from __future__ import annotations

from plant_server.faults.effects import KINDS
from plant_server.faults.fault import Fault, check_faults, explain_times, fault_ids, make_fault
from plant_server.faults.profiles import PROFILES
from plant_server.faults.timeline import FaultEvent, FaultTimeline, ListedFault
from plant_server.faults.units import FAMILIES, GYRO_AXES, STAR_TRACKER, UNITS, WHEELS, family_of, parts_of

__all__ = [
    "FAMILIES", "GYRO_AXES", "KINDS", "PROFILES", "STAR_TRACKER", "UNITS", "WHEELS", "Fault", "FaultEvent",
    "FaultTimeline", "ListedFault", "check_faults", "explain_times", "family_of", "fault_ids", "make_fault", "parts_of",
]  # fmt: skip
