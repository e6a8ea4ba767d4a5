"""Writes codec.py, native_codec.py and message_table.py in bus/icd from icd.dbc: `python -m tools.design.generate_codec`.

The loop has 25 us for a tick of 13 frames, each encoded and decoded. cantools takes 15 us to encode one frame and 4 us
to decode it, so the loop runs straight-line code generated from the same DBC; a test compares the two bit for bit.
What the generated code is made of, and why:

- One struct call per direction. The bits of counter and nibble share a 32-bit word with a following 24-bit signal:
  `round(x / scale) * 256 + nibbles` is in range for the word exactly where the signal is in range for its 24 bits, so
  that struct itself does the range check, and `word >> 8` extends the sign.
- `round(x / scale)` and `raw * scale` are the very operations of cantools; multiplying by 1 / scale would differ.
- Out-of-range values leave by an exception to one slow function that clamps them: the fast path has no comparison.
- The checksum comes from fastcrc: 53 ns for 7 bytes, where a table of 256 bytes takes 225 ns, one table per place
  225 ns and tables of 65536 bytes 186 ns. Its start value has the data id of the message in it (bus/icd/e2e.py).
- Frame header and checksum byte of a frame come as one of 256 ready-made byte strings.
- What a side receives on nearly every tick is one batch of the same frames in the same order. Its ids, lengths,
  padding, alive counters and statuses are known beforehand, so they are compared at once, as one number (140 ns for 8
  frames); a frame then costs little more than its checksum. What differs in one bit is decoded frame by frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools

from bus.icd.e2e import checksum_start, residue_start
from tools.design.codec_fields import BATCHES, GROUPS, Field, read_fields, wrap
from tools.design.native_codec import generate_native_codec

ICD = Path(__file__).resolve().parents[2] / "bus" / "icd"


@dataclass(frozen=True, slots=True)
class Layout:
    """Struct codes of bytes 1..7, and the expressions that go in and come out."""

    codes: str
    packed: tuple[str, ...]  # arguments of pack
    assignments: tuple[str, ...]  # statements ahead of pack
    names: tuple[str, ...]  # targets of unpack
    nibbles: str  # expression of byte 1 after unpack
    physical: tuple[str, ...]


def lay_out(fields: list[Field]) -> Layout:
    """Struct layout of bytes 1..7 for these signals."""
    codes, packed, assignments, names, physical = "B", ["nibbles"], [], ["nibbles"], []
    end = 2
    for field in fields:
        codes += "x" * (field.start - end)
        end = field.start + field.length // 8
        if field.length == 24 and field.signed and field.start == 2:
            codes, packed[0], names[0] = "i", f"{field.raw} * 256 + nibbles", "word"
            physical.append(field.physical("(word >> 8)"))
        elif field.length == 24 and field.signed:
            codes += "Hb"
            assignments.append(f"{field.name}_raw = {field.raw}")
            if names[0] == "word":
                assignments.append(f"word = {packed[0]}")
                packed[0] = "word"
            packed += [f"{field.name}_raw & 0xFFFF", f"{field.name}_raw >> 16"]
            names += [f"{field.name}_low", f"{field.name}_high"]
            physical.append(field.physical(f"({field.name}_high << 16 | {field.name}_low)"))
        else:
            code = {8: "b", 16: "h", 32: "i"}[field.length]
            codes += code if field.signed else code.upper()
            packed.append(field.raw)
            names.append(field.name)
            physical.append(field.physical(field.name))
    codes += "x" * (8 - end)
    nibbles = "word & 0xFF" if names[0] == "word" else "nibbles"
    return Layout(codes, tuple(packed), tuple(assignments), tuple(names), nibbles, tuple(physical))


def write_encoder(message: Any, fields: list[Field], layout: Layout) -> str:
    """Source of one encoder."""
    nibble = message.signals[2].name.lower()
    arguments = ", ".join([f"counter: int, {nibble}: int"] + [f"{f.name}: {f.kind_in}" for f in fields])
    values = ", ".join(["counter", nibble] + [f.name for f in fields])
    nibbles = f"_NIBBLES[{nibble}][counter]"
    body = [*layout.assignments, f"data = _pack_{layout.codes}({', '.join(layout.packed)})"]
    lines = [f"def encode_{message.name}({arguments}) -> bytes:"]
    lines.append(f'    """Frame 0x{message.frame_id:03X} as a 16-byte can_frame."""')
    lines.append("    try:")
    lines += [f"        {statement.replace('nibbles', nibbles)}" for statement in body]
    lines.append("    except _OUT_OF_RANGE:")
    lines.append(f"        return _saturate(0x{message.frame_id:03X}, {values})")
    start = checksum_start(message.dbc.attributes["DataID"].value)
    lines.append(f"    return _HEAD_{message.name}[_crc(data, 0x{start:02X})] + data")
    return "\n".join(lines)


def write_decoder(message: Any, fields: list[Field], layout: Layout) -> str:
    """Source of one decoder."""
    kinds = ", ".join(["int", "int"] + [f.kind_out for f in fields])
    start = residue_start(message.dbc.attributes["DataID"].value)
    nibble = message.signals[2].name.lower()
    values = ", ".join(["counter", nibble, *layout.physical])
    names = [f.name for f in fields]
    return "\n".join(
        [
            f"def decode_{message.name}(data: bytes) -> tuple[{kinds}] | None:",
            f'    """({", ".join(["counter", nibble, *names])}) of frame 0x{message.frame_id:03X}."""',
            "    try:",
            f"        checksum, {', '.join(layout.names)} = _unpack_{layout.codes}(data)",
            "    except error:",
            "        return None",
            f"    if _crc(data, 0x{start:02X}) != RESIDUES[checksum]:",
            "        return None",
            f"    counter, {nibble} = _SPLIT[{layout.nibbles}]",
            f"    return {values}",
        ]
    )


def write_group(function: str, messages: list[Any], fields: list[Field], layout: Layout) -> str:
    """Source of an encoder of several like messages in one go; nibbles and signals with a unit differ, counts do not."""
    nibble = messages[0].signals[2].name.lower()
    count = len(messages)
    measured = [f for f in fields if not f.is_count]
    arguments = [f"counter: int, {nibble}: Nibbles{count}"]
    arguments += [f"{f.name}: Floats{count}" if not f.is_count else f"{f.name}: {f.kind_in}" for f in fields]
    lines = [f"def encode_{function}({', '.join(arguments)}) -> bytes:"]
    lines.append(f'    """Frames 0x{messages[0].frame_id:03X}..0x{messages[-1].frame_id:03X} as {16 * count} bytes."""')
    unpacked = [nibble, *(f.name for f in measured)]
    lines += [f"    {', '.join(f'{name}_{k}' for k in range(count))} = {name}" for name in unpacked]
    lines += ["    try:", "        nibbles = _BY_COUNTER[counter]"]
    for k in range(count):
        packed = ", ".join(layout.packed)
        for f in measured:
            packed = packed.replace(f.name, f"{f.name}_{k}")
        packed = packed.replace("nibbles", f"nibbles[{nibble}_{k}]")
        lines.append(f"        data_{k} = _pack_{layout.codes}({packed})")
    lines += ["    except _OUT_OF_RANGE:", "        return ("]
    for k, message in enumerate(messages):
        values = ["counter", f"{nibble}_{k}"]
        values += [f.name if f.is_count else f"{f.name}_{k}" for f in fields]
        lines.append(f"            {'+ ' if k else ''}encode_{message.name}({', '.join(values)})")
    lines += ["        )", "    return _join(("]
    for k, message in enumerate(messages):
        start = checksum_start(message.dbc.attributes["DataID"].value)
        lines.append(f"        _HEAD_{message.name}[_crc(data_{k}, 0x{start:02X})], data_{k},")
    lines.append("    ))  # fmt: skip")
    return "\n".join(lines)


def write_batch(function: str, rows: Any, by_id: dict[int, Any], fields: dict[int, list[Field]]) -> str:
    """Source of the decoder of one tick's batch: values by signal, then by frame, in the order of the frames."""
    messages = [by_id[first + k] for first, count, _, _ in rows for k in range(count)]
    nibbles = [nibble for _, count, nibble, _ in rows for _ in range(count)]
    pieces = ""
    names: list[str] = []
    kinds: list[str] = []
    results: list[str] = []
    number = 0
    for first, count, _, labels in rows:
        read = [field for field in fields[first] if field.label in labels]
        targets, codes, values = read_signals(read)
        pieces += f"8x{codes}" * count
        names += [f"{target}_{number + k}" for k in range(count) for target in targets]
        for field, value in zip(read, values, strict=True):
            kinds += [field.kind_out] * count
            results += [value.replace(field.name, f"{field.name}_{number + k}") for k in range(count)]
        number += count
    upper = function.upper()
    nothing = ["0.0" if kind == "float" else "0" for kind in kinds[:-1]] + ["-1"]
    known = [f"(_HEAD_{m.name}, {nibble})" for m, nibble in zip(messages, nibbles, strict=True)]
    checks = "\n        or ".join(
        f"_crc(rest_{k}, 0x{checksum_start(m.dbc.attributes['DataID'].value):02X}) != sum_{k}"
        for k, m in enumerate(messages)
    )
    ids = ", ".join(f"0x{first:03X}..0x{first + count - 1:03X}" for first, count, *_ in rows)
    labels = [label.lower() for *_, labels in rows for label in labels]
    return f"""{upper}_SIZE: Final = {16 * number}
_BITS_{upper}, _KNOWN_{upper} = _know({wrap(known, 4, "(", ")")})
_sums_{function} = Struct("<" + "8xB7s" * {number}).unpack
_values_{function} = Struct("<{pieces}").unpack
_NO_{upper} = {wrap(nothing, 4, "(", ")")}


def decode_{function}({wrap(["batch: bytes", "counter: int"], 4, "", "")}) -> {wrap(kinds, 4, "tuple[", "]")}:
    \"""({", ".join(labels)}) of the frames {ids}, each signal frame by frame.

    tick is -1 unless these are exactly the frames, in this order, with this counter, the expected high nibbles and
    right checksums. With `counter` -1, none expected yet, it is -1 too.
    \"""
    if len(batch) != {16 * number} or _bits(batch, "little") & _BITS_{upper} != _KNOWN_{upper}[counter]:
        return _NO_{upper}
    {wrap([f"sum_{k}, rest_{k}" for k in range(number)], 8, "(", ")")} = _sums_{function}(batch)
    if (
        {checks}
    ):
        return _NO_{upper}
    {wrap(names, 8, "(", ")")} = _values_{function}(batch)
    return {wrap(results, 8, "(", ")")}"""


