"""Observers of the lumped fault torque: what acts on the body beside the commanded torque."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fsw.config import ModelConfig
from fsw.observers.ilo import Ilo
from fsw.observers.none import NoObserver
from fsw.records import Observer

# kind in the settings -> factory(config, model)
REGISTRY: dict[str, Callable[[Any, ModelConfig], Observer]] = {
    "ilo": Ilo,
    "none": NoObserver,
}
