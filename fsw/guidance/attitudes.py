"""Attitudes as settings give them."""

from __future__ import annotations

import math

from bus.errors import ConfigError
from bus.units import Vec4


def read_attitude(key: str, q: Vec4) -> Vec4:
    """Return the unit quaternion of a setting. Raises ConfigError when it is zero."""
    norm = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    if not norm > 1e-6:
        raise ConfigError(
            f"{key} = {q} has length {norm:g} and is no attitude; give four numbers, scalar first, for example [1, 0, 0, 0]"
        )
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)
