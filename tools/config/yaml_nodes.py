"""YAML text to nodes that remember where they stand. Words mean what YAML 1.2 says, and nothing is dropped silently.

PyYAML follows YAML 1.1: it reads 1e-3 as text, `on` as true and 012 as ten, and keeps the last of two equal keys
without a word. Here its parser is used, and the meaning of plain words is set anew (YAML 1.2.2, 10.3.2).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml

from bus.settings import KeyPath, join_key
from bus.words import LONGEST, describe
from tools.config.findings import Finding, Place, Source

MAX_NODES = 50_000  # values of a text, aliases unfolded: a scenario has a few hundred
MAX_DEPTH = 50  # mappings and lists inside each other: a scenario has five
MAX_FINDINGS = 100  # that are kept of one text; more are counted
LONGEST_KEY, LONGEST_NUMBER = 200, 400  # characters
LONGEST_EXPLAINED = 8_000  # characters of a broken text that the slow parser may look at for its better words

UNREADABLE = (yaml.YAMLError, RecursionError, ValueError)


class _TooMuch(yaml.YAMLError):
    """A text that nests or holds more than any scenario; carries the mark and the words."""

    def __init__(self, mark: Any, words: str) -> None:
        super().__init__(words)
        self.problem_mark, self.problem = mark, words


_TAG = "tag:yaml.org,2002:"
_BaseLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the C parser is ten times faster, where it exists
_BaseDumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_WORDS = (
    ("null", r"^(?:~|null|Null|NULL|)$", ("~", "n", "N", "")),
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", tuple("tTfF")),
    ("int", r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", tuple("-+0123456789")),
    (
        "float",
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        tuple("-+.0123456789"),
    ),
    ("merge", r"^<<$", ("<",)),
)


def _add_words(cls: Any) -> None:
    cls.yaml_implicit_resolvers = {}
    for name, pattern, first in _WORDS:
        cls.add_implicit_resolver(_TAG + name, re.compile(pattern), first)


class _Loader(_BaseLoader):  # type: ignore[misc]
    """PyYAML's parser with the words of YAML 1.2."""


class _PlainLoader(yaml.SafeLoader):
    """The same in pure Python: run again on a text that the C parser refused, for its better messages."""


class Dumper(_BaseDumper):  # type: ignore[misc]
    """Writes what `read_yaml` reads back as the same values: text that looks like a number gets quotes.

    Without the C emitter only text with line breaks or emoji looks different, and it reads back as the same too.
    """

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _cls in (_Loader, _PlainLoader, Dumper):
    _add_words(_cls)


def write_yaml(value: Any, dumper: Any = Dumper) -> str:
    """The text of a value in JSON types."""
    return str(yaml.dump(value, Dumper=dumper, sort_keys=False, allow_unicode=True, width=110))


