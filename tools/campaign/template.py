"""What a campaign sets in its scenarios: settings in which `$axis` stands for the value of an axis.

$axis               as a whole value: the axis' value, whatever it is
... $axis ...       inside a text: the value as text (the label, where the value is a mapping); `$$` is a dollar sign
{$axis..., ...}     as a key without a value: the keys of the axis' value, a mapping, are merged in
[$axis..., ...]     as an entry of a list: the entries of the axis' value, a list (a mapping: one entry)
{$for t in axis: }  as a key of an entry of a list: the entry once for each value in the axis' list, `$t` being it
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from bus.settings import KeyPath
from bus.words import LONGEST
from tools.config.yaml_nodes import Node

NAME: Final = r"[A-Za-z_][A-Za-z0-9_]*"
_WHOLE: Final = re.compile(rf"\$({NAME})")
_SPREAD: Final = re.compile(rf"\$({NAME})(?:\.\.\.)?")
_FOR: Final = re.compile(rf"\$for ({NAME}) in ({NAME})")
_INSIDE: Final = re.compile(rf"\$(?:(\$)|({NAME})|\{{({NAME})\}})")


class TemplateError(ValueError):
    """A template and a value that do not go together; the path says where."""

    def __init__(self, path: KeyPath, words: str) -> None:
        super().__init__(words)
        self.path = path


@dataclass(frozen=True, slots=True)
class Values:
    """The values of a run, and what they are called inside texts."""

    values: Mapping[str, Any]
    labels: Mapping[str, str]


def list_names(template: Any, path: KeyPath = (), known: frozenset[str] = frozenset()) -> Iterator[tuple[str, KeyPath]]:
    """Every name that a template uses, and where."""
    if isinstance(template, str):
        for match in _INSIDE.finditer(template):
            name = match[2] or match[3]
            if name and name not in known:
                yield name, path
    elif isinstance(template, dict):
        loops = [loop for key in template if (loop := _FOR.fullmatch(key))]
        yield from ((loop[2], path) for loop in loops)
        known = known | {loop[1] for loop in loops}
        for key, item in template.items():
            if _is_spread(key, item):
                yield key[1:].removesuffix("..."), (*path, key)
            elif not _FOR.fullmatch(key):
                yield from list_names(item, (*path, key), known)
    elif isinstance(template, list):
        for index, item in enumerate(template):
            yield from list_names(item, (*path, index), known)


def render(template: Any, run: Values, path: KeyPath = ()) -> Any:
    """The template with the values of a run in it. Raises TemplateError."""
    if isinstance(template, str):
        match = _WHOLE.fullmatch(template)
        if match:
            return run.values[match[1]]
        return _INSIDE.sub(lambda m: m[1] or _say(run, m[2] or m[3]), template) if "$" in template else template
    if isinstance(template, dict):
        result: dict[str, Any] = {}
        for key, item in template.items():
            if _is_spread(key, item):
                result |= _spread_mapping(key, run, (*path, key))
            else:
                result[key] = render(item, run, (*path, key))
        return result
    if isinstance(template, list):
        return [part for index, item in enumerate(template) for part in _render_entry(item, run, (*path, index))]
    return template


def _is_spread(key: str, item: Any) -> bool:
    return item is None and _SPREAD.fullmatch(key) is not None


def _say(run: Values, name: str) -> str:
    value = run.values[name]
    if isinstance(value, str):
        return value
    return run.labels.get(name, "") if isinstance(value, dict | list) else json.dumps(value)


def _spread_mapping(key: str, run: Values, path: KeyPath) -> dict[str, Any]:
    name = key[1:].removesuffix("...")
    value = run.values[name]
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise TemplateError(path, f"{name} is {str(value)[:LONGEST]!r} where a mapping is needed, for it is merged in")
    return value


def _render_entry(item: Any, run: Values, path: KeyPath) -> list[Any]:
    if isinstance(item, str) and item.endswith("...") and (match := _SPREAD.fullmatch(item)):
        value = run.values[match[1]]
        if value is None:
            return []
        return value if isinstance(value, list) else [value]
    if isinstance(item, dict):
        for key in item:
            if loop := _FOR.fullmatch(key):
                return _render_loop(item, key, loop, run, path)
    return [render(item, run, path)]


def _render_loop(item: dict[str, Any], key: str, loop: re.Match[str], run: Values, path: KeyPath) -> list[Any]:
    word, name = loop[1], loop[2]
    inside = run.values[name]
    if not isinstance(inside, list):
        raise TemplateError((*path, key), f"{name} is {str(inside)[:LONGEST]!r} where a list is needed")
    rest = {other: value for other, value in item.items() if other != key}
    return [
        render(rest, Values({**run.values, word: value}, {**run.labels, word: str(value)}), path) for value in inside
    ]


def find_node(node: Node, path: KeyPath) -> tuple[Node, KeyPath]:
    """The node of a template that gave what stands at a path of the result, and what is left of the path inside of it.

    Of keys that are merged in, it is a node with the key itself as its value.
    """
    for depth, key in enumerate(path):
        child: Node | None = None
        if isinstance(node.value, dict):
            child = node.value.get(str(key))
            if child is None:
                for word, item in node.value.items():
                    if _is_spread(word, item.value):
                        place = item.key_place or item.place
                        return Node(word.removesuffix("..."), place, place), path[depth:]
        elif isinstance(node.value, list) and isinstance(key, int) and node.value:
            child = node.value[min(key, len(node.value) - 1)]
        if child is None:
            return node, path[depth:]
        node = child
    return node, ()


def name_whole(text: Any) -> str | None:
    """The axis that a text as a whole stands for; None when it does not."""
    match = _SPREAD.fullmatch(text) if isinstance(text, str) else None
    return match[1] if match else None
