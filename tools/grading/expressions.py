"""Signal expressions over a log: `norm(truth.attitude.omega_bi_b_rad_s)` as one number per sample.

The meaning is stated in tools/config/expect.py. Evaluated over a syntax tree with nothing but the listed node types.
What is not a number stays none: every operation gives NaN where an operand or the result is not finite, also where the
arithmetic of floating point would hide it, as in NaN ** 0 = 1 or 1 / infinity = 0.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.errors import ConfigError, RecordError
from bus.words import nearest
from tools.log.mcap_reader import Run

Floats = NDArray[np.floating[Any]]

# functions that make one number of a vector, for all samples at once: shape (n, width) -> (n,)
ACROSS: dict[str, Callable[[Floats], Floats]] = {
    "norm": lambda v: np.sqrt(np.sum(v * v, axis=1)),
    "min": lambda v: np.min(v, axis=1),
    "max": lambda v: np.max(v, axis=1),
    "sum": lambda v: np.sum(v, axis=1),
}


@dataclass(frozen=True, slots=True)
class Series:
    """A signal over time. `values` has shape (n,) or (n, width); `t_s` None: a constant."""

    t_s: Floats | None
    values: Floats


COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
}


def evaluate(run: Run, expression: str, *, vector: bool = False) -> Series:
    """The signal that an expression describes, one number per sample; `vector`: several, shape (n, width).

    Raises ConfigError where a topic or field is not in the log (with the near miss), cannot be read, where the result is
    a vector or the expression is none.
    """
    series = evaluate_all(run, expression)
    if vector:
        if series.values.ndim != 2:
            raise ConfigError(f"signal {_shorten(expression)} is a single number, where a vector is needed")
        return series
    if series.values.ndim != 1:
        raise ConfigError(
            f"signal {_shorten(expression)} is a vector of {series.values.shape[1]}; take an element, [0], or norm(...)"
        )
    return series


def evaluate_all(run: Run, expression: str) -> Series:
    """The same for an expression that may be a vector: `values` of shape (n,) or (n, width)."""
    try:
        series = _evaluate(run, _parse(expression))
    except (ValueError, IndexError, OverflowError, TypeError) as error:
        raise ConfigError(f"signal {_shorten(expression)}: {error}") from None
    except RecordError as error:
        raise ConfigError(str(error)) from None
    except RecursionError:
        raise ConfigError(f"signal {_shorten(expression)} is nested too deeply to be evaluated") from None
    if series.t_s is None:
        raise ConfigError(f"signal {_shorten(expression)} names no logged signal, such as truth.attitude.error_deg")
    return series


def name_signals(expression: str) -> list[tuple[str, str]]:
    """Topic and field of every signal that an expression names; none for what is no expression."""
    try:
        nodes = list(ast.walk(_parse(expression)))
        inner = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
        names = [ast.unparse(n) for n in nodes if isinstance(n, ast.Attribute) and id(n) not in inner]
    except (ValueError, RecursionError):
        return []
    return [_split(name) for name in dict.fromkeys(names)]


def _parse(expression: str) -> ast.expr:
    try:
        return ast.parse(expression.strip(), mode="eval").body
    except (SyntaxError, MemoryError, RecursionError) as error:
        raise ValueError(f"is not an expression: {getattr(error, 'msg', error)}") from None


def _shorten(expression: str) -> str:
    return repr(expression if len(expression) <= 200 else expression[:197] + "...")


def _split(name: str) -> tuple[str, str]:
    topic, _, field = name.rpartition(".")
    return "/" + topic.replace(".", "/"), field


def _evaluate(run: Run, node: ast.expr) -> Series:
    if isinstance(node, ast.Constant):
        if type(node.value) not in (int, float):
            raise ValueError(f"{str(node.value)[:40]!r} is not a number")
        return Series(None, np.asarray(node.value, dtype=np.float64))
    if isinstance(node, ast.Attribute):
        return _look_up(run, ast.unparse(node))
    if isinstance(node, ast.Compare):
        sides = [_evaluate(run, part) for part in (node.left, *node.comparators)]
        pairs = zip(node.ops, sides, sides[1:], strict=False)
        return _join(ast.And(), [_compare(op, left, right) for op, left, right in pairs])
    if isinstance(node, ast.BoolOp):
        return _join(node.op, [_evaluate(run, part) for part in node.values])
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        inner = _evaluate(run, node.operand)
        return Series(inner.t_s, _none_of(np.asarray(inner.values == 0.0, np.float64), inner.values))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _evaluate(run, node.operand)
        return Series(inner.t_s, -inner.values if isinstance(node.op, ast.USub) else inner.values)
    if isinstance(node, ast.BinOp):
        return _combine(node.op, _evaluate(run, node.left), _evaluate(run, node.right))
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
        inner = _evaluate(run, node.value)
        if inner.values.ndim != 2:
            raise ValueError(f"{ast.unparse(node.value)} is not a vector")
        if type(node.slice.value) is not int:
            raise ValueError("an index is a whole number")
        return Series(inner.t_s, inner.values[:, node.slice.value])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 1:
        return _call(node.func.id, _evaluate(run, node.args[0]))
    raise ValueError(f"{ast.unparse(node)[:60]} is not allowed")


def _look_up(run: Run, name: str) -> Series:
    topic, field = _split(name)
    if topic not in run.topics:
        near = nearest(topic, run.topics)
        hint = f"did you mean {near[1:].replace('/', '.')}? " if near else ""
        raise ValueError(f"the log has no topic {topic}; {hint}there are: {', '.join(sorted(run.topics))}")
    signals = run.signals(topic)
    if field not in signals:
        near = nearest(field, signals)
        hint = f"did you mean {near}? " if near else ""
        raise ValueError(f"{topic} has no field {field}; {hint}there are: {', '.join(signals)}")
    return Series(run.t_ns(topic) * 1e-9, np.asarray(signals[field], dtype=np.float64))


def _compare(op: ast.cmpop, left: Series, right: Series) -> Series:
    """1 where the comparison holds, 0 where not."""
    if type(op) not in COMPARE:
        raise ValueError("only == != < <= > >= compare signals")
    t_s, a, b = _broadcast(left, right)
    return Series(t_s, _none_of(np.asarray(COMPARE[type(op)](a, b), np.float64), a, b))


def _join(op: ast.boolop, parts: list[Series]) -> Series:
    """All of the conditions, or any of them; none where one of them is none."""
    result = parts[0]
    for part in parts[1:]:
        t_s, a, b = _broadcast(result, part)
        both = (a != 0.0) & (b != 0.0) if isinstance(op, ast.And) else (a != 0.0) | (b != 0.0)
        result = Series(t_s, _none_of(np.asarray(both, np.float64), a, b))
    return result


def _broadcast(left: Series, right: Series) -> tuple[Floats | None, Floats, Floats]:
    """Both on the same time stamps and of shapes that combine."""
    t_s, a, b = _align(left, right)
    if a.ndim == 1 and b.ndim == 2:
        a = a[:, None]
    elif a.ndim == 2 and b.ndim == 1 and t_s is not None:
        b = b[:, None]
    return t_s, a, b


def _combine(op: ast.operator, left: Series, right: Series) -> Series:
    t_s, a, b = _broadcast(left, right)
    with np.errstate(all="ignore"):
        match op:
            case ast.Add():
                values = a + b
            case ast.Sub():
                values = a - b
            case ast.Mult():
                values = a * b
            case ast.Div():
                values = a / b
            case ast.Pow():
                values = a**b
            case _:
                raise ValueError("only + - * / ** combine signals")
    return Series(t_s, _none_of(values, a, b))


def _none_of(values: Floats, *operands: Floats) -> Floats:
    """The values, with NaN wherever one of them or of what they were made of is not finite."""
    sound = np.isfinite(values)
    for operand in operands:
        sound = sound & np.isfinite(operand)
    return values if np.all(sound) else np.where(sound, values, np.nan)


def _align(left: Series, right: Series) -> tuple[Floats | None, Floats, Floats]:
    """Both on the same time stamps: those of the slower one; of the other, the last value before or at each."""
    if left.t_s is None or right.t_s is None:
        return (left.t_s if right.t_s is None else right.t_s), left.values, right.values
    if left.t_s.shape == right.t_s.shape and np.array_equal(left.t_s, right.t_s):
        return left.t_s, left.values, right.values
    base, other = (left, right) if left.t_s.size <= right.t_s.size else (right, left)
    assert base.t_s is not None
    assert other.t_s is not None
    index = np.searchsorted(other.t_s, base.t_s, side="right") - 1
    keep = index >= 0
    base_values, other_values, t_s = base.values[keep], other.values[index[keep]], base.t_s[keep]
    return (t_s, base_values, other_values) if base is left else (t_s, other_values, base_values)


def _call(name: str, series: Series) -> Series:
    with np.errstate(all="ignore"):
        values = _apply(name, series)
    operands = (series.values,) if values.shape == series.values.shape else ()
    return Series(series.t_s, _none_of(values, *operands))


def _apply(name: str, series: Series) -> Floats:
    values = series.values
    if name in ACROSS:
        if values.ndim != 2:
            raise ValueError(f"{name} needs a vector")
        return ACROSS[name](_none_of(values))
    match name:
        case "rate":
            if series.t_s is None:
                raise ValueError("rate needs a signal")
            if not series.t_s.size:
                return values
            change = np.diff(values, axis=0, prepend=values[:1])
            step = np.diff(series.t_s, prepend=series.t_s[0] - 1.0)
            return np.asarray(change / (step if values.ndim == 1 else step[:, None]))
        case "abs":
            return np.abs(values)
        case "sqrt":
            return np.sqrt(values)
        case "deg":
            return values * (180.0 / math.pi)
        case "rad":
            return values * (math.pi / 180.0)
        case _:
            raise ValueError(f"function {name[:40]} is not known; there are: {', '.join(FUNCTIONS)}")


FUNCTIONS = (*ACROSS, "rate", "abs", "sqrt", "deg", "rad")
