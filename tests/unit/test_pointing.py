"""The pointing errors of a whole chunk at once: the same bits as one by one."""

from __future__ import annotations

import numpy as np

from bus.attitude import angle_between
from tools.log.pointing import angles_between


def test_many_angles_are_the_angles_bit_for_bit() -> None:
    """Random attitudes, equal ones, opposite ones, and ones a hair apart, against the function for one pair."""
    rng = np.random.default_rng(1)
    p = rng.standard_normal((4000, 4))
    q = rng.standard_normal((4000, 4))
    q[:1000] = p[:1000]
    q[1000:2000] = -p[1000:2000]
    q[2000:3000] = p[2000:3000] + 1e-9 * q[2000:3000]
    p /= np.linalg.norm(p, axis=1)[:, None]
    q /= np.linalg.norm(q, axis=1)[:, None]
    one_by_one = [angle_between(tuple(a), tuple(b)) for a, b in zip(p.tolist(), q.tolist(), strict=True)]
    assert angles_between(p, q).tolist() == one_by_one