def read_signals(fields: list[Field]) -> tuple[list[str], str, list[str]]:
    """Names to unpack into, struct codes of all 8 data bytes, and values, where only these signals are wanted."""
    names, codes, values, at = [], "", [], 0
    for field in fields:
        names.append(field.name)
        if field.length == 24:  # the byte before it comes along and is shifted out
            codes += "x" * (field.start - 1 - at) + "i"
            values.append(field.physical(f"({field.name} >> 8)"))
        else:
            code = {8: "b", 16: "h", 32: "i"}[field.length]
            codes += "x" * (field.start - at) + (code if field.signed else code.upper())
            values.append(field.physical(field.name))
        at = field.start + field.length // 8
    return names, codes + "x" * (8 - at), values


HEADER = '''"""Codec of every message. Generated by tools/design/generate_codec.py from bus/icd/icd.dbc: do not edit.

encode_<NAME>(counter, nibble, *signals) returns a 16-byte Linux can_frame. Signals are physical values in DBC order,
rounded half-even; a value outside its range is sent as the nearest one inside it. Counter and nibble are 0..15 by
contract: above 15 goes as 15, below 0 is not looked for.
Raises ValueError for NaN and TypeError for a count that is not a whole number.

decode_<NAME>(data) returns (counter, nibble, *signals) of the 8 data bytes, or None where the checksum does not fit
data and id, or where the length is not 8. It raises on no bytes whatever.

decode_<batch>(batch, counter) takes all frames of one tick at once where they are what they nearly always are. Its last
value is the tick, or -1 everywhere else: then the frames must be looked at one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import index
from struct import Struct, error
from typing import Any, Final

from fastcrc.crc8 import sae_j1850 as _crc

from bus.icd.e2e import RESIDUES

Encoder = Callable[..., bytes]
Decoder = Callable[[bytes], tuple[Any, ...] | None]
Floats3 = tuple[float, float, float]
Floats4 = tuple[float, float, float, float]
Nibbles3 = tuple[int, int, int]
Nibbles4 = tuple[int, int, int, int]

_OUT_OF_RANGE = (error, IndexError, OverflowError, ValueError)
_NIBBLES = tuple(tuple(high << 4 | low for low in range(16)) for high in range(16))  # [high nibble][counter]
_BY_COUNTER = tuple(tuple(high << 4 | low for high in range(16)) for low in range(16))  # [counter][high nibble]
_SPLIT = tuple((byte & 15, byte >> 4) for byte in range(256))
_join = b"".join
_bits = int.from_bytes
'''

