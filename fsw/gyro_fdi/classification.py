"""Kind of a gyro fault, its magnitude and frequency, from the fault estimate after the alarm.

A constant is compared with a constant plus one sinusoid by least squares. Constant is only what stands out: from its own
scatter, which noise, spikes and drop-outs do not, and from the drift that a healthy axis may have. The work of one look is
spread over many cycles, so that no cycle is long.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from enum import IntEnum
from typing import Final, NamedTuple

_SAMPLE_S: Final = 0.2
_MAX_SAMPLES: Final = 100  # longer windows are averaged down to about as many
_MAX_FREQUENCY_RAD_S: Final = 6.0
_LOOKS: Final = 4  # windows of 1, 2, 4 and 8 times the first while the kind is still open
_TRIALS_PER_CYCLE: Final = 2
_GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)
_GOLDEN_STEPS: Final = 16
_MIN_AMPLITUDE_RAD_S: Final = 5e-4
_MIN_AMPLITUDE_OF_MEAN: Final = 0.05
_MIN_R2: Final = 0.5
_MIN_BIC_GAIN: Final = 10.0
_MIN_TURN_RAD: Final = 0.8 * 2.0 * math.pi  # less of a period than this tells no frequency
_SCATTER_OF_CONSTANT: Final = 0.3
_QUIET_SCATTER_RAD_S: Final = 6e-4
# A constant is at least so many times its scatter about it. Ten standard errors of 100 samples: their errors hang
# together (the gyro-less rate is filtered over seconds), and a bias learnt from noise before the alarm is in the mean.
_STANDS_OUT: Final = 1.0


class FaultKind(IntEnum):
    """As telemetry carries it."""

    NONE = 0
    CONSTANT = 1
    PERIODIC = 2
    OTHER = 3  # neither, or too slow to tell yet
    DEAD = 4  # the unit itself says that it has no rate


class Verdict(NamedTuple):
    """What was found."""

    kind: FaultKind
    magnitude_rad_s: float  # constant: the value, signed; periodic: amplitude; other: mean
    frequency_rad_s: float  # periodic only
    confidence: float  # part of the signal that the model explains, 0 .. 1


UNKNOWN = Verdict(FaultKind.NONE, 0.0, 0.0, 0.0)


class _Fit(NamedTuple):
    frequency: float
    mean: float
    amplitude: float
    sse: float


class Classifier:
    """Collects the fault estimate of one axis from the alarm on and looks at it when there is enough of it."""

    def __init__(self, cycle_s: float, first_window_s: float, healthy_rad_s: float = 0.0) -> None:
        """Wait for the first alarm.

        cycle_s        : period between calls of `add` [s]
        first_window_s : how long to look before the first verdict [s]
        healthy_rad_s  : drift that a healthy axis may have [rad/s]; a constant is more
        """
        self._healthy_rad_s = healthy_rad_s
        self._per_sample = max(1, round(_SAMPLE_S / cycle_s))
        self._sample_s = self._per_sample * cycle_s
        self._first = max(16, round(first_window_s / self._sample_s))
        self.start()

    def start(self) -> None:
        """Begin anew: an alarm has just been raised."""
        self.verdict = UNKNOWN
        self._samples: list[float] = []
        self._sum, self._count = 0.0, 0
        self._look = 0
        self._work: Generator[None, None, Verdict] | None = None

    def add(self, fault_hat_rad_s: float) -> Verdict:
        """Return the verdict so far, after one more value of the fault estimate [rad/s]."""
        if self._look < _LOOKS and self.verdict.kind in (FaultKind.NONE, FaultKind.OTHER):
            self._collect(fault_hat_rad_s)
            self._advance()
        return self.verdict

    def _collect(self, value: float) -> None:
        self._sum += value
        self._count += 1
        if self._count == self._per_sample:
            self._samples.append(self._sum / self._count)
            self._sum, self._count = 0.0, 0
            if self._work is None and len(self._samples) >= self._first << self._look:
                blocks = max(1, round(len(self._samples) / _MAX_SAMPLES))
                self._work = judge(average_blocks(self._samples, blocks), blocks * self._sample_s, self._healthy_rad_s)

    def _advance(self) -> None:
        work = self._work
        if work is None:
            return
        try:
            for _ in range(_TRIALS_PER_CYCLE):
                next(work)
        except StopIteration as done:
            self.verdict, self._work = done.value, None
            self._look += 1


def average_blocks(samples: list[float], size: int) -> list[float]:
    """Return the means of consecutive blocks of `size` samples; an incomplete last block is left out."""
    whole = len(samples) - len(samples) % size
    return [sum(samples[i : i + size]) / size for i in range(0, whole, size)]


def judge(samples: list[float], sample_s: float, healthy_rad_s: float) -> Generator[None, None, Verdict]:
    """Return (at the end of the generator) the verdict on samples [rad/s], each a mean over sample_s [s].

    Each step of the generator tries one frequency. A drift up to healthy_rad_s is no fault.
    """
    n, duration = len(samples), len(samples) * sample_s
    mean = sum(samples) / n
    scatter = sum((y - mean) ** 2 for y in samples)
    step = 2.0 * math.pi / (6.0 * duration)
    best, frequency = _Fit(0.0, mean, 0.0, scatter), math.pi / duration
    highest = min(_MAX_FREQUENCY_RAD_S, 0.85 * math.pi / sample_s)
    while frequency <= highest:
        fit = _fit(samples, sample_s, frequency, mean)
        if fit.sse < best.sse:
            best = fit
        frequency += step
        yield
    low, high = max(best.frequency - step, 0.25 * step), best.frequency + step
    for _ in range(_GOLDEN_STEPS):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        first, second = _fit(samples, sample_s, left, mean), _fit(samples, sample_s, right, mean)
        if first.sse < second.sse:
            high = right
        else:
            low = left
        best = min(best, first, second, key=lambda fit: fit.sse)
        yield
    return _decide(best, mean, scatter, n, sample_s, healthy_rad_s)


def _decide(fit: _Fit, mean: float, scatter: float, n: int, sample_s: float, healthy_rad_s: float) -> Verdict:
    tiny = 1e-30
    r2 = 1.0 - fit.sse / max(scatter, tiny)
    # Amplitude, phase and frequency are three parameters more than a constant has.
    bic_gain = n * math.log(max(scatter, tiny) / max(fit.sse, tiny)) - 3.0 * math.log(n)
    half = 0.5 * fit.frequency * sample_s
    amplitude = fit.amplitude * half / math.sin(half) if half > 0.0 else 0.0  # each sample is a mean, not a point
    waves = amplitude > max(_MIN_AMPLITUDE_RAD_S, _MIN_AMPLITUDE_OF_MEAN * abs(fit.mean))
    if waves and r2 > _MIN_R2 and bic_gain > _MIN_BIC_GAIN:
        if fit.frequency * n * sample_s >= _MIN_TURN_RAD:
            return Verdict(FaultKind.PERIODIC, amplitude, fit.frequency, r2)
        return Verdict(FaultKind.OTHER, mean, 0.0, 0.0)
    spread = math.sqrt(scatter / n)
    scattered = spread > max(_SCATTER_OF_CONSTANT * abs(mean), _QUIET_SCATTER_RAD_S)
    if scattered or not abs(mean) > max(_STANDS_OUT * spread, healthy_rad_s):
        return Verdict(FaultKind.OTHER, mean, 0.0, 0.0)
    return Verdict(FaultKind.CONSTANT, mean, 0.0, mean * mean / max(mean * mean + spread * spread, tiny))


def _fit(samples: list[float], sample_s: float, frequency: float, mean: float) -> _Fit:
    """Least squares of c + a cos + b sin about the middle of the window: cosine and sine are then orthogonal."""
    n = len(samples)
    angle = frequency * sample_s
    turn_c, turn_s = math.cos(angle), math.sin(angle)
    c, s = math.cos(-0.5 * (n - 1) * angle), math.sin(-0.5 * (n - 1) * angle)
    sum_c = sum_cc = sum_yc = sum_ys = sum_yy = 0.0
    for y in samples:
        d = y - mean
        sum_c += c
        sum_cc += c * c
        sum_yc += d * c
        sum_ys += d * s
        sum_yy += d * d
        c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
    sum_ss = n - sum_cc
    # d sums to zero, so the constant only takes the cosine's own mean out.
    det = sum_cc - sum_c * sum_c / n
    a = sum_yc / det if det > 1e-9 * n else 0.0
    b = sum_ys / sum_ss if sum_ss > 1e-9 * n else 0.0
    sse = max(0.0, sum_yy - a * sum_yc - b * sum_ys)
    return _Fit(frequency, mean - a * sum_c / n, math.hypot(a, b), sse)
