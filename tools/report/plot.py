"""The picture of a run: attitude error, body rates, wheel torques, fault torque and its estimate, faults marked."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from bus.errors import RecordError
from tools.config.scenario import Resolved
from tools.log.mcap_reader import Run
from tools.report.thinning import thin

MAX_POINTS = 4000  # per line; more cannot be seen
MAX_MOMENTS, MAX_WORDS = 200, 12  # faults that are marked, and named at one moment
LARGEST = 1e30  # beyond it there is no axis
AXES = ("x", "y", "z")
ONSET, END = "#c1121f", "#588157"
COLOURS = ("#0b6fb8", "#d1495b", "#3a8f4d", "#8d6cab")


def draw_run(run: Run, resolved: Resolved, path: Path, form: str = "png") -> Path:
    """Write the picture (form: png, svg or pdf) and return its path.

    What the log does not have, or not in the shape it should, is not drawn. Raises RecordError when there is nothing to
    draw or the picture cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    if not run.has("/truth/attitude"):
        raise RecordError(f"{run.path}: no truth is logged, so there is nothing to draw")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of letters that the font has not, of legends without a line
        figure, axes = plt.subplots(4, 1, sharex=True, figsize=(11, 11), layout="constrained")
        try:
            _draw(figure, axes, run, resolved)
            figure.savefig(path, dpi=110, format=form)
        except OSError as error:
            raise RecordError(f"{path}: cannot write the picture: {error.strerror}") from None
        finally:
            plt.close(figure)
    return path


def _draw(figure: Any, axes: Any, run: Run, resolved: Resolved) -> None:
    scenario = resolved.scenario
    figure.suptitle(f"{scenario.name}: {scenario.title}" if scenario.title else scenario.name, parse_math=False)
    _draw_error(axes[0], run)
    _draw_rates(axes[1], run)
    _draw_torques(axes[2], run)
    _draw_fault_torque(axes[3], run)
    axes[3].set_xlabel("simulated time [s]")
    for axis in axes:
        axis.grid(alpha=0.3)
    _mark_faults(axes, run.faults)


def _read_columns(run: Run, topic: str, field: str, scale: float = 1.0) -> tuple[Any, Any] | None:
    """Times [s] and values, shape (n, width); None where the log has no such numbers."""
    if topic not in run.topics:
        return None
    try:
        values, t_ns = run.signals(topic)[field], run.t_ns(topic)
    except (RecordError, KeyError):
        return None
    table = np.asarray(values, np.float64) * scale
    return t_ns * 1e-9, np.clip(table.reshape(len(table), -1), -LARGEST, LARGEST)


def _lines(
    axis: Any, run: Run, topic: str, field: str, names: tuple[str, ...], scale: float = 1.0, **style: Any
) -> None:
    found = _read_columns(run, topic, field, scale)
    if found is not None:
        t_s, values = found
        for index, name in enumerate(names[: values.shape[1]]):
            pick = thin(values[:, index], MAX_POINTS)
            axis.plot(t_s[pick], values[pick, index], label=name, color=COLOURS[index], lw=1.1, **style)


def _draw_error(axis: Any, run: Run) -> None:
    found = _read_columns(run, "/truth/attitude", "error_deg")
    if found is not None:
        t_s, values = found
        pick = thin(values[:, 0], MAX_POINTS)
        axis.semilogy(t_s[pick], np.maximum(values[pick, 0], 1e-6), color="black", lw=1.2)
    for bound in (5.0, 1.0, 0.1):
        axis.axhline(bound, color="grey", lw=0.6, ls=":")
    axis.set_ylabel("pointing error [deg]")


def _draw_rates(axis: Any, run: Run) -> None:
    _lines(axis, run, "/truth/attitude", "omega_bi_b_rad_s", AXES, 180.0 / np.pi)
    axis.set_ylabel("body rate [deg/s]")
    axis.legend(loc="upper right", ncols=3, fontsize=8)


def _draw_torques(axis: Any, run: Run) -> None:
    _lines(axis, run, "/fsw/control", "tau_rw_cmd_nm", ("wheel 1", "wheel 2", "wheel 3", "wheel 4"), alpha=0.35)
    names = ("wheel 1 true", "wheel 2 true", "wheel 3 true", "wheel 4 true")
    _lines(axis, run, "/truth/wheels", "tau_rw_true_nm", names)
    axis.set_ylabel("wheel torque [N m]\n(pale: commanded)")
    axis.legend(loc="upper right", ncols=4, fontsize=7)


def _draw_fault_torque(axis: Any, run: Run) -> None:
    _lines(axis, run, "/truth/wheels", "tau_fault_b_nm", tuple(f"true {a}" for a in AXES))
    _lines(axis, run, "/fsw/observer", "tau_fault_hat_b_nm", tuple(f"estimate {a}" for a in AXES), ls="--")
    axis.set_ylabel("fault torque [N m]")
    axis.legend(loc="upper right", ncols=6, fontsize=7)


def _mark_faults(axes: Any, records: list[dict[str, Any]]) -> None:
    """A line for every onset (solid) and end (dashed); one label a moment, above the top panel."""
    moments: dict[float, list[dict[str, Any]]] = {}
    for record in records:
        if record["phase"] in ("onset", "end", "cleared"):
            moments.setdefault(record["t_ns"] * 1e-9, []).append(record)
    for t_s, happening in list(moments.items())[:MAX_MOMENTS]:
        onset = any(record["phase"] == "onset" for record in happening)
        for axis in axes:
            axis.axvline(t_s, color=ONSET if onset else END, lw=0.8, ls="-" if onset else "--", alpha=0.7)
        words = [
            f"{r['unit'][:30]} {r['fault'][:30] if r['phase'] == 'onset' else 'ends'}" for r in happening[:MAX_WORDS]
        ]
        axes[0].annotate(
            "\n".join(words), (t_s, 0.02), xycoords=("data", "axes fraction"), rotation=90, fontsize=6, va="bottom",
            ha="left", xytext=(1, 0), textcoords="offset points", linespacing=1.0, parse_math=False,
        )  # fmt: skip
