"""The words of `hilsat inject`: the bare form spelt out, and KEY=VALUE made a fault as a scenario has it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from bus.errors import ConfigError, UsageError

ACTIONS: Final = ("set", "list", "catalogue", "status", "clear", "export", "completion")
WITH_VALUE: Final = (
    "--at-tick", "--at", "--for", "--until", "--id", "--profile", "--timeout", "--run", "-o", "--output", "--extends",
)  # fmt: skip


def spell_out(words: Sequence[str]) -> list[str]:
    """Return the words behind `hilsat inject` in full: `wheel.2 loss --for 2 k=1` is `set wheel.2 loss k=1 --for 2`.

    Words come ahead of options, wherever they stood.
    """
    plain, options, takes = [], [], False
    for word in words:
        if takes or word.startswith("-"):
            options.append(word)
            takes = not takes and word in WITH_VALUE
        else:
            plain.append(word)
    if not plain:
        return options
    if plain[0] not in ACTIONS:
        plain.insert(0, "set")
    return plain + options


def read_keys(settings: Sequence[str], named: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of KEY=VALUE words, values read as YAML scalars, with those of options (None: not given).

    Raises UsageError with everything that is wrong.
    """
    from tools.config.findings import Place, Source
    from tools.config.yaml_nodes import read_value

    keys: dict[str, Any] = {key: value for key, value in named.items() if value is not None}
    problems: list[str] = []
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key:
            problems.append(f"{setting}: needs the form KEY=VALUE, such as effectiveness=0.3")
        elif key in keys:
            problems.append(f"{setting}: {key} is given twice")
        else:
            node, findings = read_value(text, Place(Source(setting, setting, overrides=True), 1, 1))
            problems += [f"{setting}: {finding.message}" for finding in findings]
            keys[key] = node.plain()
    if problems:
        raise ConfigError(*problems)
    return keys


def make_request(unit: str, kind: str, settings: Sequence[str], options: dict[str, Any]) -> dict[str, Any]:
    """Return the request that sets a fault.

    options : at_s, at_tick, for_s, until_s, id, profile, wait; None where they are not given
    Raises UsageError when two of them say when it begins or ends.
    """
    _exclude(options, "at_s", "--at", "at_tick", "--at-tick")
    _exclude(options, "for_s", "--for", "until_s", "--until")
    named = {key: options[key] for key in ("at_s", "until_s", "id", "profile")}
    fault = read_keys(settings, {"unit": unit, "kind": kind, **named})
    if options["at_tick"] is not None and "at_s" in fault:
        raise UsageError("at_s and --at-tick both say when it begins; leave one out")
    if options["for_s"] is not None and "until_s" in fault:
        raise UsageError("until_s and --for both say when it ends; leave one out")
    what: dict[str, Any] = {"do": "set", "fault": fault, "wait": bool(options["wait"])}
    return what | {key: options[key] for key in ("at_tick", "for_s") if options[key] is not None}


def _exclude(options: dict[str, Any], one: str, one_word: str, other: str, other_word: str) -> None:
    if options[one] is not None and options[other] is not None:
        raise UsageError(f"{one_word} and {other_word} exclude each other; leave one out")
