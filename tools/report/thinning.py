"""Fewer points of a line than a log has, without losing a peak or a hole."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def thin(values: NDArray[Any], points: int) -> NDArray[np.int64]:
    """Indices of the samples to draw, rising, about `points` of them.

    values : shape (n,)
    Of each stretch: its smallest and its largest number, and its first sample that is no finite number, so that a line
    breaks there. The first and the last sample are always among them.
    """
    count = len(values)
    if count <= points or count < 4:
        return np.arange(count)
    step = -(-2 * count // max(points, 2))
    rows = -(-count // step)
    padded = np.full(rows * step, values[-1], np.float64)
    padded[:count] = values
    table = padded.reshape(rows, step)
    sound = np.isfinite(table)
    picks = [
        np.argmin(np.where(sound, table, np.inf), axis=1),
        np.argmax(np.where(sound, table, -np.inf), axis=1),
        np.argmin(sound, axis=1),  # the first that is no number; where all are, simply the first
    ]
    broken = ~sound.all(axis=1)
    starts = np.arange(rows) * step
    found = np.concatenate([starts + picks[0], starts + picks[1], (starts + picks[2])[broken], [0, count - 1]])
    return np.unique(np.minimum(found, count - 1))
