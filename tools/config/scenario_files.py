"""Where scenario files are: a path as given, or the name of one that ships with hilsat."""

from __future__ import annotations

import difflib
from pathlib import Path

from bus.errors import UsageError

TOOLS = Path(__file__).resolve().parents[1]
SHIPPED = next((d for d in (TOOLS / "scenarios", TOOLS.parent / "scenarios") if d.is_dir()), TOOLS / "scenarios")


def list_shipped() -> list[str]:
    """Names of the scenarios that ship with hilsat."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def find_scenario(name: str) -> Path:
    """The file of a path or of a shipped name. Raises UsageError with the near miss."""
    path = Path(name)
    if path.exists() or path.suffix in (".yaml", ".yml") or "/" in name:
        return path
    shipped = SHIPPED / f"{name}.yaml"
    if shipped.exists():
        return shipped
    near = difflib.get_close_matches(name, list_shipped(), 1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UsageError(f"scenario {name!r} is not a file and not shipped; {hint}there are: {', '.join(list_shipped())}")
