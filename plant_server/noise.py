"""Random numbers of the plant: one stream per named unit, so that one unit's draws never shift another's.

A stream is Philox (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") keyed with a hash of the run's
seed and the unit's name: independent for every name, the same on every run. Numbers are drawn in blocks and handed
out as plain floats; a single draw through numpy costs thirty times as much.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

BLOCK: Final = 1024

Draw = Callable[[], float]


def open_stream(seed: int, name: str) -> np.random.Generator:
    """Return the generator of the unit `name` in the run with this seed."""
    key = hashlib.sha256(f"hilsat/{seed}/{name}".encode()).digest()[:16]
    return np.random.Generator(np.random.Philox(key=int.from_bytes(key, "little")))


def open_normals(seed: int, name: str) -> Draw:
    """Return a function that draws from the unit's stream, standard normal [1]."""
    stream = open_stream(seed, name)

    def draw_blocks() -> Iterator[float]:
        while True:
            yield from stream.standard_normal(BLOCK).tolist()

    return draw_blocks().__next__


def open_uniforms(seed: int, name: str) -> Draw:
    """Return a function that draws from the unit's stream, uniform on [0, 1) [1]."""
    stream = open_stream(seed, name)

    def draw_blocks() -> Iterator[float]:
        while True:
            yield from stream.random(BLOCK).tolist()

    return draw_blocks().__next__
