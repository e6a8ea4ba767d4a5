"""Words of messages: a value as a message shows it, and the known word that was perhaps meant."""

from __future__ import annotations

import json
from collections.abc import Iterable

LONGEST = 40  # characters of a text that a message repeats


def describe(data: object) -> str:
    """A value as a message shows it, short and on one line: what cannot be printed is escaped as JSON does it."""
    if data is None:
        return "nothing"
    if isinstance(data, bool):
        return "true" if data else "false"
    if isinstance(data, str):
        text = json.dumps(data if len(data) <= LONGEST else data[: LONGEST - 3] + "...", ensure_ascii=False)
        return text if text.isprintable() else "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)
    if isinstance(data, dict):
        return "a mapping"
    if isinstance(data, list | tuple):
        return "a list"
    if isinstance(data, int) and abs(data) >= 10**20:
        return "a huge number"
    return repr(data)


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word most like this one, None when none is close. Long words are nobody's near miss."""
    import difflib

    if len(word) > 2 * LONGEST:
        return None
    matches = difflib.get_close_matches(word, list(known), 1, 0.6)
    return matches[0] if matches else None


def suggest(word: str, known: Iterable[str]) -> str:
    """`did you mean X? ` for the known word most like this one, empty when none is close."""
    guess = nearest(word, known)
    return f"did you mean {guess}? " if guess else ""
