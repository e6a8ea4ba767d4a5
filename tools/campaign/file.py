"""What a campaign file may say: its keys, read as the settings of a scenario are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from bus.errors import UsageError
from bus.run import Seed
from bus.settings import INVALID, KeyPath, Reading, fields_of, read_keys
from bus.texts import Line, Name, Prose, SignalText, Text, explain_text
from bus.units import Ge, Gt, Le, Seconds
from bus.words import describe
from tools.campaign.axes import Axes
from tools.campaign.chosen_logs import check_keeping
from tools.campaign.job import Metric
from tools.campaign.metrics import STATISTICS
from tools.campaign.samples import Sampling
from tools.campaign.strategies.settings import PlanSettings, StrategySettings
from tools.config.expect_checks import check_signal
from tools.config.merge import parse_key

MOST_BASES = 200
MOST_METRICS = 100
Combine = Literal["grid", "pairwise", "sampled"]


@dataclass(frozen=True, slots=True)
class Bases:
    """Scenarios that the runs start from; several are an axis called `base`."""

    names: tuple[str, ...]

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """One name or a list of them, INVALID where there is none."""
        listed: list[Any] = data if isinstance(data, list) else [data]
        if not listed or len(listed) > MOST_BASES:
            return out.add(at, f"has {len(listed)} scenarios; give one to {MOST_BASES}")
        sound = True
        for index, name in enumerate(listed):
            where = (*at, index) if isinstance(data, list) else at
            if not isinstance(name, str) or not name:
                out.add(where, f"{describe(name)} is not the path or the name of a scenario")
                sound = False
            elif word := explain_text(name, Text(400)):
                out.add(where, f"{describe(name)} {word}")
                sound = False
            elif name in listed[:index]:
                out.add(where, f"{describe(name)} is there twice")
                sound = False
        return cls(tuple(listed)) if sound else INVALID

    def plain_settings(self) -> list[str]:
        """The list."""
        return list(self.names)


@dataclass(frozen=True, slots=True)
class Settings:
    """Keys of the scenario and what they are set to, `$axis` in them; see tools/campaign/template.py."""

    by_key: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The settings of a mapping, INVALID where it is none."""
        if not isinstance(data, dict):
            return out.add(at, f"{describe(data)} where a mapping is needed: key of the scenario -> value")
        sound = True
        for key in data:
            if parse_key(str(key)) is None or "=" in str(key) or str(key).startswith("$"):
                out.add((*at, key), "is not the key of a setting, such as fsw.controller.kind", at_key=True)
                sound = False
        return cls(dict(data)) if sound else INVALID

    def plain_settings(self) -> dict[str, Any]:
        """The mapping."""
        return self.by_key


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricKeys:
    """What a metric says beside its statistic."""

    percent: Annotated[float, Ge(0), Le(100)] | None = None  # of `percentile`
    from_s: Annotated[Seconds, Ge(0)] = 0.0  # first moment that counts
    until_s: Annotated[Seconds, Gt(0)] | None = None  # last moment that counts; None: the end of the run
    unit: Annotated[str, Text(40)] = ""  # of the value


