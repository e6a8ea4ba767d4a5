"""From axes to points: lists crossed, covered pair by pair or drawn, the others drawn, constraints kept, repeats counted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from tools.campaign.axes import Computed, DrawnAxis
from tools.campaign.axis_lists import Axis, ListAxis
from tools.campaign.axis_values import name_value
from tools.campaign.draws import round_all
from tools.campaign.formulas import Formula, FormulaError
from tools.campaign.plan import Point
from tools.campaign.samples import Sampling, make_samples

MOST_RUNS: Final = 200_000
MOST_PAIRS: Final = 30_000  # of values, that a covering array is looked for
Item = tuple[str, Any]  # label and value
BASE: Final = "base"


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """The axes of a campaign and how they are put together. `lists` has `base` where there are several."""

    seed: int
    lists: Mapping[str, tuple[Item, ...]]
    drawn: Mapping[str, DrawnAxis]
    computed: Mapping[str, Formula]
    order: tuple[str, ...]  # names of all axes, as they stand in the file
    where: tuple[Formula, ...]
    combine: str
    sampling: Sampling
    shared: bool
    samples: int
    repeats: int

    @property
    def drawn_lists(self) -> tuple[str, ...]:
        """Lists whose values are drawn."""
        return tuple(self.lists) if self.combine == "sampled" else ()

    def list_columns(self) -> list[str]:
        """The dimensions of the unit cube, by name: those of axes with a common draw are there once."""
        names: dict[str, None] = {}
        for name in self.order:
            if name in self.drawn:
                axis = self.drawn[name]
                names |= dict.fromkeys(f"{axis.common or name}.{index}" for index in range(axis.width))
            elif name in self.drawn_lists:
                names[f"{name}.0"] = None
        return list(names)

    def place(self, combination: Mapping[str, Item], u: Mapping[str, float], repeat: int = 0) -> Point:
        """The point of a combination of lists and a place in the unit cube. Raises FormulaError."""
        items = dict(combination)
        for name in self.drawn_lists:
            listed = self.lists[name]
            items[name] = listed[min(int(u[f"{name}.0"] * len(listed)), len(listed) - 1)]
        for name, axis in self.drawn.items():
            numbers = [u[f"{axis.common or name}.{index}"] for index in range(axis.width)]
            value = round_all(axis.draw(numbers))
            items[name] = (axis.label(value), value)
        values = self.compute({name: items[name][1] for name in self.order if name in items}, items)
        labels = {name: items[name][0] if name in items else name_value(values[name]) for name in self.order}
        return Point(values={name: values[name] for name in self.order}, labels=labels, repeat=repeat)

    def compute(self, values: dict[str, Any], items: Mapping[str, Item] | None = None) -> dict[str, Any]:
        """The values, with those of the computed axes anew. Raises FormulaError."""
        labels = {} if items is None else {name: item[0] for name, item in items.items()}
        scope = make_scope(values, labels)
        return values | {name: round_all(formula.evaluate(scope)) for name, formula in self.computed.items()}

    def sample(self, u: Sequence[float]) -> Point:
        """The point at a place of the unit cube; of lists that are not drawn, the first combination."""
        columns = self.list_columns()
        if len(u) != len(columns):
            raise ValueError(f"{len(u)} numbers for {len(columns)} dimensions: {', '.join(columns)}")
        first = next(iter(self.combinations()))
        return self.place(first, dict(zip(columns, u, strict=True)))

    def combinations(self) -> Iterator[dict[str, Item]]:
        """Combinations of the lists that constraints between lists alone allow."""
        if self.combine == "sampled":
            yield {}
            return
        names = list(self.lists)
        known = [formula for formula in self.where if set(formula.names) <= set(names)]
        if self.combine == "pairwise" and len(names) > 1:
            yield from self._cover_pairs(names, known)
            return
        for items in itertools.product(*self.lists.values()):
            combination = dict(zip(names, items, strict=True))
            if allows(known, combination):
                yield combination

    def _cover_pairs(self, names: list[str], known: list[Formula]) -> Iterator[dict[str, Item]]:
        """A covering array: every pair of values of two axes that constraints allow is in one of them at least."""
        from allpairspy import AllPairs

        def is_allowed(row: Sequence[int]) -> bool:
            part = {name: self.lists[name][index] for name, index in zip(names, row, strict=False)}
            return allows([formula for formula in known if set(formula.names) <= set(part)], part)

        parameters = [list(range(len(self.lists[name]))) for name in names]
        for row in AllPairs(parameters, filter_func=is_allowed):
            yield {name: self.lists[name][index] for name, index in zip(names, row, strict=True)}

    def explain_size(self) -> str:
        """Why there are too many runs; empty when there are not. Nothing is made for it."""
        sizes = {name: len(items) for name, items in self.lists.items()}
        rest = self.samples * self.repeats
        words = " * ".join([*(f"{size} {name}" for name, size in sizes.items())] if self.combine == "grid" else [])
        if self.combine == "pairwise":
            pairs = sum(a * b for a, b in itertools.combinations(sizes.values(), 2))
            if pairs > MOST_PAIRS:
                return f"pairwise: {pairs} pairs of values are to be covered; at most {MOST_PAIRS}"
            least = math.prod(sorted(sizes.values())[-2:])
            return "" if least * rest <= MOST_RUNS else f"at least {least * rest} runs; at most {MOST_RUNS}"
        count = rest * (math.prod(sizes.values()) if self.combine == "grid" else 1)
        if count <= MOST_RUNS:
            return ""
        more = [f"{self.samples} samples"] * (self.samples > 1) + [f"{self.repeats} repeats"] * (self.repeats > 1)
        shown = " * ".join([words] * bool(words) + more)
        return f"{count if count < 1e15 else f'{float(count):.1e}'} runs ({shown}); at most {MOST_RUNS}"

    def points(self) -> list[Point]:
        """The whole plan, in order: first axis slowest, then draws, repeats fastest. Raises FormulaError."""
        combinations = list(itertools.islice(self.combinations(), MOST_RUNS + 1))
        columns = self.list_columns()
        count = self.samples if columns else 1
        u = make_samples(self.sampling, self.seed, columns, count * (1 if self.shared else len(combinations)))
        found = []
        for index, combination in enumerate(combinations):
            for sample in range(count):
                row = u[sample if self.shared else index * count + sample]
                point = self.place(combination, dict(zip(columns, map(float, row), strict=True)))
                if self.allows_point(point):
                    found += [
                        Point(values=point.values, labels=point.labels, repeat=repeat) for repeat in range(self.repeats)
                    ]
        return found

    def allows_point(self, point: Point) -> bool:
        """Whether every constraint holds."""
        scope = make_scope(point.values, point.labels)
        return all(_holds(formula, scope) for formula in self.where)


def sort_axes(axes: Mapping[str, Axis]) -> tuple[dict[str, tuple[Item, ...]], dict[str, DrawnAxis], dict[str, str]]:
    """Lists, drawn axes, and the texts of computed ones."""
    lists = {name: axis.list_items() for name, axis in axes.items() if isinstance(axis, ListAxis)}
    drawn = {name: axis for name, axis in axes.items() if isinstance(axis, DrawnAxis)}
    return lists, drawn, {name: axis.formula for name, axis in axes.items() if isinstance(axis, Computed)}


def make_scope(values: Mapping[str, Any], labels: Mapping[str, str]) -> dict[str, Any]:
    """What a formula sees: numbers and texts as they are, of other values their label."""
    return {
        name: labels.get(name, "") if isinstance(value, dict | list) else value for name, value in values.items()
    }  # fmt: skip


def allows(formulas: Sequence[Formula], combination: Mapping[str, Item]) -> bool:
    """Whether constraints between lists hold for a combination."""
    if not formulas:
        return True
    scope = make_scope(
        {name: item[1] for name, item in combination.items()}, {name: item[0] for name, item in combination.items()}
    )
    return all(_holds(formula, scope) for formula in formulas)


def _holds(formula: Formula, scope: Mapping[str, Any]) -> bool:
    try:
        answer = formula.evaluate(scope)
        if not isinstance(answer, bool):
            raise FormulaError(f"is {answer!r} and no condition; compare it with something, such as == ...")
        return bool(answer)
    except FormulaError as error:
        raise FormulaError(f"{formula.text}: {error}") from None
