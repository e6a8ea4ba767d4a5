"""A campaign that was found sound: its points, and what each run flies."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from bus.settings import join_key
from tools.campaign.axes import Axis, Categorical, DrawnAxis
from tools.campaign.expansion import BASE, Space
from tools.campaign.file import CampaignFile
from tools.campaign.job import Metric
from tools.campaign.plan import Point, RunPlan, derive_seed
from tools.campaign.results import AxisInfo
from tools.campaign.strategies.settings import StrategySettings
from tools.campaign.template import Values, list_names, render


@dataclass(frozen=True)
class Campaign:
    """One campaign. `settings` is what its file says, `space` its axes put together."""

    path: Path
    text: str  # of its file, comments included
    settings: CampaignFile
    space: Space
    requirements: tuple[Path, ...] = ()  # files by which its runs are judged beside their scenarios' own expectations

    @property
    def name(self) -> str:
        """Short name."""
        return self.settings.name

    @property
    def title(self) -> str:
        """One line for reports."""
        return self.settings.title

    @property
    def seed(self) -> int:
        """Of all draws."""
        return self.settings.seed

    @property
    def bases(self) -> tuple[str, ...]:
        """Scenarios that runs start from, as the file names them."""
        return self.settings.base.names

    @property
    def metrics(self) -> Mapping[str, Metric]:
        """Numbers of each run beside its verdicts."""
        return self.settings.metrics.by_name

    @property
    def keep_logs(self) -> str:
        """none, failures, all, or worst N."""
        return str(self.settings.keep_logs)

    @property
    def limit_s(self) -> float | None:
        """Wall time after which a run is taken to hang [s]; None: none."""
        return self.settings.limit_s

    @property
    def strategy(self) -> StrategySettings:
        """Which points are flown."""
        return self.settings.strategy

    @cached_property
    def axes(self) -> tuple[AxisInfo, ...]:
        """What the runs differ in."""
        return describe_axes(self.settings, self.space)

    @cached_property
    def _points(self) -> tuple[Point, ...]:
        return tuple(self.space.points())

    def points(self) -> list[Point]:
        """The whole plan, in order."""
        return list(self._points)

    @property
    def runs(self) -> int | None:
        """How many runs there are; None: the strategy decides."""
        return len(self._points) if self.strategy.kind == "plan" else None

    @property
    def dimensions(self) -> int:
        """How many numbers `sample` takes."""
        return len(self.space.list_columns())

    def sample(self, u: Sequence[float]) -> Point:
        """The point at a place of the unit cube. A constraint that it breaks is not looked at."""
        return self.space.sample(u)

    def plan(self, number: int, point: Point) -> RunPlan:
        """What the run of this number flies at a point, to the bit. Raises TemplateError, FormulaError."""
        if self.space.computed:
            items = {name: (point.labels.get(name, ""), value) for name, value in point.values.items()}
            point = replace(point, values=self.space.compute(dict(point.values), items))
        return RunPlan(
            number=number, point=point, base=str(point.values.get(BASE, self.bases[0])),
            overrides=make_overrides(self.settings, point), seed=derive_seed(self.seed, number),
        )  # fmt: skip


def make_overrides(settings: CampaignFile, point: Point) -> tuple[str, ...]:
    """The key=value words of a point. Raises TemplateError."""
    values = Values(point.values, point.labels)
    words = [f"{key}={_write(render(item, values, (key,)))}" for key, item in settings.set.by_key.items()]
    axes = settings.axes.by_name
    return (*words, *(f"{axis.key}={_write(point.values[name])}" for name, axis in axes.items() if axis.key))


def _write(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def describe_axes(settings: CampaignFile, space: Space) -> tuple[AxisInfo, ...]:
    """The axes as reports have them, `base` first where there are several."""
    from tools.campaign.axes import KINDS

    places: dict[str, str] = {}
    for key, item in settings.set.by_key.items():
        for name, path in list_names(item, (key,)):
            shown = path[:-1] if str(path[-1]).startswith("$") else path
            places.setdefault(name, str(shown[0]) + (join_path(shown[1:]) if shown[1:] else ""))
    kinds = {kind: word for word, kind in KINDS.items()}
    found = [AxisInfo(name=BASE, kind="values", labels=settings.base.names)] if BASE in space.lists else []
    for name, axis in settings.axes.by_name.items():
        found.append(
            AxisInfo(
                name=name,
                kind=kinds[type(axis)],
                key=axis.key or places.get(name, ""),
                unit=axis.unit,
                labels=_list_labels(name, axis, space),
            )
        )
    return tuple(found)


def join_path(path: Sequence[str | int]) -> str:
    """What stands behind the first key of a path: [0].unit."""
    text = join_key(tuple(path))
    return text if text.startswith("[") else f".{text}"


def _list_labels(name: str, axis: Axis, space: Space) -> tuple[str, ...]:
    if isinstance(axis, Categorical):
        return axis.categorical.labels
    return () if isinstance(axis, DrawnAxis) or name not in space.lists else tuple(k for k, _ in space.lists[name])
