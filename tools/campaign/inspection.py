"""What is wrong with a campaign file: with its keys, between its axes, and with the scenarios that it comes to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bus.errors import UsageError
from bus.settings import KeyPath, Reading, join_key
from bus.words import describe, suggest
from tools.campaign.axes import Categorical
from tools.campaign.axis_lists import Axis, ListAxis
from tools.campaign.axis_values import name_value
from tools.campaign.campaign import Campaign, describe_axes
from tools.campaign.expansion import BASE, Item, Space, sort_axes
from tools.campaign.file import CampaignFile
from tools.campaign.formulas import Formula, FormulaError, list_compared, parse_formula
from tools.campaign.job import find_base
from tools.campaign.strategies.settings import IndicesSettings, WorstSettings, list_problems
from tools.campaign.template import list_names
from tools.campaign.trial import try_out
from tools.config.findings import Finding, Source
from tools.config.merge import Merger, apply_overrides, parse_key
from tools.config.scenario_files import SHIPPED
from tools.config.yaml_nodes import Node

MOST_FINDINGS = 100


@dataclass(frozen=True, slots=True)
class Inspection:
    """What came of a campaign file: `campaign` when nothing is wrong, else `findings`, the first MOST_FINDINGS of them."""

    path: str
    campaign: Campaign | None
    findings: tuple[Finding, ...]
    unlisted: int = 0  # findings beyond those
    tried: int = 0  # runs whose scenarios were loaded


def inspect(path: str, overrides: Sequence[str], most_tried: int) -> Inspection:
    """What came of a campaign file. Does not raise for anything that a file can contain."""
    merger = Merger()
    root = merger.read_file(path)
    if root is None:
        return _refuse(path, merger, merger.findings)
    root = apply_overrides(merger, root, overrides)
    reading = Reading(CampaignFile, root.plain())
    told = {finding.key for finding in merger.findings}
    found = [
        Finding(root.locate(p.path, at_key=p.at_key), join_key(p.path), p.message)
        for p in reading.problems
        if join_key(p.path) not in told
    ]
    found += merger.findings
    if found:
        return _refuse(path, merger, found)
    check = _Check(path, root, reading.value)
    campaign = check.make(join_texts(merger.sources))
    tried, more = (0, []) if campaign is None or check.found else try_out(campaign, root, most_tried)
    if check.found or more or campaign is None:
        return _refuse(path, merger, [*check.found, *more])
    return Inspection(path, campaign, (), 0, tried)


def join_texts(sources: Sequence[Source]) -> str:
    """The text of a campaign's file, and as comments behind it of those that it extends: another file, another text."""
    files = [source for source in sources if not source.overrides]
    extended = [f"# {source.name}\n" + "".join(f"# {line}\n" for line in source.lines) for source in files[1:]]
    return "\n".join([files[0].text, *extended])


def _refuse(path: str, merger: Merger, findings: list[Finding]) -> Inspection:
    order = {source.name: index for index, source in enumerate(merger.sources)}
    ranked = sorted(findings, key=lambda f: (order.get(f.place.source.name, 99), f.place.line, f.place.column))
    return Inspection(path, None, tuple(ranked[:MOST_FINDINGS]), max(0, len(ranked) - MOST_FINDINGS))


