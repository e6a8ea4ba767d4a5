"""What may be wrong with a wheel, as wheel health names it and telemetry carries it."""

from __future__ import annotations

from typing import Final

NONE: Final = 0
UNKNOWN: Final = 1  # torque is missing, and the data cannot tell yet whether gain or friction took it
DRIVER_GAIN: Final = 2  # current against command
TORQUE_GAIN: Final = 3  # torque against current
FRICTION: Final = 4  # or a steady torque that opposes the spin: the same while the spin keeps its sense
BIAS: Final = 5  # a steady torque that drives the spin
SEIZED: Final = 6
RUNAWAY: Final = 7  # a current that is not the command's: stuck, or against it
DEAD: Final = 8  # no current, or no torque of it, whatever the command
SILENT: Final = 9  # no telemetry: nothing is known
WORDS: Final = {
    NONE: "nominal",
    UNKNOWN: "torque deficit, cause not known yet",
    DRIVER_GAIN: "driver gain",
    TORQUE_GAIN: "torque gain",
    FRICTION: "friction",
    BIAS: "bias torque",
    SEIZED: "seized",
    RUNAWAY: "runaway",
    DEAD: "no torque",
    SILENT: "no telemetry",
}