@dataclass(frozen=True, slots=True)
class Metrics:
    """Numbers that are taken of every run beside its verdicts: name -> {statistic: signal}."""

    by_name: dict[str, Metric] = field(default_factory=dict)

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The metrics of a mapping, INVALID where one is not sound."""
        if not isinstance(data, dict):
            return out.add(at, f"{describe(data)} where a mapping is needed: name -> statistic and signal")
        if len(data) > MOST_METRICS:
            return out.add(at, f"has {len(data)} metrics; at most {MOST_METRICS}")
        found = {str(name): read_metric(str(name), item, (*at, name), out) for name, item in data.items()}
        return INVALID if any(metric is INVALID for metric in found.values()) else cls(found)

    def plain_settings(self) -> dict[str, Any]:
        """The mapping."""
        return {
            name: {metric.statistic: metric.signal, "percent": metric.percent, "from_s": metric.from_s,
                   "until_s": metric.until_s, "unit": metric.unit}
            for name, metric in self.by_name.items()
        }  # fmt: skip


def read_metric(name: str, data: object, at: KeyPath, out: Reading) -> Any:
    """One metric, INVALID where it is not sound."""
    if word := explain_text(name, Text(80)):
        return out.add(at, f"cannot name a metric: {word}", at_key=True)
    if not isinstance(data, dict):
        return out.add(at, f"{describe(data)} where a mapping is needed, such as {{max: truth.attitude.error_deg}}")
    known: dict[str, tuple[Any, Any]] = {
        **fields_of(MetricKeys),
        **dict.fromkeys(STATISTICS, (SignalText | None, None)),
    }
    values = read_keys(known, data, at, out)
    if INVALID in values.values():
        return INVALID
    chosen = [word for word in STATISTICS if values.pop(word) is not None]
    if len(chosen) != 1:
        words = f"has {' and '.join(chosen)}" if chosen else "has no statistic"
        return out.add(at, f"{words}; give one of: {', '.join(STATISTICS)}")
    if (chosen[0] == "percentile") != (values["percent"] is not None):
        return out.add((*at, chosen[0]), "percentile and percent go together")
    if values["until_s"] is not None and values["until_s"] <= values["from_s"]:
        return out.add((*at, "until_s"), f"{values['until_s']:g} s is not after from_s, {values['from_s']:g} s")
    problems = check_signal(data[chosen[0]])
    for _, words in problems:
        out.add((*at, chosen[0]), words)
    return INVALID if problems else Metric(statistic=chosen[0], signal=data[chosen[0]], **values)


class Keeping(str):
    """Which logs are kept: none, failures, all, or worst N."""

    __slots__ = ()

    @classmethod
    def read_settings(cls, data: object, at: KeyPath, out: Reading) -> Any:
        """The words as they are understood, INVALID for others."""
        try:
            return cls(check_keeping(str(data)))
        except UsageError as error:
            return out.add(at, str(error).removeprefix("keep logs of "))

    def plain_settings(self) -> str:
        """The words."""
        return str(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignFile:
    """A whole campaign file, after `extends` and overrides."""

    name: Name  # short, also names the directory of the results
    title: Line = ""  # one line for reports
    description: Prose = ""  # what it asks, and where its numbers come from
    base: Bases  # scenario file or name of one that ships; or a list of them, which is an axis
    seed: Seed = 0  # of all draws, and with the number of a run of the run's own seed
    set: Settings = field(default_factory=Settings)  # keys of the scenario and their values, `$axis` in them
    axes: Axes = field(default_factory=Axes)  # what the runs differ in
    combine: Combine = "grid"  # lists: all combinations; every pair of values once; or drawn like the other axes
    sampling: Sampling = "random"  # how points of the drawn axes are laid out
    draws: Literal["shared", "own"] = "shared"  # whether all combinations of lists fly the same draws
    samples: Annotated[int, Ge(1), Le(1_000_000)] = 1  # draws for each combination of lists
    repeats: Annotated[int, Ge(1), Le(100_000)] = 1  # runs at each point, with seeds of their own
    where: tuple[Annotated[str, Text(400)], ...] = ()  # constraints between axes: all must hold
    metrics: Metrics = field(default_factory=Metrics)  # numbers of each run beside its verdicts
    requirements: tuple[Annotated[str, Text(200)], ...] = ()  # requirement files by which runs are judged too
    keep_logs: Keeping = field(default_factory=lambda: Keeping("none"))  # none, failures, all, or `worst N`
    limit_s: Annotated[Seconds, Gt(0)] | None = None  # wall time after which a run is taken to hang; None: none
    strategy: StrategySettings = field(default_factory=PlanSettings)  # which points are flown
