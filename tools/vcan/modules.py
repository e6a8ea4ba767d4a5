"""Kernel modules in an unpacked package: where they are, and the order in which they load."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

DEPENDS = re.compile(rb"\0depends=([^\0]*)\0")


def find_modules(root: Path) -> dict[str, Path]:
    """Return the uncompressed modules below a directory by name, `_` and `-` being the same."""
    return {spell(path.stem): path for path in sorted(root.rglob("*.ko"))}


def order_modules(found: Mapping[str, Path], wanted: Iterable[str]) -> list[str]:
    """Return the paths of the wanted modules and of all that they need, needs first. Built-in ones are left out."""
    order: list[str] = []

    def visit(name: str) -> None:
        path = found.get(spell(name))
        if path is None or str(path) in order:
            return
        for need in read_needs(path):
            visit(need)
        order.append(str(path))

    for name in wanted:
        visit(name)
    return order


def read_needs(path: Path) -> list[str]:
    """Return the names of the modules that a module's .modinfo section says it depends on."""
    match = DEPENDS.search(path.read_bytes())
    return [name for name in match[1].decode().split(",") if name] if match else []


def spell(name: str) -> str:
    return name.replace("-", "_")
