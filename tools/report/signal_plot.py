"""A picture of any signals of one log or several: a panel an expression, a colour an element, a line style a log."""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from bus.errors import RecordError
from tools.grading.expressions import Series, evaluate_all, name_signals
from tools.log.mcap_reader import Run
from tools.report.info import FaultStory, tell_faults
from tools.report.thinning import thin

MAX_POINTS: Final = 4000  # of a line: more cannot be seen
MAX_FAULTS: Final = 60  # shaded
LARGEST: Final = 1e30  # beyond it there is no axis
COLOURS: Final = ("#0b6fb8", "#d1495b", "#3a8f4d", "#8d6cab", "#b07d2b", "#4a4e69")
STYLES: Final = ("-", "--", ":", "-.")
SHADES: Final = ("#c1121f", "#e09f3e", "#6a4c93", "#588157")  # faults of the first log, of the second, ...
USUAL: Final = (
    "truth.attitude.error_deg",
    "deg(truth.attitude.omega_bi_b_rad_s)",
    "truth.wheels.tau_rw_true_nm",
    "truth.wheels.tau_fault_b_nm",
)


@dataclass(frozen=True, slots=True)
class Window:
    """The stretch of simulated time that is drawn [s]; None: from the start, to the end."""

    from_s: float | None = None
    until_s: float | None = None

    def cut(self, series: Series) -> Series:
        """The samples inside."""
        assert series.t_s is not None
        low = -np.inf if self.from_s is None else self.from_s
        high = np.inf if self.until_s is None else self.until_s
        keep = (series.t_s >= low) & (series.t_s <= high)
        return Series(series.t_s[keep], series.values[keep])


def split_signals(texts: Sequence[str]) -> list[str]:
    """The expressions of some comma-separated lists, each once. No expression has a comma in it."""
    return list(dict.fromkeys(part.strip() for text in texts for part in text.split(",") if part.strip()))


def draw_signals(
    runs: Sequence[Run], signals: Sequence[str], path: Path, form: str = "png", window: Window | None = None
) -> None:
    """Write the picture of these expressions over these logs (form: png, svg or pdf).

    Raises ConfigError for an expression that a log cannot answer, RecordError where there is no sample to draw or the
    picture cannot be written.
    """
    window = window or Window()
    data = {(i, name): window.cut(evaluate_all(run, name)) for i, run in enumerate(runs) for name in signals}
    if not any(series.values.size for series in data.values()):
        raise RecordError(f"{runs[0].path}: there is no sample of {', '.join(signals)} in that time")
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with warnings.catch_warnings(), plt.rc_context({"svg.hashsalt": "hilsat"}):
        warnings.simplefilter("ignore")  # of letters that the font has not
        size = (11, min(1.2 + 2.4 * len(signals), 60.0))
        figure, axes = plt.subplots(len(signals), 1, sharex=True, figsize=size, layout="constrained", squeeze=False)
        try:
            for axis, name in zip(axes[:, 0], signals, strict=True):
                _draw_panel(axis, runs, name, [data[i, name] for i in range(len(runs))])
            span = _find_span(list(data.values()))
            _shade_faults(axes[:, 0], runs, span)
            axes[0, 0].set_xlim(*span)
            axes[-1, 0].set_xlabel("simulated time [s]")
            figure.suptitle(_name_picture(runs), parse_math=False)
            figure.savefig(path, dpi=110, format=form)
        except OSError as error:
            raise RecordError(f"{path}: cannot write the picture: {error.strerror}") from None
        finally:
            plt.close(figure)


def _find_span(all_series: list[Series]) -> tuple[float, float]:
    times = [t_s for series in all_series if (t_s := series.t_s) is not None and t_s.size]
    start, end = min(float(t_s[0]) for t_s in times), max(float(t_s[-1]) for t_s in times)
    return start, end if end > start else start + 1.0


def _name_picture(runs: Sequence[Run]) -> str:
    names = [run.metadata.get("run", {}).get("scenario", "")[:60] or Path(run.path).name for run in runs]
    return " against ".join(name_logs(runs)) if len(runs) > 1 else names[0]


