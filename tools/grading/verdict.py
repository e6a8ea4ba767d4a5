"""What came of one requirement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

Outcome = Literal["pass", "fail", "not executed"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of one requirement. Not executed: what it needs was not seen, so that nobody knows."""

    name: str
    outcome: Outcome
    value: float | None  # what was graded; None where it could not be
    bound: str  # what it had to be, in words
    margin: float | None  # distance to the bound, negative: failed
    unit: str
    detail: str = ""
    source: str = ""
    id: str = ""  # of the requirement
    severity: str = ""
    text: str = ""  # the requirement in full

    @property
    def title(self) -> str:
        """Name of the requirement behind its id."""
        return f"{self.id} {self.name}" if self.id else self.name

    @property
    def passed(self) -> bool:
        """True for a pass and nothing else."""
        return self.outcome == "pass"

    def as_dict(self) -> dict[str, Any]:
        """In JSON types; numbers beyond what JSON can say are null."""
        return {
            "name": self.name,
            "passed": self.passed,
            "outcome": self.outcome,
            "value": _finite(self.value),
            "bound": self.bound,
            "margin": _finite(self.margin),
            "unit": self.unit,
            "detail": self.detail,
            "source": self.source,
            "id": self.id,
            "severity": self.severity,
            "text": self.text,
        }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def decide(holds: bool) -> Outcome:
    """Pass when it holds, else fail."""
    return "pass" if holds else "fail"
