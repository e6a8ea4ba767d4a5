"""Observers of the lumped fault torque: what acts on the body beside the commanded torque."""

from __future__ import annotations

from fsw.families import Observer
from fsw.observers.ilo import Ilo
from fsw.observers.none import NoObserver
from fsw.observers.settings import IloConfig, NoObserverConfig
from fsw.registry import Registry

REGISTRY: Registry[Observer] = Registry(
    (IloConfig, Ilo),
    (NoObserverConfig, NoObserver),
)