def name_logs(runs: Sequence[Run]) -> list[str]:
    """A short name for each log, no two alike."""
    paths = [Path(run.path) for run in runs]
    if len({path.stem for path in paths}) == len(paths):
        return [path.stem[:60] for path in paths]
    if len({path.parent.name for path in paths}) == len(paths):
        return [f"{path.parent.name}/{path.stem}"[-60:] for path in paths]
    return [f"{i}: {path.stem[:50]}" for i, path in enumerate(paths, 1)]


def _draw_panel(axis: Any, runs: Sequence[Run], name: str, all_series: list[Series]) -> None:
    logs = name_logs(runs)
    lines = 0
    for i, (log, series) in enumerate(zip(logs, all_series, strict=True)):
        values = np.clip(series.values, -LARGEST, LARGEST).reshape(len(series.values), -1)
        for column in range(values.shape[1]):
            pick = thin(values[:, column], MAX_POINTS)
            element = f"[{column}]" if values.shape[1] > 1 else ""
            colour = COLOURS[(column if values.shape[1] > 1 else i) % len(COLOURS)]
            label = " ".join(filter(None, (element, log if len(runs) > 1 else "")))
            assert series.t_s is not None
            axis.plot(series.t_s[pick], values[pick, column], color=colour, ls=STYLES[i % 4], lw=1.1, label=label)
            lines += 1
    unit = find_unit(runs[0], name)
    axis.set_title(f"{name} [{unit}]" if unit else name, loc="left", fontsize=9, parse_math=False)
    axis.grid(alpha=0.3)
    if lines > 1:
        axis.legend(loc="upper right", ncols=min(lines, 6), fontsize=7)


def find_unit(run: Run, expression: str) -> str:
    """The unit of an expression's values, as far as the log says: of one signal, or a function of it; else nothing."""
    names = name_signals(expression)
    if len(names) != 1 or names[0][0] not in run.topics:
        return ""
    topic, field = names[0]
    tree = ast.parse(expression.strip(), mode="eval").body
    if any(isinstance(node, ast.BinOp) for node in ast.walk(tree)):
        return ""
    unit = run.topics[topic].units.get(field, "")
    calls = [node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    for call in reversed(calls):  # the inner ones come last
        match call:
            case "deg":
                unit = re.sub(r"^rad\b", "deg", unit)
            case "rad":
                unit = re.sub(r"^deg\b", "rad", unit)
            case "rate":
                unit = f"{unit}/s" if unit else ""
            case "sqrt":
                unit = ""
    return unit


def _key(fault: FaultStory) -> tuple[str, str, float | None, float | None]:
    return fault.unit, fault.kind, fault.onset_s, fault.end_s


def _shade_faults(axes: Any, runs: Sequence[Run], span: tuple[float, float]) -> None:
    """A band from onset to end of every fault; of a further log only of those that the logs before it had not."""
    logs = name_logs(runs)
    seen: set[tuple[str, str, float | None, float | None]] = set()
    words: dict[float, list[str]] = {}  # moment -> who broke
    for i, run in enumerate(runs):
        faults = [fault for fault in tell_faults(run.faults) if fault.onset_s is not None][:MAX_FAULTS]
        new = [fault for fault in faults if _key(fault) not in seen]
        seen.update(map(_key, new))
        for fault in new:
            left = max(fault.onset_s or 0.0, span[0])
            right = min(span[1] if fault.end_s is None else fault.end_s, span[1])
            if left <= right:
                for axis in axes:
                    axis.axvspan(left, right, color=SHADES[i % 4], alpha=0.07, lw=0)
                    axis.axvline(left, color=SHADES[i % 4], lw=0.7, alpha=0.6)
                words.setdefault(left, []).append(
                    f"{fault.unit[:30]} {fault.kind[:30]}" + (f" ({logs[i]})" if i else "")
                )
    for left, lines in words.items():
        axes[0].annotate(
            "\n".join(lines), (left, 0.98), xycoords=("data", "axes fraction"), rotation=90, fontsize=6, va="top",
            ha="left", xytext=(1, 0), textcoords="offset points", linespacing=1.0, parse_math=False,
        )  # fmt: skip
