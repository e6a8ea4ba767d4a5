"""What both codecs are generated from: the payload signals of the DBC, and which frames go together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

GROUPS = (  # function, first frame id, number of frames
    ("rw_cmds", 0x110, 4),
    ("rw_tlms", 0x190, 4),
    ("fogs", 0x1A0, 3),
)
BATCHES = (  # function, (first frame id, number of frames, high nibble or None for any, signals that are read)
    ("sensors", ((0x190, 4, 0, ("SPEED", "CURRENT")), (0x1A0, 3, 0, ("RATE",)), (0x080, 1, 0, ("TICK",)))),
    ("commands", ((0x110, 4, 1, ("TORQUE", "SYNC_CNT")), (0x081, 1, None, ("TICK",)))),
)


@dataclass(frozen=True, slots=True)
class Field:
    """One payload signal as the generated code sees it."""

    name: str  # of the argument, with unit
    label: str  # of the signal in the DBC
    start: int
    length: int
    signed: bool
    scale: float
    minimum: float
    maximum: float
    is_count: bool  # whole number without unit: taken as int, not rounded

    @property
    def kind_in(self) -> str:
        """Type that the encoder takes."""
        return "int" if self.is_count else "float"

    @property
    def kind_out(self) -> str:
        """Type that the decoder returns."""
        return "int" if self.scale == 1 else "float"

    @property
    def raw(self) -> str:
        """Expression of the raw value, rounded half-even."""
        if self.is_count:
            return self.name
        return f"round({self.name})" if self.scale == 1 else f"round({self.name} / {self.scale!r})"

    def physical(self, raw: str) -> str:
        """Expression of the physical value."""
        return raw if self.scale == 1 else f"{raw} * {self.scale!r}"


def read_fields(message: Any) -> list[Field]:
    """Payload signals of a cantools message, in order of their place. Byte 0 and 1 are the same everywhere."""
    head = [(s.start, s.length, s.byte_order) for s in message.signals[:3]]
    if head != [(0, 8, "little_endian"), (8, 4, "little_endian"), (12, 4, "little_endian")] or message.length != 8:
        raise ValueError(f"{message.name}: bytes 0 and 1 must be CHECKSUM, COUNTER and one nibble, 8 bytes in all")
    return [read_field(message.name, signal) for signal in message.signals[3:]]


def read_field(message: str, signal: Any) -> Field:
    """One payload signal."""
    if signal.offset != 0 or signal.byte_order != "little_endian" or signal.start % 8:
        raise ValueError(f"{message}.{signal.name}: offset, big endian and bit positions are not supported")
    unit = signal.unit or ""
    name = signal.name.lower()
    is_count = signal.scale == 1 and not unit
    return Field(
        name=name if name.endswith("seconds") else name + suffix_of(unit),
        label=signal.name,
        start=signal.start // 8,
        length=signal.length,
        signed=signal.is_signed,
        scale=float(signal.scale) if signal.scale != 1 else 1,
        minimum=signal.minimum if is_count else float(signal.minimum),
        maximum=signal.maximum if is_count else float(signal.maximum),
        is_count=is_count,
    )


def suffix_of(unit: str) -> str:
    """What a name carries for a unit: "_nm" for "N m", "_rad_s" for "rad/s", nothing for none."""
    words = unit.replace(" ", "").replace("/", "_").replace("^", "").lower()
    return f"_{words}" if words else ""


def wrap(items: list[str], indent: int, opening: str, closing: str) -> str:
    """The items with commas between them: on one line where they are short, else on lines of at most 112 characters."""
    if sum(map(len, items)) < 60:
        return opening + ", ".join(items) + closing
    lines = [""]
    for item in items:
        if len(lines[-1]) + len(item) > 110 - indent:
            lines.append("")
        lines[-1] += f" {item}," if lines[-1] else f"{item},"
    return f"{opening}\n{' ' * indent}" + f"\n{' ' * indent}".join(lines) + f"\n{' ' * (indent - 4)}{closing}"
