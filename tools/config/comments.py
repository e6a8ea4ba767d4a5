"""What the comment beside each field of a settings class says: the text of schema and reference."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import sys
from functools import cache


@cache
def comments_of(cls: type) -> dict[str, str]:
    """Comment at the end of each field's line (and on the lines below it), by field name; '' where there is none.

    Fields that a class shares with others carry their comment from where they stand.
    """
    result: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if dataclasses.is_dataclass(base):
            result |= _read_comments(base)
    return result


def _read_comments(cls: type) -> dict[str, str]:
    lines = inspect.getsource(sys.modules[cls.__module__]).split("\n")
    tree = ast.parse("\n".join(lines))
    body = next(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == cls.__name__)
    result = {}
    for item in body.body:
        if not isinstance(item, ast.AnnAssign) or not isinstance(item.target, ast.Name) or item.end_lineno is None:
            continue
        rest = lines[item.end_lineno - 1].encode()[item.end_col_offset :].decode()
        result[item.target.id] = re.sub(r"^#\s*", "", rest.strip())
    return result


def summary_of(cls: type) -> str:
    """First paragraph of a class's docstring, on one line."""
    return " ".join((inspect.getdoc(cls) or "").split("\n\n")[0].split())
