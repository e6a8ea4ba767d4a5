"""Files that extend files, and single values set from the command line: several sources made one tree of nodes."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from bus.settings import KeyPath, join_key
from bus.texts import Text, explain_text
from bus.words import describe, nearest
from tools.config.findings import Finding, Place, Source
from tools.config.scenario_files import find_shipped
from tools.config.yaml_nodes import MAX_DEPTH, Node, read_value, read_yaml

MAX_BYTES = 1024 * 1024  # a scenario is a page or two; this is somebody's log
PATH = Text(400)
MAX_CHAIN = 10  # files that extend each other
# A mapping whose tag changes is another thing: its other keys do not carry over. (All kinds of fault share theirs.)
TAGS = ("kind", "check")

_KEY = re.compile(r"\.?(?:([0-9]{1,9})(?![^.\[\]=])|([^.\[\]=]+))|\[([0-9]{1,9})\]")  # an index, a word, [an index]


class Merger:
    """Reads sources into one tree. `findings` holds what was wrong on the way, `sources` every text read, in order.

    files : whether a text may name files; False for one that came out of a log, which carries all it needs
    """

    def __init__(self, *, files: bool = True) -> None:
        self.files = files
        self.findings: list[Finding] = []
        self.sources: list[Source] = []

    def read_file(self, path: str | Path, wanted_at: Place | None = None, chain: tuple[str, ...] = ()) -> Node | None:
        """Tree of a file and of all it extends. `wanted_at`: where another file names it."""
        name = os.fspath(path)
        if len(chain) >= MAX_CHAIN:
            self.add(wanted_at, "extends", f"is file {len(chain) + 1} in a chain; at most {MAX_CHAIN}")
            return None
        text = self._read_text(name, wanted_at)
        if text is None:
            return None
        real = os.path.realpath(name)
        if real in chain:
            self.add(wanted_at, "extends", f"{name} extends itself, by way of {' -> '.join(chain)}")
            return None
        return self.read_text(Source(name, text), (*chain, real))

    def read_text(self, source: Source, chain: tuple[str, ...] = ()) -> Node | None:
        """Tree of a text and of all it extends."""
        self.sources.append(source)
        if len(source.text) > MAX_BYTES:
            self.add(Place(source), "", f"is larger than {MAX_BYTES // 1024**2} MB: not a scenario")
            return None
        node, findings = read_yaml(source)
        self.findings += findings
        if node is None and not findings:
            self.add(Place(source), "", "is empty; a scenario needs at least name, duration_s, plant and fsw")
        if node is None:
            return None
        if not isinstance(node.value, dict):
            self.add(node.place, "", "the top level must be a mapping of keys such as name, plant, fsw")
            return None
        parent = node.value.pop("extends", None)
        if parent is None:
            return node
        if not isinstance(parent.value, str) or not parent.value:
            self.add(parent.place, "extends", "needs the path of another scenario file, relative to this one")
            return None
        if word := explain_text(parent.value, PATH):
            self.add(parent.place, "extends", f"{describe(parent.value)} {word}")
            return None
        if not self.files:
            self.add(parent.place, "extends", "is not read here: a log carries its resolved scenario, whole")
            return None
        base = self.read_file(_find_parent(source.name, parent.value), parent.place, chain)
        return merge(base, node) if base is not None else None

    def override(self, root: Node, setting: str) -> Node:
        """Tree with one value replaced, from `key.path=value`; the value is YAML."""
        source = Source(f"--set {setting}", setting, overrides=True)
        self.sources.append(source)
        key, equals, text = setting.partition("=")
        path = parse_key(key.strip())
        if not equals or path is None:
            self.add(Place(source), "", "needs the form key.path=value, such as plant.wheels[0].max_torque_nm=0.2")
            return root
        value, findings = read_value(text, Place(source, 1, 1))
        self.findings += [Finding(f.place, join_key(path), f.message) for f in findings]
        if not findings:
            value.key_place = value.place
            self._place_override(root, path, value)
        return root

    def _place_override(self, root: Node, path: KeyPath, value: Node) -> None:
        node = root
        for depth, key in enumerate(path[:-1]):
            child = self._child(node, key)
            if child is None and isinstance(node.value, dict):
                child = node.value[str(key)] = Node({}, value.place, value.key_place)
            if child is not None and isinstance(child.value, dict | list):
                node = child
                continue
            known = f"has {len(node.value)} entries" if isinstance(node.value, list) else "is a single value"
            self.add(value.place, join_key(path), f"cannot be set: {join_key(path[: depth or 1])} {known}")
            return
        last = path[-1]
        if isinstance(node.value, list):
            if not isinstance(last, int) or last >= len(node.value):
                self.add(value.place, join_key(path), f"cannot be set: the list has {len(node.value)} entries, from 0")
                return
            node.value[last] = merge(node.value[last], value)
            return
        old = node.value.get(str(last))
        if old is not None and last in TAGS and path[0] != "faults" and old.value != value.value:
            node.value = {str(last): value}
        else:
            node.value[str(last)] = merge(old, value) if old is not None else value

    @staticmethod
    def _child(node: Node, key: str | int) -> Node | None:
        if isinstance(node.value, list):
            return node.value[key] if isinstance(key, int) and key < len(node.value) else None
        child: Node | None = node.value.get(str(key))
        return child

    def _read_text(self, name: str, wanted_at: Place | None) -> str | None:
        text, complaint = read_text_file(name)
        if complaint and wanted_at is None:
            self.findings.append(Finding(Place(Source(name, "")), "", complaint))
        elif complaint:
            self.add(wanted_at, "extends", f"{name}: {complaint}")
        return text

    def add(self, place: Place | None, key: str, message: str) -> None:
        self.findings.append(Finding(place or Place(self.sources[-1]), key, message))


def _find_parent(name: str, parent: str) -> str:
    """Path of what a file extends: beside it, with `.yaml` or without; else a scenario that ships with hilsat."""
    beside = os.path.normpath(os.path.join(os.path.dirname(name), parent))
    for path in (beside, f"{beside}.yaml"):
        if os.path.isfile(path):
            return path
    shipped = None if os.path.lexists(beside) or os.path.dirname(parent) else find_shipped(parent)
    return beside if shipped is None else os.fspath(shipped)


def read_text_file(name: str) -> tuple[str | None, str]:
    """Text of a scenario file and '', or None and why it cannot be read."""
    try:
        if os.path.isfile(name) and os.path.getsize(name) > MAX_BYTES:
            return None, f"is larger than {MAX_BYTES // 1024**2} MB: not a scenario file"
        if os.path.exists(name) and not os.path.isfile(name) and not os.path.isdir(name):
            return None, "is a device or pipe, not a file"
        data = Path(name).read_bytes()
    except IsADirectoryError:
        return None, "is a directory; name a scenario file in it"
    except FileNotFoundError:
        return None, "there is no such file" + _say_nearby(name)
    except (OSError, ValueError) as error:
        return None, f"cannot be read: {getattr(error, 'strerror', None) or error}"
    try:
        return data.decode("utf-8-sig"), ""
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        return None, f"is not UTF-8 text: byte 0x{data[error.start]:02x} in line {line}; save it as UTF-8"


def merge(base: Node, over: Node) -> Node:
    """Tree in which `over` wins: mappings merge key by key, everything else is replaced as a whole."""
    if not isinstance(base.value, dict) or not isinstance(over.value, dict) or _changes_tag(base.value, over.value):
        return over
    value = dict(base.value)
    for key, child in over.value.items():
        value[key] = merge(value[key], child) if key in value else child
    return Node(value, over.place, over.key_place)


def _changes_tag(base: dict[str, Node], over: dict[str, Node]) -> bool:
    return any(tag in base and tag in over and base[tag].value != over[tag].value for tag in TAGS)


def parse_key(text: str) -> KeyPath | None:
    """Key path of `plant.wheels[2].mount` (or `plant.wheels.2.mount`); None when it is not one."""
    path: list[str | int] = []
    at = 0
    while at < len(text):
        match = _KEY.match(text, at)
        if match is None or (at == 0 and text[0] in ".["):
            return None
        number, word, index = match.groups()
        path.append(word if word is not None else int(number or index))
        at = match.end()
    return tuple(path) if 0 < len(path) <= MAX_DEPTH else None


def apply_overrides(merger: Merger, root: Node, overrides: Sequence[str]) -> Node:
    for setting in overrides:
        root = merger.override(root, setting)
    return root


def _say_nearby(name: str) -> str:
    folder = os.path.dirname(name) or "."
    try:
        files = sorted(entry for entry in os.listdir(folder) if entry.endswith((".yaml", ".yml")))
    except OSError:
        return ""
    guess = nearest(os.path.basename(name), files)
    return f'; did you mean "{os.path.join(os.path.dirname(name), guess)}"?' if guess else ""
