"""Settings files of the two processes: what cannot be read is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from bus.errors import ConfigError
from bus.settings import build_file


@dataclass(frozen=True)
class Two:
    one: int
    two: float = 2.0


def test_a_file_becomes_settings(tmp_path: Path) -> None:
    """JSON in, the dataclass out, defaults filled in."""
    path = tmp_path / "a.json"
    path.write_text('{"one": 1}')
    assert build_file(Two, path) == Two(1, 2.0)


@pytest.mark.parametrize("text", [None, "{", '{"one": 1', '{"one": 1, "three": 3}', "\xff"])
def test_an_unreadable_or_wrong_file_is_named(tmp_path: Path, text: str | None) -> None:
    """Missing, cut off, or with an unknown key: a ConfigError that starts with the path."""
    path = tmp_path / "a.json"
    if text is not None:
        path.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError, match=r"a\.json"):
        build_file(Two, path)
