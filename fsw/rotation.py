"""One step of attitude propagation, the one piece of attitude arithmetic that runs several times in every tick."""

from __future__ import annotations

import math

from bus.units import Vec4


def turn(q: Vec4, x: float, y: float, z: float) -> Vec4:
    """Return q exp((x, y, z) / 2): q turned by a rotation vector in body axes [rad].

    The length of the result is that of q but for rounding, 1e-16 a call.
    """
    n2 = x * x + y * y + z * z
    if n2 < 4e-5:  # 0.3 rad/s for 20 ms; what the series leave out is below the last bit
        s = 0.5 - n2 * (1.0 / 48.0 - n2 * (1.0 / 3840.0))
        e = 1.0 - n2 * (0.125 - n2 * (1.0 / 384.0))
    else:
        n = math.sqrt(n2)
        s = math.sin(0.5 * n) / n
        e = math.cos(0.5 * n)
    f, g, h = s * x, s * y, s * z
    a, b, c, d = q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )
