"""The kinds of fault, each registered by its own module; every module in this directory is imported, in sorted order."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

NAMES = {entry.name.partition(".")[0] for entry in Path(__file__).parent.iterdir() if entry.suffix in (".py", ".so")}
for name in sorted(NAMES - {"__init__"}):
    import_module(f"{__name__}.{name}")