@dataclass(slots=True)
class Node:
    """A value and where it stands. `value` is a scalar, a list of nodes, or a dict of nodes."""

    value: Any
    place: Place
    key_place: Place | None = None  # where the key stands, for a value in a mapping

    def copy(self) -> Node:
        """A tree of its own, with the same places."""
        value = self.value
        if isinstance(value, dict):
            value = {key: child.copy() for key, child in value.items()}
        elif isinstance(value, list):
            value = [child.copy() for child in value]
        return Node(value, self.place, self.key_place)

    def plain(self) -> Any:
        """The value alone, in JSON types."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain() for child in self.value]
        return self.value

    def locate(self, path: KeyPath, *, at_key: bool = False) -> Place:
        """Place of the value (or key) at a path; of the closest enclosing one where there is none."""
        node, found = self, 0
        for key in path:
            child: Node | None = None
            if isinstance(node.value, dict):
                child = node.value.get(key)
            elif isinstance(node.value, list) and isinstance(key, int) and key < len(node.value):
                child = node.value[key]
            if child is None:
                break
            node, found = child, found + 1
        if node.key_place is not None and (at_key or found < len(path)):
            return node.key_place
        return node.place


def read_yaml(source: Source) -> tuple[Node | None, list[Finding]]:
    """Root node of a text, None when it is empty or cannot be parsed, and what was found wrong with it."""
    root, findings = _read_kept(source)
    return (None if root is None else root.copy()), list(findings)


@lru_cache(maxsize=8)  # a campaign reads one file, and those it extends, for every run
def _read_kept(source: Source) -> tuple[Node | None, list[Finding]]:
    """The same, for nobody to change."""
    return _read(source)


def _read(source: Source) -> tuple[Node | None, list[Finding]]:
    try:
        _measure(source.text)
        root = _compose(_Loader, source.text)
    except _TooMuch as error:
        return None, [_explain(error, source)]
    except UNREADABLE as error:
        better = None if "nesting depth" in str(error) else _find_better_words(source.text)
        return None, [_explain(better or error, source)]
    if root is None:
        return None, []
    reader = _Reader(source)
    try:
        return reader.read(root, (), None), reader.list_findings()
    except _TooMuch as error:
        return None, [_explain(error, source)]


def _measure(text: str) -> None:
    """Raise _TooMuch for a text that holds or nests too much, before anything of it is kept."""
    count = depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.NodeEvent):
            count += 1
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise _TooMuch(event.start_mark, f"is nested too deeply: more than {MAX_DEPTH} levels")
        if count > MAX_NODES:
            raise _TooMuch(event.start_mark, f"the text holds more than {MAX_NODES} values")


def read_value(text: str, place: Place) -> tuple[Node, list[Finding]]:
    """Node of a value given on a command line: a list, mapping or quoted text in YAML, or else one plain word.

    So `hub:` is text there, not a mapping with an empty value.
    """
    text = text.strip()
    if text[:1] in tuple("[{\"'"):
        node, findings = _read(Source(place.source.name, text, overrides=True))
        return node or Node(None, place), findings
    reader = _Reader(place.source)
    resolver: Any = _PlainLoader("")
    tag = resolver.resolve(yaml.ScalarNode, text, (True, False))
    start = yaml.Mark(place.source.name, 0, place.line - 1, place.column - 1, None, 0)
    return reader.read(yaml.ScalarNode(tag, text, start), (), None), reader.list_findings()


def _find_better_words(text: str) -> Exception | None:
    """What the pure Python parser says about a text that the C parser refused; its marks and words are better."""
    if len(text) > LONGEST_EXPLAINED:
        return None
    try:
        _compose(_PlainLoader, text)
    except UNREADABLE as error:
        return error
    return None


def _compose(loader_class: Any, text: str) -> Any:
    loader = loader_class(text)
    try:
        return loader.get_single_node()
    finally:
        loader.dispose()


class _Reader:
    """Turns PyYAML's nodes into ours."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.findings: list[Finding] = []
        self.unlisted = 0  # findings past MAX_FINDINGS
        self.open: set[int] = set()  # nodes being read: an alias to one of them contains itself
        self.count = 0

    def add(self, place: Place, path: KeyPath, message: str) -> None:
        if len(self.findings) == MAX_FINDINGS:
            self.unlisted += 1
            return
        self.findings.append(Finding(place, join_key(path) if path else "", message))

    def list_findings(self) -> list[Finding]:
        """What was found, and how much more there is."""
        if self.unlisted:
            return [*self.findings, Finding(Place(self.source), "", f"{self.unlisted} more problems of this kind")]
        return self.findings

    def place(self, node: Any) -> Place:
        return Place(self.source, node.start_mark.line + 1, node.start_mark.column + 1)

    def read(self, node: Any, path: KeyPath, key_place: Place | None) -> Node:
        place = self.place(node)
        self.count += 1
        if self.count > MAX_NODES:
            raise _TooMuch(node.start_mark, f"aliases unfold to more than {MAX_NODES} values")
        if id(node) in self.open:
            self.add(place, path, "is an alias of something that contains it")
            return Node(None, place, key_place)
        if len(self.open) > MAX_DEPTH:
            raise _TooMuch(node.start_mark, f"is nested too deeply: more than {MAX_DEPTH} levels")
        if isinstance(node, yaml.ScalarNode):
            return Node(self.scalar(node, path), place, key_place)
        self.open.add(id(node))
        if isinstance(node, yaml.SequenceNode) and node.tag == _TAG + "seq":
            items = [self.read(child, (*path, index), None) for index, child in enumerate(node.value)]
            value: Any = items
        elif isinstance(node, yaml.MappingNode) and node.tag == _TAG + "map":
            value = self.mapping(node, path)
        else:
            self.add(place, path, f"tag {node.tag.replace(_TAG, '!!')} is not supported here")
            value = None
        self.open.discard(id(node))
        return Node(value, place, key_place)

    def mapping(self, node: Any, path: KeyPath) -> dict[str, Node]:
        children: dict[str, Node] = {}
        merged: dict[str, Node] = {}
        for key_node, value_node in node.value:
            place = self.place(key_node)
            if key_node.tag == _TAG + "merge":
                merged.update(self.merge(value_node, path))
                continue
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key is None or key_node.tag != _TAG + "str":
                got = key[:LONGEST] if key is not None else "a structure"
                self.add(place, path, f"a key must be text, got {got}")
                continue
            if len(key) > LONGEST_KEY or not key.isprintable():
                self.add(place, path, f"{describe(key)} cannot be a key: too long or not printable")
                continue
            child = self.read(value_node, (*path, key), place)
            if key in children:
                first = children[key].key_place
                self.add(place, (*path, key), f"is given twice; the first is at {first}")
            else:
                children[key] = child
        return merged | children

    def merge(self, node: Any, path: KeyPath) -> dict[str, Node]:
        """Keys that `<<: *anchor` brings in (YAML 1.1 merge key); the mapping's own keys win over them."""
        result: dict[str, Node] = {}
        for part in node.value if isinstance(node, yaml.SequenceNode) else [node]:
            if not isinstance(part, yaml.MappingNode):
                self.add(self.place(part), (*path, "<<"), "needs a mapping to take keys from")
                continue
            for key, child in (self.read(part, path, None).value or {}).items():
                result.setdefault(key, child)
        return result

    def scalar(self, node: Any, path: KeyPath) -> Any:
        text, kind = node.value, node.tag.removeprefix(_TAG)
        if kind in ("int", "float") and len(text) > LONGEST_NUMBER:
            self.add(
                self.place(node), path, f"{describe(text)} has {len(text)} characters: not a number to compute with"
            )
            return None
        try:
            if kind in ("str", "merge"):
                return text
            if kind == "null":
                return None
            if kind == "bool":
                return {"true": True, "false": False}[text.lower()]
            if kind == "int":
                return int(text, 0) if text.startswith(("0o", "0x")) else int(text, 10)
            if kind == "float":
                number = float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
                if not math.isfinite(number):
                    self.add(self.place(node), path, f"{text} is not a finite number")
                return number
        except (KeyError, ValueError):
            self.add(self.place(node), path, f"{describe(text)} cannot be read as {kind}")
            return None
        self.add(self.place(node), path, f"tag {node.tag} is not supported here")
        return None


def _explain(error: Exception, source: Source) -> Finding:
    """A parser's complaint in words, at its place."""
    if isinstance(error, yaml.reader.ReaderError):
        before = source.text[: error.position]
        place = Place(source, before.count("\n") + 1, len(before) - before.rfind("\n"))
        return Finding(place, "", f"character U+{int(error.character):04X} is not allowed in YAML")
    if isinstance(error, RecursionError):
        return Finding(Place(source), "", "is nested too deeply")
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    place = Place(source, mark.line + 1, mark.column + 1) if mark else Place(source)
    words = getattr(error, "problem", None) or str(error)
    if isinstance(error, _TooMuch):
        return Finding(place, "", words)
    if "nesting depth" in words:
        words = "is nested too deeply"
    elif "'\\t'" in words:
        words = "a tab stands where YAML wants spaces"
    elif getattr(error, "context", None):
        words = f"{words} ({error.context})"  # type: ignore[attr-defined]
    return Finding(place, "", f"not valid YAML: {words}")
