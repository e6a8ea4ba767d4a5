"""`hilsat recover`, `hilsat export` and `hilsat diff`: what people do with logs."""

from __future__ import annotations

from typing import Any

from tools.log import diff, export, recover


def add_parser(subparsers: Any) -> None:
    """Add the three verbs to the command line."""
    for module in (recover, export, diff):
        module.add_parser(subparsers)
