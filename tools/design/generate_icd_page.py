"""Writes docs/icd.md from bus/icd/icd.dbc: `python -m tools.design.generate_icd_page`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools

from bus.icd.load import BIT_RATES_BPS, LOAD_LIMIT, bus_load

ROOT = Path(__file__).resolve().parents[2]
TICK_RATES_HZ = (10, 50, 100, 200)
STAR_RATE_HZ = 10
WHEEL_SETS = (  # title, wheels with slow telemetry, wheels that follow a setpoint
    ("Four ideal wheels:", 0, 0),
    ("Four wheels with a motor of their own, which send slow telemetry; a request on every tick:", 4, 0),
    ("As before, and each of them follows a current or a speed:", 4, 4),
)

INTRODUCTION = """# The bus: interface control document

Generated from `bus/icd/icd.dbc` by `python -m tools.design.generate_icd_page`. Do not edit this page: edit the DBC, then
run that and `python -m tools.design.generate_codec`.

The flight software and the plant know each other only through these frames: classic CAN, 11-bit ids, 8 bytes, little
endian. On every transport a frame is a 16-byte Linux `struct can_frame`. Cycle times below hold for ticks at 100 Hz and
a star tracker at 10 Hz; the scenario sets the real ones.

Ids are shaped like CANopen's (SYNC 0x080, TIME 0x100, heartbeat 0x700 + node); the CANopen protocol is not claimed.

## Every frame

| byte | bits | signal | meaning |
|---|---|---|---|
| 0 | 0-7 | CHECKSUM | {checksum} |
| 1 | 0-3 | COUNTER | {counter} |
| 1 | 4-7 | named per message | a 4-bit state, below |
| 2-7 | | payload | below; unused bytes are 0 |

## How a wheel is told what to do

RWi_CMD comes on every tick and names the mode. In mode torque its own TORQUE counts. In modes current and speed the
setpoint comes in a frame of its own, RWi_CURRENT_CMD or RWi_SPEED_CMD, beside it on every tick, and TORQUE is not looked
at. So one frame decides the mode, and a wheel that hears no RWi_CMD, or none of the setpoints that it is told to follow,
has no command: it coasts, says so in STATUS, and latches it. Only wheels with a motor of their own know current and speed.

RWi_CTRL asks for something once: to clear what is latched, a reset, power off or on. It is not answered; what became of it
is seen in RWi_POWER (LATCH, UPTIME). A wheel of the ideal kind has neither supply nor latch and sends no RWi_TEMP and no
RWi_POWER; it coasts while its power is off, and a reset ends faults that last until one.

RWi_TLM has the commands' and sensors' pace and its place in the batch of a tick. RWi_TEMP and RWi_POWER have higher ids, so
that they never hold back a frame of the loop; their eight frames are spread over the second. A receiver holds them for three
seconds.

## Values

Physical value = raw value x scale. The in-loop codec (`bus/icd/codec.py`, generated too) rounds half-even and sends a
value that is out of range as the nearest one in range.
"""


def write_overview(messages: list[Any]) -> list[str]:
    """Table of all messages."""
    lines = ["## Messages", "", "| id | name | from | to | sent | data id |", "|---|---|---|---|---|---|"]
    for m in messages:
        data_id = m.dbc.attributes["DataID"].value
        receivers = ", ".join(sorted(m.receivers))
        lines.append(
            f"| 0x{m.frame_id:03X} | [{m.name}](#{m.name.lower()}) | {m.senders[0]} | {receivers} | "
            f"{read_cycle(m)} | 0x{data_id:04X} |"
        )
    return lines


def read_cycle(message: Any) -> str:
    """When a message is sent, in words."""
    base = message.dbc.attributes["CycleBase"]
    name = base.definition.choices[base.value]
    return {
        "Tick": f"every tick ({message.cycle_time} ms at 100 Hz)",
        "Star": f"every star-tracker measurement ({message.cycle_time} ms at 10 Hz)",
        "Second": "once a second",
        "Setpoint": f"every tick ({message.cycle_time} ms at 100 Hz) while RWi_CMD asks for its mode",
        "Slow": "once a second by a wheel with a motor of its own",
        "Request": "on request, one frame a tick at most",
    }[name]


def write_message(message: Any) -> list[str]:
    """Section of one message."""
    lines = ["", f"### {message.name}", "", f"0x{message.frame_id:03X}. {message.comment}", ""]
    lines += ["| signal | start bit | bits | scale | range | unit | meaning |", "|---|---|---|---|---|---|---|"]
    for s in message.signals[2:]:
        meaning = s.comment
        if s.choices:
            meaning += " " + ", ".join(f"{number} {name}" for number, name in s.choices.items()) + "."
        kind = "signed" if s.is_signed else "unsigned"
        lines.append(
            f"| {s.name} | {s.start} | {s.length} {kind} | {s.scale!r} | {s.minimum!r} .. {s.maximum!r} | "
            f"{s.unit or '-'} | {meaning} |"
        )
    return lines


def write_load() -> list[str]:
    """Table of the worst-case bus load."""
    lines = ["", "## Worst-case bus load", ""]
    lines.append(
        f"Every frame with as many stuff bits as CAN allows (135 bits for 8 bytes), star tracker at {STAR_RATE_HZ} Hz. "
        f"A scenario above {100 * LOAD_LIMIT:.0f} % is refused."
    )
    for title, motor_wheels, setpoint_wheels in WHEEL_SETS:
        lines += ["", title, "", "| bit rate | " + " | ".join(f"{rate} Hz" for rate in TICK_RATES_HZ) + " |"]
        lines.append("|---" * (1 + len(TICK_RATES_HZ)) + "|")
        for bit_rate in BIT_RATES_BPS:
            cells = []
            for tick_rate in TICK_RATES_HZ:
                load = bus_load(tick_rate, STAR_RATE_HZ, bit_rate, motor_wheels, setpoint_wheels)
                cells.append(f"{100 * load:.1f} %" + (" (refused)" if load > LOAD_LIMIT else ""))
            lines.append(f"| {bit_rate // 1000} kbit/s | " + " | ".join(cells) + " |")
    return lines


def generate_page(database: Any) -> str:
    """Text of docs/icd.md."""
    messages = sorted(database.messages, key=lambda m: m.frame_id)
    checksum, counter = messages[0].signals[:2]
    lines = [INTRODUCTION.format(checksum=checksum.comment, counter=counter.comment)]
    lines += write_overview(messages)
    lines += ["", "## Nodes", ""]
    lines += [f"- {node.name}: {node.comment}" for node in database.nodes]
    lines += ["", "## Payloads"]
    for message in messages:
        lines += write_message(message)
    lines += write_load()
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the page."""
    database = cantools.database.load_file(ROOT / "bus" / "icd" / "icd.dbc")
    (ROOT / "docs" / "icd.md").write_text(generate_page(database), encoding="utf-8")


if __name__ == "__main__":
    main()
