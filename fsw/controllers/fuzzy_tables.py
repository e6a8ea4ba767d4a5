"""Rule tables of the fuzzy gain scheduling: the increments of Kp, Ki and Kd over the levels of error and error rate.

`canonical` are the three tables of the Chinese literature on fuzzy PID control, those of the paper as far as can be
known: its own are lost. `even` are ours: the same under (e, ec) -> (-e, -ec), so that a turn to the left is flown as one to
the right.
Where they come from and what they do: docs/fuzzy-pid.md.
"""

from __future__ import annotations

from typing import Literal

LEVELS = ("NB", "NM", "NS", "ZO", "PS", "PM", "PB")  # negative big .. positive big: -3 .. 3
Rules = tuple[
    tuple[int, ...], ...
]  # levels of an output, shape (7, 7): a row for each level of e, a column for each of ec

_CANONICAL = """
PB PB PM PM PS ZO ZO    NB NB NM NM NS ZO ZO    PS NS NB NB NB NM PS
PB PB PM PS PS ZO NS    NB NB NM NS NS ZO ZO    PS NS NB NM NM NS ZO
PM PM PM PS ZO NS NS    NB NM NS NS ZO PS PS    ZO NS NM NM NS NS ZO
PM PM PS ZO NS NM NM    NM NM NS ZO PS PM PM    ZO NS NS NS NS NS ZO
PS PS ZO NS NS NM NM    NM NS ZO PS PS PM PB    ZO ZO ZO ZO ZO ZO ZO
PS ZO NS NM NM NM NB    ZO ZO PS PS PM PB PB    PB NS PS PS PS PS PB
ZO ZO NM NM NM NB NB    ZO ZO PS PM PM PB PB    PB PM PM PM PS PS PB
"""
_EVEN = """
PB PB PB PM PS ZO NS    NB NB NB NB NB NB NB    NB NM NS ZO PS PM PB
PB PB PM PS ZO NS NM    NB NB NM NM NM NB NB    NB NM NS ZO PS PM PB
PB PM PS ZO NS NM NB    ZO ZO PS PS PS ZO ZO    NM NS ZO PS PM PB PB
ZO ZO ZO ZO ZO ZO ZO    NS ZO PS PM PS ZO NS    PB PM PS ZO PS PM PB
NB NM NS ZO PS PM PB    ZO ZO PS PS PS ZO ZO    PB PB PM PS ZO NS NM
NM NS ZO PS PM PB PB    NB NB NM NM NM NB NB    PB PM PS ZO NS NM NB
NS ZO PS PM PB PB PB    NB NB NB NB NB NB NB    PB PM PS ZO NS NM NB
"""


def find_rules(tables: Literal["canonical", "even"]) -> tuple[Rules, Rules, Rules]:
    """Return the tables of Kp, Ki and Kd by their name."""
    rows = [
        [LEVELS.index(word) - 3 for word in line.split()]
        for line in (_CANONICAL if tables == "canonical" else _EVEN).split("\n")
        if line
    ]
    kp, ki, kd = (tuple(tuple(row[first : first + 7]) for row in rows) for first in (0, 7, 14))
    return (kp, ki, kd)
