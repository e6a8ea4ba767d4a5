"""Layouts of telemetry messages: fixed-size records in CDR, described as ROS 2 .msg text.

CDR (OMG DDS-RTPS 2.2, section 10; DDS XTypes 1.2, section 7.4, plain CDR version 1) puts every primitive at a multiple
of its own size, counted from the byte after the 4-byte encapsulation header. MCAP calls the pair message encoding
`cdr` and schema encoding `ros2msg`; Foxglove, Lichtblick and PlotJuggler read both without a plugin.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal

from bus.errors import ConfigError

Rate = Literal["tick", "control", "diagnostic", "second", "irregular"]
Kind = Literal["float64", "uint64", "uint32", "int32", "uint8", "bool"]

ENCAPSULATION: Final = b"\x00\x01\x00\x00"  # CDR, little endian
STAMP_SIZE: Final = 8  # builtin_interfaces/Time: int32 sec, uint32 nanosec
STAMP_TEXT: Final = "builtin_interfaces/Time stamp"
STAMP_DEFINITION: Final = f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
FRAMES_SCHEMA: Final = "hilsat/msg/CanFrames"
FRAMES_TEXT: Final = (
    "# The frames of one tick in bus order, 16 bytes each, a Linux struct can_frame:\n"
    "# uint32 id (little endian; bit 31 extended, 30 remote, 29 error), uint8 dlc, 3 zero bytes, 8 data bytes.\n"
    f"{STAMP_TEXT}\nuint8[] frames\n{STAMP_DEFINITION}"
)
INPUT_SCHEMA: Final = "hilsat/msg/CycleInput"
INPUT_TEXT: Final = (
    "# Everything that one cycle of the flight software consumed, in this order: what its executive told it, the commands\n"
    "# due on its tick (one line of JSON each), the frames received since the cycle before (as in /can).\n"
    f"{STAMP_TEXT}\n"
    "uint32 slips  # deadlines missed so far\n"
    "uint32 flags  # 1: safe mode asked for by the executive, 2: groups that are not essential are shed\n"
    "uint32 crc  # CRC-32 over slips and flags (little endian), the commands' text, the frames\n"
    "string commands\n"
    f"uint8[] frames\n{STAMP_DEFINITION}"
)

# kind -> (struct code, size = alignment)
PRIMITIVES: Final[dict[str, tuple[str, int]]] = {
    "float64": ("d", 8), "uint64": ("Q", 8), "uint32": ("I", 4), "int32": ("i", 4), "uint8": ("B", 1), "bool": ("?", 1),
}  # fmt: skip

FIELD_NAME = re.compile(r"(?!.*__)[a-z][a-z0-9_]*(?<!_)")  # what a ROS 2 .msg accepts
SCHEMA_NAME = re.compile(r"[a-z][a-z0-9_]*/(?:msg/)?[A-Z][A-Za-z0-9]*")


@dataclass(frozen=True, slots=True)
class Field:
    """One named value, or `count` of them, of a topic. `kind` is the ROS 2 primitive."""

    name: str
    kind: Kind = "float64"
    count: int = 1
    unit: str = ""
    doc: str = ""

    def __post_init__(self) -> None:
        if not FIELD_NAME.fullmatch(self.name):
            raise ConfigError(
                f'telemetry field "{self.name}": a name has lower-case letters, digits and single underscores, '
                "starts with a letter and does not end with an underscore (ROS 2 .msg)"
            )
        if self.name == "stamp":
            raise ConfigError('telemetry field "stamp": every topic starts with a stamp by itself; choose another name')
        if self.kind not in PRIMITIVES:
            raise ConfigError(f'telemetry field "{self.name}": kind "{self.kind}" is none of {", ".join(PRIMITIVES)}')
        if self.count < 1:
            raise ConfigError(f'telemetry field "{self.name}": count {self.count} is not 1 or more')

    def ros2msg(self) -> str:
        """The line of the .msg text, with unit and meaning as its comment."""
        array = f"[{self.count}]" if self.count > 1 else ""
        comment = " ".join(part for part in (f"[{self.unit}]" if self.unit else "", self.doc) if part)
        return f"{self.kind}{array} {self.name}" + (f"  # {comment}" if comment else "")


@dataclass(frozen=True, slots=True)
class Topic:
    """A telemetry topic: records of fixed layout, stamped with the time of their tick.

    deterministic : equal from run to run for equal scenario and seed; only such topics enter the digest of a run
    every         : how often there is a record; `diagnostic` is the control period, unless it is shed;
                    `irregular`: whenever there is anything to say
    """

    name: str
    schema_name: str
    fields: tuple[Field, ...]
    deterministic: bool = True
    every: Rate = "tick"

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", tuple(self.fields))
        if not self.name.startswith("/"):
            raise ConfigError(f'telemetry topic "{self.name}": a topic starts with "/"')
        if not SCHEMA_NAME.fullmatch(self.schema_name):
            raise ConfigError(f'telemetry topic "{self.name}": schema "{self.schema_name}" is not like "hilsat/Name"')
        names = [field.name for field in self.fields]
        if len(set(names)) < len(names):
            raise ConfigError(f'telemetry topic "{self.name}": two fields have one name, in {", ".join(names)}')

    @property
    def message_type(self) -> str:
        """The ROS 2 resource name of the layout: package/msg/Type."""
        package, _, kind = self.schema_name.partition("/")
        return f"{package}/msg/{kind.removeprefix('msg/')}"

    def ros2msg(self) -> str:
        """The schema text that the log file carries."""
        lines = [STAMP_TEXT, *(field.ros2msg() for field in self.fields)]
        return "\n".join(lines) + "\n" + STAMP_DEFINITION

    @property
    def struct_format(self) -> str:
        """Format of everything after the stamp, for struct with `<`: explicit padding, one code per value."""
        return format_fields(self.fields)[0]

    @property
    def body_size(self) -> int:
        """Bytes of one message: encapsulation header, stamp and fields."""
        return len(ENCAPSULATION) + format_fields(self.fields)[1]

    @property
    def flat_size(self) -> int:
        """How many values the packer takes for this topic."""
        return sum(field.count for field in self.fields)


def format_fields(fields: tuple[Field, ...]) -> tuple[str, int]:
    """Struct codes of the fields after the stamp, and the CDR size of stamp and fields [bytes]."""
    codes, offset = [], STAMP_SIZE
    for field in fields:
        code, size = PRIMITIVES[field.kind]
        padding = -offset % size
        codes.append((f"{padding}x" if padding else "") + f"{field.count}{code}")
        offset += padding + field.count * size
    return "".join(codes), offset