class _Check:
    """Checks between the keys of a file; collects what is found."""

    def __init__(self, path: str, root: Node, settings: CampaignFile) -> None:
        self.path, self.root, self.settings = Path(path), root, settings
        self.found: list[Finding] = []

    def add(self, path: KeyPath, message: str, *, at_key: bool = False) -> None:
        self.found.append(Finding(self.root.locate(path, at_key=at_key), join_key(path), message))

    def make(self, text: str) -> Campaign | None:
        """The campaign; None when something was found that keeps its points from being made."""
        settings = self.settings
        requirements = tuple(p for i, name in enumerate(settings.requirements) if (p := self._find_file(i, name)))
        self._check_bases()
        self._check_common()
        self._check_use()
        space = self._make_space()
        campaign = Campaign(self.path, text, settings, space, requirements)
        self._check_strategy(space)
        if word := space.explain_size():
            self.add(("axes",) if settings.axes.by_name else ("samples",), word, at_key=True)
        if self.found:
            return None
        self._check_points(campaign)
        return campaign

    def _make_space(self) -> Space:
        settings = self.settings
        lists, drawn, texts = sort_axes(settings.axes.by_name)
        if len(settings.base.names) > 1:
            lists = {BASE: tuple((name, name) for name in settings.base.names), **lists}
        order = tuple(([BASE] if BASE in lists else []) + list(settings.axes.by_name))
        plain = [name for name in order if name not in texts]
        computed = {}
        for name, text in texts.items():
            if (formula := self._parse(("axes", name, "formula"), text, plain, list(texts))) is not None:
                computed[name] = formula
        where = [self._parse(("where", index), text, order) for index, text in enumerate(settings.where)]
        for index, formula in enumerate(where):
            self._check_words(index, formula, lists)
        return Space(
            seed=settings.seed, lists=lists, drawn=drawn, computed=computed, order=order,
            where=tuple(formula for formula in where if formula is not None), combine=settings.combine,
            sampling=settings.sampling, shared=settings.draws == "shared", samples=settings.samples,
            repeats=settings.repeats,
        )  # fmt: skip

    def _parse(self, path: KeyPath, text: str, names: Sequence[str], computed: Sequence[str] = ()) -> Formula | None:
        try:
            return parse_formula(text, names, computed)
        except FormulaError as error:
            self.add(path, str(error))
            return None

    def _check_words(self, index: int, formula: Formula | None, lists: dict[str, tuple[Item, ...]]) -> None:
        """A text that a list is compared with is one of its values: else the constraint never says a thing."""
        for name, word in list_compared(formula) if formula is not None else ():
            if name not in lists or not isinstance(word, str):
                continue
            known = [label if isinstance(value, dict | list) else value for label, value in lists[name]]
            if word not in known:
                texts = [str(item) for item in known]
                near = suggest(word, texts)
                self.add(("where", index), f"{name} is never {describe(word)}; {near}there are: {', '.join(texts)}")

    def _check_bases(self) -> None:
        names = self.settings.base.names
        for index, name in enumerate(names):
            try:
                find_base(name, self.path.parent)
            except (UsageError, ValueError, OSError) as error:
                self.add(("base", index) if isinstance(self.root.value["base"].value, list) else ("base",), str(error))

    def _check_common(self) -> None:
        """Axes that share a draw take as many numbers, and their word is no other axis' name."""
        widths: dict[str, tuple[str, int]] = {}
        axes = self.settings.axes.by_name
        for name, axis in axes.items():
            common = getattr(axis, "common", None)
            if common is None:
                continue
            if common in axes and common != name and getattr(axes[common], "common", None) != common:
                self.add(("axes", name, "common"), f"{common} is an axis; give that one `common: {common}` too")
            first, width = widths.setdefault(common, (name, axis.width))
            if width != axis.width:
                self.add(("axes", name, "common"), f"takes {axis.width} numbers a draw and {first} takes {width}")

    def _check_use(self) -> None:
        """Every name that is used is an axis, and every axis goes somewhere."""
        settings = self.settings
        axes = settings.axes.by_name
        used: set[str] = set()
        for key, item in settings.set.by_key.items():
            for name, path in list_names(item, (key,)):
                used.add(name)
                if name not in axes and not (name == BASE and len(settings.base.names) > 1):
                    words = f"there is no axis {name}; {suggest(name, axes)}there are: {', '.join(axes) or 'none'}"
                    self.add(("set", *path), words)
        for name, axis in axes.items():
            self._check_inside(name, axis, used)
            if formula := getattr(axis, "formula", None):
                used.update(other for other in axes if other in formula)
            if axis.key and (parse_key(axis.key) is None or "=" in axis.key):
                self.add(("axes", name, "key"), f"{describe(axis.key)} is not the key of a setting")
        for name in settings.metrics.by_name:
            if name in axes:
                self.add(
                    ("metrics", name), "is the name of an axis too; columns of tables have one name each", at_key=True
                )
        for name, axis in axes.items():
            if name not in used and not axis.key:
                words = f"goes nowhere: put ${name} where it belongs under `set`, or give it a `key` of the scenario"
                self.add(("axes", name), words, at_key=True)

    def _check_inside(self, name: str, axis: Axis, used: set[str]) -> None:
        """Axes that are named inside the values of another one."""
        axes = self.settings.axes.by_name
        for label, value in list_values(axis):
            for other, path in list_names(value):
                used.add(other)
                if other not in axes or other == name:
                    words = f"{label}: there is no axis {other}; {suggest(other, axes)}there are: {', '.join(axes)}"
                    self.add(("axes", name, "cases", label, *path), words)

    def _check_strategy(self, space: Space) -> None:
        settings = self.settings
        axes, strategy = describe_axes(settings, space), settings.strategy
        for key, words in list_problems(strategy, axes, list(settings.metrics.by_name)):
            self.add(("strategy", key), words)
        several = [name for name, items in space.lists.items() if len(items) > 1]
        if isinstance(strategy, WorstSettings | IndicesSettings) and several and settings.combine != "sampled":
            words = (
                f"{strategy.kind} flies what is drawn, and one combination of lists alone; set combine: sampled, so that "
                f"{', '.join(several)} are drawn too"
            )
            self.add(("strategy", "kind"), words)

    def _check_points(self, campaign: Campaign) -> None:
        """Constraints leave something, and have an answer everywhere."""
        try:
            points = campaign.points()
        except FormulaError as error:
            where = next((i for i, text in enumerate(self.settings.where) if str(error).startswith(text)), None)
            self.add(("axes",) if where is None else ("where", where), str(error))
            return
        if not points:
            self.add(("where",), "nothing is left: no run keeps to all constraints", at_key=True)
        for name, formula in campaign.space.computed.items():
            for point in points[:1]:
                if isinstance(point.values[name], bool | str):
                    self.add(
                        ("axes", name, "formula"), f"{formula.text} is no number: {name_value(point.values[name])}"
                    )

    def _find_file(self, index: int, name: str) -> Path | None:
        try:
            return find_requirements(self.path.parent, name)
        except UsageError as error:
            self.add(("requirements", index), str(error))
            return None


def list_values(axis: Axis) -> tuple[Item, ...]:
    """Label and value of what an axis can be, where it is written out."""
    if isinstance(axis, Categorical):
        return axis.cases.items if axis.cases is not None else ()
    return axis.list_items() if isinstance(axis, ListAxis) else ()


def find_requirements(folder: Path, name: str) -> Path:
    """The requirement file of a name: beside a campaign, in `requirements` there, or one that ships. Raises UsageError."""
    stem = name.removesuffix(".yaml")
    folders = [folder / "requirements", SHIPPED / "requirements"]
    if "\0" not in name and name.endswith(".yaml") and (folder / name).is_file():
        return folder / name
    for place in folders:
        if "/" not in stem and "\0" not in stem and (path := place / f"{stem}.yaml").is_file():
            return path
    known = sorted({path.stem for place in folders for path in place.glob("*.yaml")})
    raise UsageError(
        f"there is no requirement file {describe(name)}; {suggest(stem, known)}there are: {', '.join(known) or 'none'}"
    )
