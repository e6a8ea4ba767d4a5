"""Expressions over the axes of a campaign: constraints, and axes that are computed from others.

Numbers, texts, names of axes, + - * / % **, comparisons, `in`, `and`, `or`, `not`, and the functions of FUNCTIONS. Evaluated
over a syntax tree with nothing but the listed node types.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from bus.words import LONGEST, suggest

FUNCTIONS: Final[dict[str, Callable[..., Any]]] = {
    "abs": abs, "min": min, "max": max, "round": round, "floor": math.floor, "sqrt": math.sqrt, "exp": math.exp,
    "log": math.log, "sin": math.sin, "cos": math.cos,
}  # fmt: skip
COMPARE: Final[dict[type[ast.cmpop], Callable[[Any, Any], bool]]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt,
    ast.GtE: operator.ge, ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}  # fmt: skip
COMBINE: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: math.pow,
    ast.Mod: math.fmod,
}  # fmt: skip
MOST_NODES: Final = 500


class FormulaError(ValueError):
    """An expression that is none, or that has no value for the values it was given."""


@dataclass(frozen=True, slots=True)
class Formula:
    """One expression, read once."""

    text: str
    body: ast.expr
    names: tuple[str, ...]  # of axes, in the order in which they stand

    def evaluate(self, values: Mapping[str, Any]) -> Any:
        """Its value. Raises FormulaError where there is none: text less than a number, a division by 0."""
        try:
            return _evaluate(self.body, values)
        except (ArithmeticError, TypeError, ValueError) as error:
            shown = ", ".join(f"{name} = {str(values[name])[:LONGEST]}" for name in self.names if name in values)
            raise FormulaError(f"has no value for {shown or 'these numbers'}: {error}") from None


def parse_formula(text: str, axes: Collection[str], computed: Collection[str] = ()) -> Formula:
    """The formula of a text. Raises FormulaError with what is wrong in it.

    axes     : names that may stand in it
    computed : names of axes that may not, because they follow from others themselves
    """
    try:
        body = ast.parse(text.strip(), mode="eval").body
        nodes = list(ast.walk(body))
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise FormulaError(f"is not an expression: {getattr(error, 'msg', None) or error}") from None
    if len(nodes) > MOST_NODES:
        raise FormulaError(f"is too long: {len(nodes)} terms, at most {MOST_NODES}")
    called = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
    for node in nodes:
        _check_node(node)
        if isinstance(node, ast.Name) and id(node) not in called and node.id in computed:
            raise FormulaError(f"{node.id} is computed itself; a formula takes axes that are not")
        if isinstance(node, ast.Name) and id(node) not in called and node.id not in axes:
            raise FormulaError(
                f"there is no axis {node.id[:LONGEST]}; {suggest(node.id, axes)}there are: {', '.join(axes) or 'none'}"
            )
    names = [node.id for node in nodes if isinstance(node, ast.Name) and id(node) not in called]
    return Formula(text, body, tuple(dict.fromkeys(names)))


def list_compared(formula: Formula) -> list[tuple[str, Any]]:
    """Axis and constant of every comparison for equality: what the axis should be able to be."""
    found = []
    for node in ast.walk(formula.body):
        if not isinstance(node, ast.Compare) or not all(isinstance(op, EQUALITY) for op in node.ops):
            continue
        sides = [node.left, *node.comparators]
        names = [side.id for side in sides if isinstance(side, ast.Name)]
        for side in sides:
            parts = side.elts if isinstance(side, ast.List | ast.Tuple) else [side]
            found += [(name, p.value) for name in names for p in parts if isinstance(p, ast.Constant)]
    return found


EQUALITY: Final = (ast.Eq, ast.NotEq, ast.In, ast.NotIn)
_NODES: Final = (
    ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant, ast.Compare, ast.BoolOp, ast.And, ast.Or, ast.Not,
    ast.USub, ast.UAdd, ast.List, ast.Tuple, *COMPARE, *COMBINE,
)  # fmt: skip


def _check_node(node: ast.AST) -> None:
    if isinstance(node, ast.Attribute):
        raise FormulaError(f"{ast.unparse(node)[:LONGEST]}: signals are not known here, only axes")
    if not isinstance(node, _NODES):
        raise FormulaError(f"{type(node).__name__} is not allowed in it")
    if isinstance(node, ast.Constant) and type(node.value) not in (int, float, str, bool):
        raise FormulaError(f"{str(node.value)[:LONGEST]!r} is neither a number nor a text")
    if isinstance(node, ast.Call):
        name = node.func.id if isinstance(node.func, ast.Name) else "this"
        if name not in FUNCTIONS or node.keywords:
            raise FormulaError(f"function {name[:LONGEST]} is not known; there are: {', '.join(FUNCTIONS)}")


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant():
            return node.value
        case ast.Name():
            return values[node.id]
        case ast.List() | ast.Tuple():
            return [_evaluate(item, values) for item in node.elts]
        case ast.BoolOp():
            results = (bool(_evaluate(part, values)) for part in node.values)
            return all(results) if isinstance(node.op, ast.And) else any(results)
        case ast.UnaryOp():
            inner = _evaluate(node.operand, values)
            if isinstance(node.op, ast.Not):
                return not inner
            return -_number(inner) if isinstance(node.op, ast.USub) else _number(inner)
        case ast.BinOp():
            return COMBINE[type(node.op)](_number(_evaluate(node.left, values)), _number(_evaluate(node.right, values)))
        case ast.Compare():
            sides = [_evaluate(side, values) for side in (node.left, *node.comparators)]
            return all(COMPARE[type(op)](a, b) for op, a, b in zip(node.ops, sides, sides[1:], strict=False))
        case ast.Call(func=ast.Name(id=name)):
            return FUNCTIONS[name](*(_number(_evaluate(item, values)) for item in node.args))
    raise FormulaError(f"{type(node).__name__} is not allowed in it")


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{str(value)[:LONGEST]!r} is not a number")
    if isinstance(value, int) and abs(value) > 2**53:
        raise ValueError(f"{str(value)[:LONGEST]} is too large")
    return value
