"""How many messages a channel has, and of which ticks: kept as runs, because a log has millions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Tally:
    """The messages of one channel, counted chunk by chunk."""

    def __init__(self) -> None:
        self.count = 0
        self.last_ns: int | None = None  # largest log time [ns]
        self._runs: list[tuple[int, int, int] | NDArray[np.int64]] = []  # first, step, count; or the numbers themselves

    def add(self, sequences: NDArray[np.int64], log_times_ns: NDArray[np.int64]) -> None:
        """Count the messages of one chunk, one at least."""
        self.count += sequences.size
        latest = int(log_times_ns.max())
        self.last_ns = latest if self.last_ns is None else max(latest, self.last_ns)
        steps: NDArray[Any] = np.diff(sequences)
        first, step = int(sequences[0]), int(steps[0]) if steps.size else 0
        if (steps != step).any():
            self._runs.append(sequences.astype(np.uint32).astype(np.int64))
        else:
            self._runs.append((first, step, sequences.size))

    def sequences(self) -> NDArray[np.int64]:
        """Sequence number of every message: the tick, for what is written once a tick."""
        pieces = [
            run if isinstance(run, np.ndarray) else run[0] + run[1] * np.arange(run[2], dtype=np.int64)
            for run in self._runs
        ]
        return np.concatenate(pieces) if pieces else np.empty(0, np.int64)
