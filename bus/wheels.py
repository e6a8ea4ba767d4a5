"""What a wheel is told and what it latches, by number, as its frames have it: modes, requests, bits."""

from __future__ import annotations

from typing import Final

OFF: Final = 0  # MODE of RWi_CMD: no torque
TORQUE: Final = 1  # the torque in the same frame
CURRENT: Final = 2  # the current in RWi_CURRENT_CMD
SPEED: Final = 3  # the speed in RWi_SPEED_CMD

CLEAR_LATCH: Final = 1  # ACTION of RWi_CTRL
RESET: Final = 2
POWER_OFF: Final = 3
POWER_ON: Final = 4
POWER_CYCLE: Final = 5
ACTIONS = {
    CLEAR_LATCH: "clear_latch",
    RESET: "reset",
    POWER_OFF: "power_off",
    POWER_ON: "power_on",
    POWER_CYCLE: "power_cycle",
}

OVERSPEED: Final = 1 << 0  # LATCH of RWi_POWER
EMF_LIMITED: Final = 1 << 1
OVERTEMP: Final = 1 << 2
UNDERVOLTAGE: Final = 1 << 3
COMMAND_STALE: Final = 1 << 4
ALL_BITS: Final = 0xFFFF
