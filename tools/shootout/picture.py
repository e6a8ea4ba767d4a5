"""The picture of a shootout: error over time, a panel for each allocator, and the pairs side by side in dots."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bus.errors import RecordError
from tools.report.plot import ONSET
from tools.shootout.figures import BOUNDS_DEG
from tools.shootout.flights import FLEW, Outcome
from tools.shootout.table import Shootout

SIZE_IN: Final = (15.0, 11.0)
LEAST_DEG: Final = 1e-4
MARKS: Final = ("o", "s", "D")  # for the bounds
SHADES: Final = ("#9ecae1", "#4292c6", "#08306b")
COSTS: Final = (
    ("impulse_nms", "impulse [N m s]"),
    ("energy_j", "energy [J]"),
    ("variation_nm_s", "variation [N m/s]"),
)


def draw_shootout(shootout: Shootout, path: Path) -> Path:
    """Write the picture as PNG and return its path. Raises RecordError where nobody flew or it cannot be written."""
    flown = [outcome for outcome in shootout.outcomes if outcome.state == FLEW]
    if not flown:
        raise RecordError(f"{path}: no pair was flown, so there is nothing to draw")
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of letters that the font has not
        figure = plt.figure(figsize=SIZE_IN, layout="constrained")
        try:
            _draw(figure, plt, shootout, flown)
            figure.savefig(path, dpi=100, format="png")
        except OSError as error:
            raise RecordError(f"{path}: cannot write the picture: {error.strerror}") from None
        finally:
            plt.close(figure)
    return path


def _draw(figure: Any, plt: Any, shootout: Shootout, flown: Sequence[Outcome]) -> None:
    scenario = shootout.scenario
    figure.suptitle(f"{scenario.name}: laws times allocators, {scenario.duration_s:g} s", parse_math=False)
    above, below = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
    shares = list(dict.fromkeys(outcome.pair.allocator for outcome in flown))
    laws = list(dict.fromkeys(outcome.pair.controller for outcome in flown))
    colours = {law: plt.get_cmap("tab10" if len(laws) <= 10 else "tab20")(index) for index, law in enumerate(laws)}
    panels = above.subplots(1, len(shares), sharex=True, sharey=True, squeeze=False)[0]
    for panel, share in zip(panels, shares, strict=True):
        _draw_errors(panel, [outcome for outcome in flown if outcome.pair.allocator == share], colours, shootout)
        panel.set_title(f"allocator {share}", fontsize=10)
    panels[0].set_ylabel("pointing error [deg]")
    handles = [plt.Line2D([], [], color=colours[law], label=law) for law in laws]
    above.legend(handles=handles, loc="outside lower center", ncols=min(6, len(laws)), fontsize=9)
    axes = below.subplots(1, 1 + len(COSTS), sharey=True, width_ratios=(2.2, *[1.0] * len(COSTS)))
    _draw_times(axes[0], flown, scenario.duration_s)
    for axis, (field, label) in zip(axes[1:], COSTS, strict=True):
        _draw_cost(axis, flown, colours, field, label)


def _draw_errors(panel: Any, flown: Sequence[Outcome], colours: dict[str, Any], shootout: Shootout) -> None:
    for outcome in flown:
        t_s, error_deg = outcome.curve
        panel.semilogy(t_s, np.maximum(error_deg, LEAST_DEG), color=colours[outcome.pair.controller], lw=1.2)
    for bound in BOUNDS_DEG:
        panel.axhline(bound, color="grey", lw=0.6, ls=":")
    for fault in shootout.scenario.faults:
        panel.axvline(fault.at_s, color=ONSET, lw=0.7, alpha=0.4)
    panel.set_ylim(LEAST_DEG, 200.0)
    panel.set_xlim(0.0, shootout.scenario.duration_s)
    panel.set_xlabel("simulated time [s]; red: a fault comes", fontsize=8)
    panel.grid(alpha=0.3)


def _draw_times(axis: Any, flown: Sequence[Outcome], end_s: float) -> None:
    """A row for each pair, the first on top; a cross at the right edge for each bound that was not kept by the end."""
    places = np.arange(len(flown))
    for index, bound in enumerate(BOUNDS_DEG):
        times = [_list_times(outcome)[index] for outcome in flown]
        settled = [(time_s, place) for time_s, place in zip(times, places, strict=True) if time_s is not None]
        late = [place for time_s, place in zip(times, places, strict=True) if time_s is None]
        x, y = zip(*settled, strict=True) if settled else ((), ())
        label = f"{bound:g} deg"
        axis.plot(x, y, MARKS[index], color=SHADES[index], label=label, ms=6)
        axis.plot([end_s * (1.02 + 0.03 * index)] * len(late), late, "x", color=SHADES[index], ms=6, clip_on=False)
    axis.set_yticks(places, [outcome.pair.name for outcome in flown], fontsize=7)
    axis.invert_yaxis()
    axis.set_xlim(0.0, end_s * 1.1)
    axis.axvline(end_s, color="grey", lw=0.8, ls="--")
    axis.set_xlabel("settled for good [s]; cross: not by the end")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(BOUNDS_DEG), fontsize=8)
    axis.grid(alpha=0.3)


def _list_times(outcome: Outcome) -> tuple[float | None, float | None, float | None]:
    figures = outcome.figures
    assert figures is not None
    return figures.settled_5_deg_s, figures.settled_1_deg_s, figures.settled_01_deg_s


def _draw_cost(axis: Any, flown: Sequence[Outcome], colours: dict[str, Any], field: str, label: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    for place, outcome in enumerate(flown):
        axis.plot(max(getattr(outcome.figures, field), 1e-9), place, "o", color=colours[outcome.pair.controller], ms=6)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(ScalarFormatter())
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.tick_params(axis="x", labelsize=8)
    axis.set_xlabel(label)
    axis.grid(alpha=0.3)
