"""Where scenario files are: a path as given, or the name of one that ships with hilsat."""

from __future__ import annotations

from pathlib import Path

from bus.errors import UsageError
from bus.words import suggest

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
    known = list_shipped()
    raise UsageError(
        f"scenario {name!r} is not a file and not shipped; {suggest(name, known)}there are: {', '.join(known)}"
    )


def find_shipped(name: str) -> Path | None:
    """The file of a shipped scenario by its name, with or without `.yaml`; None when there is none."""
    stem = name.removesuffix(".yaml")
    return SHIPPED / f"{stem}.yaml" if stem in list_shipped() else None
