"""Which signals a run logs and how wide each is, so that a misspelt or misshapen one is found before the run."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import cache

from bus.words import nearest
from tools.config.signal_shapes import CONSTANT, UNKNOWN, Width, find_shape

# Topics whose fields depend on the algorithms that fly: known once these have been built
OPEN_TOPICS = (
    "fsw.law", "fsw.detector", "fsw.estimator", "fsw.observer_state", "fsw.wheel_state", "fsw.allocator",
    "fsw.null_space", "fsw.wheel_power",
)  # fmt: skip

Topics = Mapping[str, Mapping[str, int]]  # topic as expressions write it (truth.attitude) -> field -> width


@cache
def list_signals() -> dict[str, dict[str, int]]:
    """Fields of every topic that all runs log, each with how many numbers it has; and of the wire's, where there is one."""
    from fsw.telemetry import CONTROL_TOPICS, LINK_HEALTH, TICK_TOPICS
    from plant_server.can_bus.counts import BUS
    from plant_server.plant_log import COUNTERS
    from plant_server.truth import TRUTH_FIELDS

    signals = {f"truth.{group}": {row[0]: row[1] for row in fields} for group, fields in TRUTH_FIELDS.items()}
    for topic in (*TICK_TOPICS, *CONTROL_TOPICS, LINK_HEALTH, COUNTERS, BUS):
        signals[topic.name.strip("/").replace("/", ".")] = {field.name: field.count for field in topic.fields}
    return signals


def check_names(tree: ast.Expression, inside: Topics | None = None, *, vector: bool = False) -> list[str]:
    """What is wrong with names and shapes in a well-formed signal expression: the first thing found of each.

    inside : the fields of OPEN_TOPICS, as far as they have any; None: not known yet
    vector : whether it has to be one, and not a number
    """
    topics = {**list_signals(), **(inside or {})}
    problems: list[str] = []

    def look_up(node: ast.Attribute) -> Width:
        topic = name_of(node.value)
        if inside is None and topic in OPEN_TOPICS:
            return UNKNOWN
        if node.attr in topics.get(topic, ()):
            return topics[topic][node.attr]
        if not problems:
            problems.append(_explain(topic, node.attr, topics, inside))
        return UNKNOWN

    try:
        width = find_shape(tree.body, look_up)
    except ValueError as error:
        return [*problems, str(error)]
    if not problems and vector and width in (1, CONSTANT):
        problems.append("is a single number, where a vector with an element a unit is needed")
    if not problems and not vector and width not in (1, UNKNOWN, CONSTANT):
        problems.append(f"is a vector of {width}, where one number is needed; take an element, [0], or norm(...)")
    return problems


def name_of(node: ast.expr) -> str:
    """The dotted name that an expression is; `(...)` in place of what is not a name."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    parts.append(node.id if isinstance(node, ast.Name) else "(...)")
    return ".".join(reversed(parts))


def _explain(topic: str, field: str, topics: Topics, inside: Topics | None) -> str:
    if topic.count(".") != 1:
        return f"{topic}.{field} is not a signal; its form is topic.field, such as truth.attitude.error_deg"
    if topic in OPEN_TOPICS and topic not in topics:
        return f"there is no topic {topic}: what is chosen there logs nothing of its inside"
    known = tuple(topics) if inside is not None else (*topics, *OPEN_TOPICS)
    word, choices = (field, tuple(topics[topic])) if topic in topics else (topic, known)
    what = f"{topic} has no field {word}" if topic in topics else f"there is no topic {word}"
    guess = nearest(word, choices)
    hint = f' did you mean "{guess}"?' if guess else ""
    return f"{what};{hint} there are: {', '.join(choices)}"
