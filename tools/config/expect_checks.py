"""What is wrong with an expectation beyond its single values: its signal, its times, what it compares.

Each check takes the keys that are sound, so that one wrong key does not hide what is wrong with the others.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

from tools.config.expect import SIGNAL_FUNCTIONS, condition_of
from tools.config.signal_names import Topics, check_names

Found = Iterator[tuple[str, str]]  # (key, message)

HOLDING = ("below", "above", "within", "equals")
TIMES = ("from_s", "until_s", "by_s", "at_s", "not_before_s", "within_s")
EITHER = {"count": ("at_most", "at_least"), "event_count": ("at_most", "at_least"), "mean": ("lower", "upper")}
ORDERED = (("lower", "upper"), ("at_least", "at_most"))
NO_CONDITION = "is no condition; it compares, such as fsw.executive.mode == 4"
NOTHING_SOUND = (NO_CONDITION, "is not an expression")
LARGEST = 1e12  # of a number in a signal

_ALLOWED_NODES = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Attribute, ast.Name, ast.Load, ast.Constant, ast.Subscript,
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd,
    ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.BoolOp, ast.And, ast.Or, ast.Not,
)  # fmt: skip


def check_expectation(item: Mapping[str, Any], duration_s: float | None) -> list[tuple[str, str]]:
    """What is wrong with an expectation, (key, message) for each.

    item       : its sound keys and their values, defaults included
    duration_s : of the run; None: not known
    """
    problems = check_expressions(item)
    problems += _check_moment(item, "after")
    if condition_of(item.get("until")) is None:
        problems += _check_moment(item, "until")
    if item.get("check") == "settles":
        problems += _check_settles(item)
    problems += _check_limits(item)
    problems += _check_ends(item, duration_s)
    problems += _check_window(item, duration_s)
    return problems


def _sound(item: Mapping[str, Any], *keys: str) -> bool:
    return all(key in item for key in keys)


def _check_moment(item: Mapping[str, Any], key: str) -> Found:
    word, _, rest = (item.get(key) or "event x").partition(" ")
    if word not in ("fault", "event") or not rest.strip():
        yield key, f"{item[key]!r} is neither `fault NAME` (id, unit or kind) nor `event WORDS`"


def _check_limits(item: Mapping[str, Any]) -> Found:
    either = EITHER.get(item.get("check", ""))
    if either is not None and _sound(item, *either) and all(item[key] is None for key in either):
        yield "check", f"{item['check']} needs {either[0]} or {either[1]}"
    for low, high in ORDERED:
        if item.get(low) is not None and item.get(high) is not None and item[low] > item[high]:
            yield low, f"{item[low]} is above {high}, {item[high]}"


def _check_settles(item: Mapping[str, Any]) -> Found:
    times = ("by_s", "not_before_s", "at_s")
    if _sound(item, *times) and all(item[key] is None for key in times):
        yield "check", "settles needs by_s, not_before_s or at_s"
    if _sound(item, "at_s", "tolerance_s") and (item["at_s"] is None) != (item["tolerance_s"] is None):
        yield "at_s", "at_s and tolerance_s go together"


def _check_ends(item: Mapping[str, Any], duration_s: float | None) -> Found:
    if duration_s is None:
        return
    for key in TIMES:
        if (value := item.get(key)) is not None and value > duration_s:
            yield key, f"{value} s is after the end of the run, {duration_s} s"


def _check_window(item: Mapping[str, Any], duration_s: float | None) -> Found:
    if not _sound(item, "from_s"):
        return
    from_s = item["from_s"]
    end_s = duration_s if item.get("until_s") is None and "until_s" in item else item.get("until_s")
    if end_s is not None and from_s >= end_s and (duration_s is None or from_s <= duration_s):
        yield "from_s", f"the window is empty: it starts at {from_s} s and ends at {end_s} s"
    if item.get("check") not in HOLDING:
        return
    by_s, for_s = item.get("by_s"), item.get("for_s")
    if by_s is not None and by_s < from_s:
        yield "by_s", f"{by_s} s is before the window starts, {from_s} s"
    if for_s is not None and end_s is not None and from_s + for_s > end_s > from_s:
        yield "for_s", f"{for_s} s does not fit into the window, {from_s} to {end_s} s"


# -- signals -------------------------------------------------------------------------------------------------------


def check_expressions(item: Mapping[str, Any], inside: Topics | None = None) -> list[tuple[str, str]]:
    """What is wrong with the signal and the conditions of an expectation: (key, message) for each.

    item, inside : as for `check_expectation` and `check_signal`
    """
    problems: list[tuple[str, str]] = []
    if "signal" in item:
        problems += check_signal(item["signal"], inside, vector=item.get("check") == "isolates")
    for key, condition in (("when", item.get("when")), ("until", condition_of(item.get("until")))):
        if condition is not None:
            words = check_condition(condition, inside)
            if key == "until" and words and words[0].startswith(NOTHING_SOUND):
                words = [f"{condition!r} is neither `fault NAME` nor `event WORDS`, and as a condition it {words[0]}"]
            problems += [(key, word) for word in words]
    return problems


def check_condition(condition: str, inside: Topics | None = None) -> list[str]:
    """What is wrong with a condition, in words."""
    tree, complaint = _parse(condition)
    if tree is None:
        return [complaint]
    body = tree.body
    compares = isinstance(body, ast.Compare | ast.BoolOp) or (
        isinstance(body, ast.UnaryOp) and isinstance(body.op, ast.Not)
    )
    if not compares:
        return [NO_CONDITION]
    return [word for _, word in check_signal(condition, inside)]


def check_signal(signal: str, inside: Topics | None = None, *, vector: bool = False) -> list[tuple[str, str]]:
    """What is wrong with a signal expression: (key, message) for each.

    inside : fields of the topics that law and detector fill, see `check_names`; None: not known yet
    vector : whether it has to be one, and not a number
    """
    tree, complaint = _parse(signal)
    if tree is None:
        return [("signal", complaint)]
    nodes = list(ast.walk(tree))
    problems = [word for node in nodes if (word := _check_node(node)) is not None]
    if not any(isinstance(node, ast.Attribute) for node in nodes):
        problems.append("names no logged signal, such as truth.attitude.error_deg")
    return [("signal", word) for word in problems or check_names(tree, inside, vector=vector)]


def _parse(signal: str) -> tuple[ast.Expression | None, str]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Python's, on words that are no good signal anyway
            return ast.parse(signal.strip(), mode="eval"), ""
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        return None, f"is not an expression: {getattr(error, 'msg', error)}"


def _check_node(node: ast.AST) -> str | None:
    if not isinstance(node, _ALLOWED_NODES):
        return f"{type(node).__name__} is not allowed; use + - * / ** [index], comparisons and functions"
    if isinstance(node, ast.Constant):
        if type(node.value) not in (int, float):
            return f"{node.value!r} is not a number"
        if not abs(node.value) <= LARGEST:  # type: ignore[arg-type]
            return f"a number in a signal can be at most {LARGEST:g}"
    elif isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or len(node.args) != 1 or node.keywords:
            return "a function is called by its name, with one argument"
        if node.func.id not in SIGNAL_FUNCTIONS:
            return f"function {node.func.id} is not known; there are: {', '.join(SIGNAL_FUNCTIONS)}"
    elif isinstance(node, ast.Subscript) and not (
        isinstance(node.slice, ast.Constant) and type(node.slice.value) is int
    ):
        return "an index is a whole number"
    return None
