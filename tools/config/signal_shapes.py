"""How many numbers a signal expression gives per sample, without a log: vectors where numbers are needed are found early."""

from __future__ import annotations

import ast
from collections.abc import Callable

Width = int  # numbers per sample
UNKNOWN, CONSTANT = -1, 0  # not known before the run; a number that is the same for all samples

ACROSS = ("norm", "min", "max", "sum")  # functions that make one number of a vector


def find_shape(node: ast.expr, look_up: Callable[[ast.Attribute], Width]) -> Width:
    """Numbers per sample of a well-formed expression: CONSTANT, 1, a vector's width, or UNKNOWN.

    look_up : width of a logged signal
    Raises ValueError, in words, for an index out of range and for shapes that do not fit together.
    """
    match node:
        case ast.Attribute():
            return look_up(node)
        case ast.UnaryOp():
            return find_shape(node.operand, look_up)
        case ast.BinOp():
            return _combine(find_shape(node.left, look_up), find_shape(node.right, look_up))
        case ast.Compare():
            return _combine_all([find_shape(part, look_up) for part in (node.left, *node.comparators)])
        case ast.BoolOp():
            return _combine_all([find_shape(part, look_up) for part in node.values])
        case ast.Subscript(slice=ast.Constant(value=int(index))):
            return _take(find_shape(node.value, look_up), index)
        case ast.Call(func=ast.Name(id=name)):
            return _call(name, find_shape(node.args[0], look_up))
        case ast.Name():
            raise ValueError(f"{node.id} is not a signal; its form is topic.field, such as truth.attitude.error_deg")
    return CONSTANT


def _combine(left: Width, right: Width) -> Width:
    if UNKNOWN in (left, right):
        return UNKNOWN
    if left > 1 and right > 1 and left != right:
        raise ValueError(f"a vector of {left} and a vector of {right} do not combine")
    return max(left, right)


def _combine_all(widths: list[Width]) -> Width:
    result = widths[0]
    for width in widths[1:]:
        result = _combine(result, width)
    return result


def _take(width: Width, index: int) -> Width:
    if width == UNKNOWN:
        return 1
    if width < 2:
        raise ValueError(f"[{index}] needs a vector; there is a single number")
    if not 0 <= index < width:
        raise ValueError(f"[{index}] is out of range; the vector has {width} elements, [0] to [{width - 1}]")
    return 1


def _call(name: str, width: Width) -> Width:
    if name in ACROSS:
        if width in (CONSTANT, 1):
            raise ValueError(f"{name} needs a vector; there is a single number")
        return 1
    if name == "rate" and width == CONSTANT:
        raise ValueError("rate needs a signal; there is a constant")
    return width
