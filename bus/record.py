"""Records that one stage hands to the next: plain classes with attributes, which compile well."""

from __future__ import annotations

from typing import Any

from mypy_extensions import mypyc_attr


@mypyc_attr(allow_interpreted_subclasses=True)
class Record:
    """Equal where all values are, and shown with them: for whoever looks at records from outside."""

    __slots__ = ()

    def values(self) -> dict[str, Any]:
        """Its values by name."""
        names = getattr(self, "__mypyc_attrs__", None) or type(self).__slots__  # compiled classes have no slots
        return {name: getattr(self, name) for name in names}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Record) and type(self) is type(other) and self.values() == other.values()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self.values().items())})"
