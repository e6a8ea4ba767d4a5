"""Where the `hilsat` command starts: in our own packages, or in words about the ones that hide them.

bus, fsw, plant_server and tools are names that others use too. Nothing of ours is imported before it is known to be ours.
"""

from __future__ import annotations

import importlib.util
import os
import sys

PACKAGES = ("bus", "fsw", "plant_server", "tools")
HOME = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def main(argv: list[str] | None = None) -> int:
    """Run one verb; return the exit code: 2 when another package hides one of ours."""
    try:
        foreign = describe_foreign()
        if foreign:
            print(f"hilsat: {foreign}", file=sys.stderr)
            return 2
        from tools.cli import main as run_verb
    except KeyboardInterrupt:
        return 130
    return run_verb(argv)


def describe_foreign() -> str:
    """What Python finds in the place of one of our packages, in words; empty when all four are ours."""
    for name in PACKAGES:
        try:
            spec = importlib.util.find_spec(name)
        except (ImportError, ValueError):  # the finder of somebody else's, or a module without a spec
            spec = None
        origin = "" if spec is None or spec.origin is None else os.path.abspath(spec.origin)
        if origin != os.path.join(HOME, name, "__init__.py"):
            if not origin and spec is not None and spec.submodule_search_locations:
                origin = next(iter(spec.submodule_search_locations), "")
            return f"the package {name!r} that Python finds is not ours but {origin or 'missing'}; run in a venv"
    return ""
