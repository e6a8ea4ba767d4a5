"""The picture of an open loop: recorded against replayed, for the signals that differ most."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError
from fsw.telemetry import INPUT_TOPIC
from tools.log.mcap_reader import ENCAPSULATION_SIZE, Run, parse_layout
from tools.replay.flight_again import Flown
from tools.replay.inputs import parse_input
from tools.replay.open_loop import OpenLoop, SignalChange

MOST: Final = 6  # signals in a picture
MAX_POINTS: Final = 4000  # of a line
COLOURS: Final = ("#0b6fb8", "#d1495b", "#3a8f4d", "#8d6cab")
LARGEST: Final = 1e30  # beyond it there is no axis


def choose_signals(outcome: OpenLoop) -> list[SignalChange]:
    """Those that differ most, against their own size; of two alike the one that differs first."""
    return sorted(outcome.changes, key=lambda change: (-change.relative, change.first_s))[:MOST]


class Series:
    """One signal as recorded and as replayed: t_s shape (n,), both values (n, width); every MAX_POINTS-th part of it."""

    def __init__(self, change: SignalChange) -> None:
        self.change = change
        self.t_s: list[float] = []
        self.recorded: list[NDArray[np.float64]] = []
        self.replayed: list[NDArray[np.float64]] = []
        self._every = max(1, change.samples // MAX_POINTS)
        self._count = 0

    def add(self, t_s: float, recorded: Any, replayed: Any) -> None:
        """Take a sample."""
        if self._count % self._every == 0:
            self.t_s.append(t_s)
            self.recorded.append(np.clip(np.atleast_1d(np.asarray(recorded, np.float64)), -LARGEST, LARGEST))
            self.replayed.append(np.clip(np.atleast_1d(np.asarray(replayed, np.float64)), -LARGEST, LARGEST))
        self._count += 1


def read_series(run: Run, again: Flown, tick_ns: int, changes: Sequence[SignalChange]) -> list[Series]:
    """Fly the log once more and keep these signals. again: at boot."""
    wanted: dict[str, list[tuple[str, Series]]] = {}
    for change in changes:
        topic, _, field = ("/" + change.signal.replace(".", "/")).rpartition("/")
        wanted.setdefault(topic, []).append((field, Series(change)))
    layouts = {
        name: (parse_layout(run.topics[name].schema, name), parse_layout(again.schemas[name], name)) for name in wanted
    }
    expected: dict[str, bytes] = {}
    expected_tick = -1
    for name, record in run.iterate_topics(INPUT_TOPIC, *wanted):
        if record.sequence != expected_tick:
            expected, expected_tick = {}, record.sequence
        expected[name] = record.data
        if name == INPUT_TOPIC:
            said = again.cycle(parse_input(record.sequence, record.data)).records
            for topic, rows in wanted.items():
                if topic in expected and topic in said:
                    one, two = (
                        np.frombuffer(data, layout, 1, ENCAPSULATION_SIZE)[0]
                        for data, layout in zip((expected[topic], said[topic]), layouts[topic], strict=True)
                    )
                    for field, series in rows:
                        series.add(record.sequence * tick_ns * 1e-9, one[field], two[field])
    return [series for rows in wanted.values() for _, series in rows]


def draw_series(rows: Sequence[Series], title: str, path: Path, form: str) -> None:
    """Write the picture (form: png, svg or pdf): a panel a signal, pale and broad as recorded, dark and thin as replayed.

    Raises RecordError when it cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of letters that the font has not
        figure, axes = plt.subplots(
            len(rows), 1, sharex=True, squeeze=False, figsize=(11, 1.2 + 2.3 * len(rows)), layout="constrained"
        )
        try:
            figure.suptitle(title, parse_math=False)
            for axis, series in zip(axes[:, 0], rows, strict=True):
                _draw(axis, series)
            axes[-1, 0].set_xlabel("simulated time [s]")
            figure.savefig(path, dpi=110, format=form)
        except OSError as error:
            raise RecordError(f"{path}: cannot write the picture: {error.strerror}") from None
        finally:
            plt.close(figure)


def _draw(axis: Any, series: Series) -> None:
    recorded, replayed = np.array(series.recorded), np.array(series.replayed)
    for column in range(recorded.shape[1]):
        colour = COLOURS[column % len(COLOURS)]
        name = f" [{column}]" if recorded.shape[1] > 1 else ""
        axis.plot(series.t_s, recorded[:, column], color=colour, lw=3.0, alpha=0.35, label=f"recorded{name}")
        axis.plot(series.t_s, replayed[:, column], color=colour, lw=1.0, label=f"replayed{name}")
    change = series.change
    axis.axvline(change.first_s, color="grey", lw=0.8, ls=":")
    axis.set_title(change.signal, fontsize=9, loc="left", parse_math=False)
    axis.set_ylabel(f"[{change.unit}]" if change.unit else "", parse_math=False)
    axis.legend(loc="upper right", ncols=min(4, recorded.shape[1]), fontsize=7)
    axis.grid(alpha=0.3)
