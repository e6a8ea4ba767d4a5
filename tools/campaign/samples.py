"""Points in the unit cube that drawn axes are made of: at random, in a Latin hypercube, or of Sobol's sequence.

Every column is seeded from the campaign's seed and its own name alone: an axis that is added, moved or taken out leaves the
draws of the others as they were (Sobol's: of those before it).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Sampling = Literal["random", "latin_hypercube", "sobol"]
SOBOL_BITS: Final = 30
MOST_COLUMNS: Final = 1000


def make_samples(sampling: Sampling, seed: int, columns: Sequence[str], count: int) -> Floats:
    """Return `count` points of the cube, shape (count, len(columns)), each number at least 0 and below 1.

    random          : each by itself; more of them begin with the same ones
    latin_hypercube : each column has one number in each of `count` equal strata
    sobol           : Sobol's sequence with a random digital shift; best where count is a power of 2
    """
    if not columns:
        return np.zeros((count, 0))
    if sampling == "sobol":
        return _make_sobol(seed, columns, count)
    if sampling == "latin_hypercube":
        from scipy.stats import qmc

        parts = [qmc.LatinHypercube(1, seed=make_generator(seed, name)).random(count)[:, 0] for name in columns]
    else:
        parts = [make_generator(seed, name).random(count) for name in columns]
    return np.column_stack(parts)


def make_generator(seed: int, name: str) -> np.random.Generator:
    """The generator of one column."""
    digest = hashlib.sha256(f"hilsat campaign {seed} axis {name}".encode()).digest()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int.from_bytes(digest[:16], "big"))))


def _make_sobol(seed: int, columns: Sequence[str], count: int) -> Floats:
    """Sobol's points, each column shifted by exclusive or with bits of its own, which keeps them a net (Owen 1998)."""
    import warnings

    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a count that is no power of 2: said in docs and by `check`
        points: Any = qmc.Sobol(len(columns), scramble=False, bits=SOBOL_BITS).random(count)
    whole = np.rint(points * 2**SOBOL_BITS).astype(np.int64)
    shifts = [int(make_generator(seed, name).integers(2**SOBOL_BITS)) for name in columns]
    return np.asarray(((whole ^ np.array(shifts)) + 0.5) / 2**SOBOL_BITS, np.float64)