KNOW = '''
def _know(frames: tuple[tuple[tuple[bytes, ...], int | None], ...]) -> tuple[int, tuple[int, ...]]:
    """Which bits of a batch are known beforehand, as one number, and what they are, by alive counter.

    Known are the frame headers, the counter and, where given, the high nibble beside it. The last entry fits nothing.
    """
    mask, known = b"", [b""] * 15
    for heads, nibble in frames:
        mask += b"\\xff" * 8 + bytes((0, 0x0F if nibble is None else 0xFF)) + bytes(6)
        for counter in range(15):
            known[counter] += heads[0][:8] + bytes((0, (nibble or 0) << 4 | counter)) + bytes(6)
    return _bits(mask, "little"), (*(_bits(bits, "little") for bits in known), -1)
'''

SATURATE = '''

def _saturate(frame_id: int, *values: Any) -> bytes:
    """Frame with every value moved into its range. Raises ValueError for NaN, TypeError for a fraction of a count."""
    bounded = []
    for value, (label, minimum, maximum, is_count) in zip(values, _LIMITS[frame_id], strict=True):
        if value != value:
            raise ValueError(f"frame 0x{frame_id:03X}: {label} is not a number; the caller must send a finite value")
        bounded.append(min(max(index(value) if is_count else value, minimum), maximum))
    return ENCODERS[frame_id](*bounded)
'''


