"""Observers of the lumped fault torque: what acts on the body beside the commanded torque."""

from __future__ import annotations

from fsw.families import Observer, Registry
from fsw.observers.ilo import Ilo, IloConfig
from fsw.observers.none import NoObserver, NoObserverConfig

REGISTRY: Registry[Observer] = Registry(
    (IloConfig, Ilo),
    (NoObserverConfig, NoObserver),
)
