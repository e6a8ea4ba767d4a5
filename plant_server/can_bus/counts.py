"""What became of the frames on the wire, counted, and the topic that shows it."""

from __future__ import annotations

from typing import Final

from bus.telemetry.link import Field, Topic
from plant_server.faults.bus_nodes import NODES

TO_FSW, TO_PLANT = 0, 1  # directions, as the fields with two numbers have them
REASONS: Final = ("loss", "silent", "bus_off", "dominant", "overflow", "unacknowledged")
WAYS: Final = "to the flight software, to the plant"

BUS_CHANNEL: Final = 52
BUS = Topic(
    "/plant/bus",
    "hilsat/PlantBus",
    (
        Field(
            "sent", "float64", 2, "1", f"frames that nodes gave to the wire so far, SYNC and CYCLE_DONE apart: {WAYS}"
        ),
        Field("duplicated", "float64", 2, "1", "frames more that a fault made of one"),
        Field("inserted", "float64", 2, "1", "frames of babbling and masquerading nodes"),
        Field("delivered", "float64", 2, "1", "frames that arrived"),
        *(Field(f"lost_{reason}", "float64", 2, "1", f"frames lost for this reason: {reason}") for reason in REASONS),
        Field("waiting", "float64", 2, "1", "frames that are on their way"),
        Field("late", "float64", 2, "1", "frames that arrived on a later tick than the one they were sent on"),
        Field("broken", "float64", 2, "1", "frames that arrived with turned bits or another length"),
        Field("attempts_failed", "float64", 1, "1", "attempts to send a frame so far that ended in an error frame"),
        Field("error_frames", "float64", 1, "1", "error frames so far that the flight computer's controller reported"),
        Field("load", "float64", 1, "1", "share of the bits of the tick that ended now in which the bus was busy"),
        Field("tec", "float64", len(NODES), "1", f"transmit error counter of {', '.join(NODES)}"),
        Field("rec", "float64", len(NODES), "1", "receive error counter of the same"),
        Field("state", "float64", len(NODES), "1", "of the same: 0 error active, 1 error passive, 2 bus-off"),
    ),
    every="irregular",
)


class WireCounts:
    """Frames by what became of them: sent + duplicated + inserted = delivered + lost + waiting, in each direction."""

    __slots__ = ("attempts_failed", "broken", "delivered", "duplicated", "inserted", "late", "lost", "sent")

    def __init__(self) -> None:
        self.sent = [0, 0]
        self.duplicated = [0, 0]
        self.inserted = [0, 0]
        self.delivered = [0, 0]
        self.lost = {reason: [0, 0] for reason in REASONS}
        self.late = [0, 0]
        self.broken = [0, 0]
        self.attempts_failed = 0

    def is_conserved(self, waiting: tuple[int, int]) -> bool:
        """Return whether no frame has gone without a reason, and none has come from nowhere."""
        return all(
            self.sent[way] + self.duplicated[way] + self.inserted[way]
            == self.delivered[way] + sum(lost[way] for lost in self.lost.values()) + waiting[way]
            for way in (TO_FSW, TO_PLANT)
        )