def write_limits(message: Any, fields: list[Field]) -> str:
    """Row of the table that the slow path uses."""
    nibble = message.signals[2].name
    rows: list[tuple[str, float, float, bool]] = [("COUNTER", 0, 15, True), (nibble, 0, 15, True)]
    rows += [(f.label, f.minimum, f.maximum, f.is_count) for f in fields]
    inner = "".join(f"        {row!r},\n" for row in rows).replace("'", '"')
    return f"    0x{message.frame_id:03X}: (\n{inner}    ),"


def generate_codec(database: Any) -> str:
    """Source text of bus/icd/codec.py."""
    messages = sorted(database.messages, key=lambda m: m.frame_id)
    fields = {m.frame_id: read_fields(m) for m in messages}
    layouts = {m.frame_id: lay_out(fields[m.frame_id]) for m in messages}
    by_id = {m.frame_id: m for m in messages}
    parts = [HEADER]
    for codes in sorted({layout.codes for layout in layouts.values()}):
        parts.append(f'_pack_{codes} = Struct("<{codes}").pack')
        parts.append(f'_unpack_{codes} = Struct("<B{codes}").unpack')
    parts.append('_heads = Struct("=IB3xB").pack  # can_id, dlc, padding, checksum byte')
    parts += [f"_HEAD_{m.name} = tuple(_heads(0x{m.frame_id:03X}, 8, byte) for byte in range(256))" for m in messages]
    parts.append(SATURATE)
    for m in messages:
        parts.append("\n" + write_encoder(m, fields[m.frame_id], layouts[m.frame_id]) + "\n")
        parts.append("\n" + write_decoder(m, fields[m.frame_id], layouts[m.frame_id]) + "\n")
    for function, first, count in GROUPS:
        group = [by_id[first + k] for k in range(count)]
        parts.append("\n" + write_group(function, group, fields[first], layouts[first]) + "\n")
    parts.append(KNOW)
    for function, rows in BATCHES:
        parts.append("\n" + write_batch(function, rows, by_id, fields) + "\n")
    parts.append("\n_LIMITS: dict[int, tuple[tuple[str, Any, Any, bool], ...]] = {")
    parts += [write_limits(m, fields[m.frame_id]) for m in messages]
    parts.append("}\n\nENCODERS: dict[int, Encoder] = {")
    parts += [f"    0x{m.frame_id:03X}: encode_{m.name}," for m in messages]
    parts.append("}\n\nDECODERS: dict[int, Decoder] = {")
    parts += [f"    0x{m.frame_id:03X}: decode_{m.name}," for m in messages]
    parts.append("}\n")
    return "\n".join(parts)


