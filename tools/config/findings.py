"""What was found wrong in a scenario, and where: file, line, column, key, message, the line itself with a caret."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

MAX_EXCERPT = 120  # characters of a source line shown under a message


@dataclass(frozen=True)
class Source:
    """One text that a scenario was read from. `overrides`: the words of `--set`, not a file."""

    name: str
    text: str = field(repr=False)
    overrides: bool = False

    @cached_property
    def lines(self) -> list[str]:
        """Lines of the text, without their ends."""
        return [line.rstrip("\r") for line in self.text.split("\n")]

    def line(self, number: int) -> str:
        """Line by number, from 1, without its end ('' past the last)."""
        return self.lines[number - 1] if 0 < number <= len(self.lines) else ""


@dataclass(frozen=True, slots=True)
class Place:
    """Where something stands: line and column count from 1; line 0 is the source as a whole."""

    source: Source
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        if self.source.overrides or not self.line:
            return self.source.name
        return f"{self.source.name}:{self.line}:{self.column}"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing wrong. `str()` gives `file:line:col: key.path: message`, then the line and a caret."""

    place: Place
    key: str
    message: str

    @property
    def headline(self) -> str:
        return ": ".join(part for part in (str(self.place), self.key, self.message) if part)

    @property
    def excerpt(self) -> str:
        """The line in question with a caret under it ('' where there is none)."""
        if not self.place.line or self.place.source.overrides:
            return ""
        line, column = self.place.source.line(self.place.line), self.place.column
        start = max(0, column - MAX_EXCERPT + 20)
        shown = line[start : start + MAX_EXCERPT].replace("\t", " ")
        return f"  | {shown}\n  | {' ' * (column - 1 - start)}^"

    def __str__(self) -> str:
        return "\n".join(part for part in (self.headline, self.excerpt) if part)

    def as_dict(self) -> dict[str, object]:
        """JSON form, for editors and scripts."""
        return {
            "file": self.place.source.name,
            "line": self.place.line,
            "column": self.place.column,
            "key": self.key,
            "message": self.message,
        }
