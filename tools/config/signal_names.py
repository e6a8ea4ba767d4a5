"""Which signals a run logs, so that a misspelt one is found before the run and not after it."""

from __future__ import annotations

import ast
from functools import cache

from bus.words import nearest

# Topics whose fields depend on the control law and the detector that fly; the grader looks at what was logged.
OPEN_TOPICS = ("fsw.law", "fsw.detector", "fsw.estimator", "fsw.observer_state", "fsw.wheel_state", "fsw.allocator")


@cache
def list_signals() -> dict[str, tuple[str, ...]]:
    """Fields of every topic that all runs log, by the topic's name as expressions write it: truth.attitude."""
    from fsw.telemetry import CONTROL_TOPICS, TICK_TOPICS
    from plant_server.truth import TRUTH_FIELDS

    signals = {f"truth.{group}": tuple(field[0] for field in fields) for group, fields in TRUTH_FIELDS.items()}
    for topic in (*TICK_TOPICS, *CONTROL_TOPICS):
        signals[topic.name.strip("/").replace("/", ".")] = tuple(field.name for field in topic.fields)
    return signals


def check_names(signal: str) -> list[str]:
    """What is wrong with the names in a well-formed signal expression."""
    names = [node for node in ast.walk(ast.parse(signal.strip(), mode="eval")) if isinstance(node, ast.Attribute)]
    inner = {id(node.value) for node in names}
    return [word for node in names if id(node) not in inner and (word := _check_name(node))]


def _check_name(node: ast.Attribute) -> str | None:
    topic, known = ast.unparse(node.value), list_signals()
    if topic in OPEN_TOPICS or node.attr in known.get(topic, ()):
        return None
    if topic.count(".") != 1:
        return f"{topic}.{node.attr} is not a signal; its form is topic.field, such as truth.attitude.error_deg"
    topics = (*known, *OPEN_TOPICS)
    word, choices = (node.attr, known[topic]) if topic in known else (topic, topics)
    what = f"{topic} has no field {word}" if topic in known else f"there is no topic {word}"
    guess = nearest(word, choices)
    hint = f' did you mean "{guess}"?' if guess else ""
    return f"{what};{hint} there are: {', '.join(choices)}"