TABLE_HEADER = '''"""What the loop needs of bus/icd/icd.dbc. Generated by tools/design/generate_codec.py: do not edit.

Read through bus/icd/messages.py, which gives these rows their names.
"""

from __future__ import annotations

# (frame id, name, sender, receivers, sent once per, cycle time [ms], data id), signals
# signal: (name, start bit, length, signed, scale, minimum, maximum, unit, choices)
# fmt: off
ROWS = (
'''


def write_rows(message: Any) -> str:
    """One message as a literal."""
    attributes = message.dbc.attributes
    base = attributes["CycleBase"]
    head = (
        message.frame_id, message.name, message.senders[0], tuple(sorted(message.receivers)),
        base.definition.choices[base.value].lower(), message.cycle_time or 0, attributes["DataID"].value,
    )  # fmt: skip
    lines = [f"    ({head!r}, ("]
    for s in message.signals:
        choices = tuple((number, str(name)) for number, name in (s.choices or {}).items())
        row = (s.name, s.start, s.length, s.is_signed, s.scale, s.minimum, s.maximum, s.unit or "", choices)
        line = f"        {row!r},"
        lines.append(line if len(line) <= 120 else f"        {row[:-1]!r}"[:-1] + f",\n         {choices!r}),")
    return "\n".join([*lines, "    )),"]).replace("'", '"')


def generate_table(database: Any) -> str:
    """Source text of bus/icd/message_table.py."""
    rows = [write_rows(m) for m in sorted(database.messages, key=lambda m: m.frame_id)]
    return TABLE_HEADER + "\n".join(rows) + "\n)\n"


def main() -> None:
    """Write the generated modules beside the DBC."""
    database = cantools.database.load_file(ICD / "icd.dbc")
    (ICD / "codec.py").write_text(generate_codec(database), encoding="utf-8")
    (ICD / "native_codec.py").write_text(generate_native_codec(database), encoding="utf-8")
    (ICD / "message_table.py").write_text(generate_table(database), encoding="utf-8")


if __name__ == "__main__":
    main()
