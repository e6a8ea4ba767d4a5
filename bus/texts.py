"""Texts of settings as types: how long they may be, and which characters they may have.

What is said of a run ends in file names, on terminals and in reports: a text that breaks a line there could say what is
not so.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

__all__ = ["Line", "Name", "Prose", "SignalText", "Text", "explain_text"]

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


@dataclass(frozen=True, slots=True)
class Text:
    """Which texts a setting takes: up to `longest` characters, all of them printable."""

    longest: int
    lines: bool = False  # may have several
    name: bool = False  # becomes part of a file's name


SHORT = Text(1000)  # where nothing else is said

Name = Annotated[str, Text(80, name=True)]
Line = Annotated[str, Text(200)]
SignalText = Annotated[str, Text(400)]
Prose = Annotated[str, Text(10_000, lines=True)]


def explain_text(text: str, allowed: Text) -> str | None:
    """Why a setting does not take this text; None when it does."""
    if len(text) > allowed.longest:
        return f"has {len(text)} characters; at most {allowed.longest}"
    if allowed.name:
        if _NAME.fullmatch(text):
            return None
        return "is not a name; it needs letters a-z, digits, dots, dashes and underscores, and no dot or dash first"
    bad = next((c for c in text if not (c.isprintable() or (allowed.lines and c in "\n\t"))), None)
    if bad is not None:
        return f"holds the character U+{ord(bad):04X}, which cannot be printed{'' if allowed.lines else ' on a line'}"
    return None
