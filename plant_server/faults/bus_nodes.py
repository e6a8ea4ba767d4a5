"""Who sends what to whom on the bus, as far as its faults need to know: by node, the names that a fault gives them."""

from __future__ import annotations

from typing import Final, Literal

Node = Literal["all", "wheel.1", "wheel.2", "wheel.3", "wheel.4", "gyro", "star_tracker", "plant", "fsw"]

ALL: Final = "all"
FSW: Final = "fsw"
PLANT: Final = "plant"  # what sends TIME and the plant's heartbeat, and hears that of the flight software
WHEEL_NODES: Final = ("wheel.1", "wheel.2", "wheel.3", "wheel.4")
NODES: Final = (*WHEEL_NODES, "gyro", "star_tracker", PLANT, FSW)

PACING_IDS: Final = (0x080, 0x081)  # SYNC and CYCLE_DONE: the beat of the test bench, which no fault of the bus touches

ROUTES: Final[dict[int, tuple[str, str]]] = {  # by id: who sends it, and to whom it is
    **{0x1A0 + axis: ("gyro", FSW) for axis in range(3)},
    **{0x1B0 + half: ("star_tracker", FSW) for half in range(2)},
    **{base + i: (node, FSW) for base in (0x190, 0x290, 0x390) for i, node in enumerate(WHEEL_NODES)},
    **{base + i: (FSW, node) for base in (0x110, 0x120, 0x130, 0x300) for i, node in enumerate(WHEEL_NODES)},
    0x100: (PLANT, FSW),
    0x701: (PLANT, FSW),
    0x702: (FSW, PLANT),
}


def find_route(can_id: int, from_fsw: bool) -> tuple[str, str]:
    """Return sender and receiver of an id; of one that no node has, by the side that it comes from."""
    known = ROUTES.get(can_id)
    if known is not None and (known[0] == FSW) == from_fsw:
        return known
    return (FSW, PLANT) if from_fsw else (PLANT, FSW)
