"""A button for every kind of fault of the catalogue: the service it calls, and a request that is ready to be sent."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from bus.settings import NOTHING
from plant_server.faults.fault import magnitudes_of
from tools.config.fault_reference import UNITS_OF, list_variants

FOR_S: Final = 20.0  # how long a fault acts when nothing else is said
CLEAR: Final = "/fault/clear"
NEEDED: Final[dict[tuple[str, str], dict[str, float]]] = {  # of magnitudes that have no default
    ("wheel", "loss"): {"effectiveness": 0.3},
    ("wheel", "bias"): {"torque_nm": 0.01},
    ("wheel", "stuck_torque"): {"torque_nm": 0.015},
    ("gyro", "constant"): {"rate_rad_s": 0.002},
    ("gyro", "periodic"): {"rate_rad_s": 0.002, "frequency_rad_s": 1.0},
    ("gyro", "ramp"): {"slope_rad_s2": 1e-4},
    ("gyro", "noise"): {"factor": 20.0},
    ("gyro", "scale"): {"factor": 1.2},
    ("gyro", "spikes"): {"rate_rad_s": 0.05, "probability": 0.1},
    ("gyro", "intermittent"): {"probability": 0.3},
}


@dataclass(frozen=True, slots=True)
class Button:
    """One button."""

    service: str
    family: str
    title: str
    request: dict[str, Any]


@cache
def list_buttons() -> tuple[Button, ...]:
    """One a kind of fault, in the order of the catalogue, and last one that heals everything."""
    found = []
    for family, cls in list_variants():
        request: dict[str, Any] = {"unit": UNITS_OF[family][0], "for_s": FOR_S}
        for name, (_, default) in magnitudes_of(cls).items():
            value = NEEDED.get((family, cls.kind), {}).get(name) if default is NOTHING else default
            if value is not None:
                request[name] = value
        found.append(Button(f"/fault/{family}/{cls.kind}", family, f"{family} {cls.kind}".replace("_", " "), request))
    return (*found, Button(CLEAR, "all", "heal everything", {}))
