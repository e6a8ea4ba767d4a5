"""White noise and wandering bias of one gyro axis."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from plant_server.gyro.presets import GyroPreset
from plant_server.noise import open_stream

BLOCK: Final = 512  # samples of noise made at a time
SIGMA_PER_INSTABILITY: Final = 0.664 / 0.617  # Gauss-Markov sigma over bias instability B
Errors = tuple[float, float, float]


class AxisErrors:
    """The errors of one axis, sample by sample."""

    __slots__ = ()

    def draw(self) -> Errors:
        """Return error, bias and white noise of the next sample [rad/s]; the error is the sum of the others."""
        raise NotImplementedError


class TurnOnBias(AxisErrors):
    """A constant bias and no noise."""

    __slots__ = ("_errors",)

    def __init__(self, bias_rad_s: float) -> None:
        self._errors: Errors = (bias_rad_s, bias_rad_s, 0.0)

    def draw(self) -> Errors:
        """Return the bias [rad/s]."""
        return self._errors


class AxisNoise(AxisErrors):
    """The noise of one axis, made a block at a time from the axis's own stream."""

    __slots__ = (
        "_biases", "_decay", "_drive", "_errors", "_instability", "_next", "_stream", "_turn_on", "_walk", "_walk_step",
        "_white", "_whites",
    )  # fmt: skip

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
        self._errors: list[float] = []
        self._biases: list[float] = []
        self._whites: list[float] = []
        self._next = BLOCK

    def draw(self) -> Errors:
        """Return error, bias and white noise of the next sample [rad/s]."""
        if self._next == BLOCK:
            self._make_block()
        at = self._next
        self._next = at + 1
        return (self._errors[at], self._biases[at], self._whites[at])

    def _make_block(self) -> None:
        draws = self._stream.standard_normal((3, BLOCK))
        wander = []
        instability = self._instability
        for push in (self._drive * draws[1]).tolist():
            wander.append(instability)
            instability = self._decay * instability + push
        walk = np.cumsum(np.concatenate(((self._walk,), self._walk_step * draws[2])))
        self._instability, self._walk = instability, float(walk[-1])
        white = self._white * draws[0]
        bias = self._turn_on + np.array(wander) + walk[:-1]
        self._errors, self._biases, self._whites = (white + bias).tolist(), bias.tolist(), white.tolist()
        self._next = 0


def open_errors(terms: GyroPreset, turn_on_rad_s: float, dt_s: float, seed: int, unit: str) -> AxisErrors:
    """Return the errors of an axis with these noise terms."""
    if terms.arw_rad_sqrt_s or terms.bias_instability_rad_s or terms.rrw_rad_s_sqrt_s:
        return AxisNoise(terms, turn_on_rad_s, dt_s, seed, unit)
    return TurnOnBias(turn_on_rad_s)
