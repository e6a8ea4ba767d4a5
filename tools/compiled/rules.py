"""What must not stand in a module that is compiled, because mypyc would make something else of it: found by its syntax.

Each rule is a trap met in this code, and none of them is a compile error. docs/compiling.md has them in words.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

# Tables of settings are read by their annotations, which mypyc erases; the others must be there before or without a build.
NEVER = re.compile(r"(^|/)(settings|config|__init__|__main__)\.py$|^bus/build\.py$|^tools/compiled/")
FLOATS = re.compile(r"\b(float|Vec\d|Mat\d)\b")


def check_file(home: Path, name: str) -> list[str]:
    """Every problem of one module, as file:line: words."""
    problems = [f"{name}:1: must not be compiled: its kind of module is run as it is"] if NEVER.search(name) else []
    return problems + check_source(name, (home / name).read_text(encoding="utf-8"))


def check_source(name: str, text: str) -> list[str]:
    """Every problem in the text of a module."""
    found = sorted((line, words) for node in ast.walk(ast.parse(text, name)) for line, words in _check_node(node))
    return [f"{name}:{line}: {words}" for line, words in dict.fromkeys(found)]


def _check_node(node: ast.AST) -> Iterator[tuple[int, str]]:
    if isinstance(node, ast.Tuple | ast.List | ast.Set | ast.Dict | ast.Call):
        yield from _find_walrus(node)
    elif isinstance(node, ast.Subscript):
        yield from _find_effect_in_slice(node)
    elif isinstance(node, ast.AnnAssign):
        yield from _find_final_floats(node)
    elif isinstance(node, ast.ClassDef):
        yield from _find_settings(node)
    elif isinstance(node, ast.If) and "__name__" in (_names(node.test)):
        yield node.lineno, "a compiled module cannot be run with python -m"


def _find_walrus(node: ast.expr) -> Iterator[tuple[int, str]]:
    """`[x, *(x := f())]`: mypyc evaluates it in another order."""
    for part in ast.walk(node):
        if isinstance(part, ast.NamedExpr):
            inside = [n for n in ast.walk(part) if isinstance(n, ast.Name) and n.id == part.target.id]
            everywhere = [n for n in ast.walk(node) if isinstance(n, ast.Name) and n.id == part.target.id]
            if len(everywhere) > len(inside):
                yield part.lineno, f"{part.target.id} := beside another use of {part.target.id} in a display or a call"


def _find_effect_in_slice(node: ast.Subscript) -> Iterator[tuple[int, str]]:
    """`view[f(view):]`: mypyc may evaluate the bound twice. len() twice is no harm."""
    if isinstance(node.slice, ast.Slice) and isinstance(node.value, ast.Name | ast.Attribute):
        for part in ast.walk(node.slice):
            if isinstance(part, ast.NamedExpr) or (isinstance(part, ast.Call) and not _is_name(part.func, "len")):
                yield node.lineno, "a call or := in the bounds of a slice; give it a name on a line before"


def _find_final_floats(node: ast.AnnAssign) -> Iterator[tuple[int, str]]:
    """`X: Final = (1.0, 2.0)`: a NameError at its first use."""
    if "Final" not in _names(node.annotation):
        return
    inner = node.annotation.slice if isinstance(node.annotation, ast.Subscript) else None
    # An element that is not a literal may be a float as well.
    literal = isinstance(node.value, ast.Tuple) and not all(
        isinstance(leaf, ast.Constant) and not isinstance(leaf.value, float) for leaf in _leaves(node.value)
    )
    stated = inner is not None and not _is_name(inner, "float") and FLOATS.search(ast.unparse(inner)) is not None
    if literal or stated:
        yield node.lineno, "Final on a tuple of floats; leave the constant without Final"


def _find_settings(node: ast.ClassDef) -> Iterator[tuple[int, str]]:
    """Settings are built from annotations that mypyc erases."""
    for part in node.body:
        if isinstance(part, ast.AnnAssign) and "Annotated" in _names(part.annotation):
            yield part.lineno, f"{node.name} has Annotated fields; settings live in settings.py or config.py"
            return


def _leaves(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Tuple):
        for element in node.elts:
            yield from _leaves(element)
    elif isinstance(node, ast.UnaryOp):
        yield from _leaves(node.operand)
    else:
        yield node


def _names(node: ast.expr) -> set[str]:
    """Names in an expression; of a.b, b too."""
    return {
        n.id if isinstance(n, ast.Name) else n.attr for n in ast.walk(node) if isinstance(n, ast.Name | ast.Attribute)
    }


def _is_name(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name
