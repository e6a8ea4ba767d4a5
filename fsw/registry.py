"""The kinds of a family of algorithms, by the `kind` of their settings: what a scenario can choose from."""

from __future__ import annotations

import functools
import operator
import typing
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from bus.settings import fields_of
from fsw.vehicle import Vehicle

T = TypeVar("T")


class Registry(Generic[T]):
    """The kinds of one family, by the `kind` of their settings."""

    def __init__(self, *pairs: tuple[type, Callable[[Any, Vehicle, float], T]]) -> None:
        """pairs: settings class and algorithm of each kind."""
        self.kinds = {find_kind(settings): (settings, make) for settings, make in pairs}

    @property
    def settings(self) -> Any:
        """The type of a setting that chooses one of the kinds."""
        return functools.reduce(operator.or_, [settings for settings, _ in self.kinds.values()])

    def make(self, settings: Any, vehicle: Vehicle, period_s: float) -> T:
        """The algorithm that the settings ask for. Raises ConfigError or DesignError where it cannot be made."""
        return self.kinds[settings.kind][1](settings, vehicle, period_s)


def find_kind(settings: type) -> str:
    """The word that a settings class goes by."""
    word: str = typing.get_args(fields_of(settings)["kind"][0])[0]
    return word
