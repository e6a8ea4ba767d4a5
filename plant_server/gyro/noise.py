"""White noise and wandering bias of one gyro axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import repeat
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plant_server.gyro.presets import GyroPreset
from plant_server.noise import open_stream

BLOCK: Final = 512  # samples of noise made at a time
SIGMA_PER_INSTABILITY: Final = 0.664 / 0.617  # Gauss-Markov sigma over bias instability B
Floats = NDArray[np.float64]
DrawErrors = Callable[
    [], tuple[float, float, float]
]  # error, which is bias and white noise together; bias; white [rad/s]


def open_errors(terms: GyroPreset, turn_on_rad_s: float, dt_s: float, seed: int, unit: str) -> DrawErrors:
    """Return a function that gives the errors of the next sample, from the axis's own stream."""
    if terms.arw_rad_sqrt_s or terms.bias_instability_rad_s or terms.rrw_rad_s_sqrt_s:
        return AxisNoise(terms, turn_on_rad_s, dt_s, seed, unit).iterate().__next__
    return repeat((turn_on_rad_s, turn_on_rad_s, 0.0)).__next__


class AxisNoise:
    """The noise of one axis, made a block at a time."""

    __slots__ = ("_decay", "_drive", "_instability", "_stream", "_turn_on", "_walk", "_walk_step", "_white")

    def __init__(self, terms: GyroPreset, turn_on_rad_s: float, dt_s: float, seed: int, unit: str) -> None:
        self._stream = open_stream(seed, unit)
        self._turn_on = turn_on_rad_s
        sigma = SIGMA_PER_INSTABILITY * terms.bias_instability_rad_s
        self._decay = math.exp(-dt_s / terms.bias_time_s)
        self._drive = sigma * math.sqrt(1.0 - self._decay * self._decay)
        self._walk_step = terms.rrw_rad_s_sqrt_s * math.sqrt(dt_s)
        self._white = terms.arw_rad_sqrt_s / math.sqrt(dt_s)
        self._instability = sigma * float(self._stream.standard_normal())  # stationary from the start
        self._walk = 0.0

    def iterate(self) -> Iterator[tuple[float, float, float]]:
        """Give error, bias and white noise of one sample after the other [rad/s]."""
        while True:
            white, bias = self._make_block()
            yield from zip((white + bias).tolist(), bias.tolist(), white.tolist(), strict=True)

    def _make_block(self) -> tuple[Floats, Floats]:
        """Return the white noise and the bias of the next BLOCK samples [rad/s]."""
        draws = self._stream.standard_normal((3, BLOCK))
        decay, instability = self._decay, self._instability
        wander = [instability, *(instability := decay * instability + k for k in (self._drive * draws[1]).tolist())]
        walk = np.cumsum(np.concatenate(((self._walk,), self._walk_step * draws[2])))
        self._instability, self._walk = wander.pop(), float(walk[-1])
        return self._white * draws[0], self._turn_on + np.array(wander) + walk[:-1]
