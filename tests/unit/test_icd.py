"""The ICD itself: what the DBC promises, and that everything generated from it is up to date."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import cantools
import pytest

from bus.icd.messages import IDS, MESSAGES, dbc_path
from bus.native import COMPILED
from tools.design.generate_codec import generate_codec, generate_table
from tools.design.generate_icd_page import generate_page
from tools.design.native_codec import generate_native_codec

ROOT = Path(__file__).resolve().parents[2]
DATABASE: Any = cantools.database.load_file(dbc_path())  # strict: raises for signals that overlap or leave their frame
EACH_MESSAGE = pytest.mark.parametrize("message", DATABASE.messages, ids=lambda message: message.name)
NODES = {"FSW", "PLANT", "RW1", "RW2", "RW3", "RW4", "GYRO", "STR"}

# Changing one of these breaks every recording and every peer: it must be meant.
CONTRACT = {
    0x080: ("SYNC", "PLANT", ["PHASE", "TICK"]),
    0x081: ("CYCLE_DONE", "FSW", ["MODE", "TICK", "SLIPS"]),
    0x100: ("TIME", "PLANT", ["RESERVED", "SECONDS", "FRACTION"]),
    **{0x110 + k: (f"RW{k + 1}_CMD", "FSW", ["MODE", "TORQUE", "SYNC_CNT"]) for k in range(4)},
    **{0x190 + k: (f"RW{k + 1}_TLM", f"RW{k + 1}", ["STATUS", "SPEED", "CURRENT", "SYNC_CNT"]) for k in range(4)},
    **{0x1A0 + k: (f"FOG{axis}_RATE", "GYRO", ["STATUS", "RATE", "SYNC_CNT"]) for k, axis in enumerate("XYZ")},
    0x1B0: ("STR_QA", "STR", ["AGE", "Q0", "Q1"]),
    0x1B1: ("STR_QB", "STR", ["AGE", "Q2", "Q3"]),
    0x701: ("HEARTBEAT_PLANT", "PLANT", ["RESERVED", "STATE", "RUN_HASH"]),
    0x702: ("HEARTBEAT_FSW", "FSW", ["RESERVED", "STATE", "RUN_HASH"]),
}


def test_messages_are_the_contract() -> None:
    """Ids, names, senders and signals are exactly those of the contract above, each id once."""
    found = {m.frame_id: (m.name, m.senders[0], [s.name for s in m.signals[2:]]) for m in DATABASE.messages}
    assert found == CONTRACT
    assert len(DATABASE.messages) == len(CONTRACT) == len({m.name for m in DATABASE.messages})


def test_nodes_are_the_units_of_the_bench() -> None:
    """Every sender and receiver is a declared node with a comment."""
    assert {node.name for node in DATABASE.nodes} == NODES
    assert all(node.comment for node in DATABASE.nodes)


@EACH_MESSAGE
def test_frame_is_classic_standard_and_full(message: Any) -> None:
    """11-bit id, 8 bytes, one sender, at least one receiver that is not the sender."""
    assert message.frame_id <= 0x7FF
    assert not message.is_extended_frame
    assert not message.is_fd
    assert message.length == 8
    assert len(message.senders) == 1
    assert message.receivers
    assert set(message.receivers) <= NODES - set(message.senders)


@EACH_MESSAGE
def test_protection_stands_in_the_same_place_everywhere(message: Any) -> None:
    """Byte 0 CHECKSUM, byte 1 COUNTER and one nibble: a receiver can check a frame before it knows what it is."""
    head = [(s.name, s.start, s.length, s.is_signed, s.scale, s.offset) for s in message.signals[:3]]
    assert head[0] == ("CHECKSUM", 0, 8, False, 1, 0)
    assert head[1] == ("COUNTER", 8, 4, False, 1, 0)
    assert head[2][1:] == (12, 4, False, 1, 0)


@EACH_MESSAGE
def test_signals_are_little_endian_whole_bytes_behind_the_head(message: Any) -> None:
    """Payload signals stand on whole bytes: they stay readable in a hex dump."""
    assert all(s.byte_order == "little_endian" for s in message.signals)
    assert all(s.start % 8 == 0 and s.length % 8 == 0 and s.start >= 16 for s in message.signals[3:])


@EACH_MESSAGE
def test_range_is_exactly_what_the_bits_hold(message: Any) -> None:
    """Minimum and maximum are the extreme raw values times the scale, to the nearest double."""
    for s in message.signals:
        low, high = (-(2 ** (s.length - 1)), 2 ** (s.length - 1) - 1) if s.is_signed else (0, 2**s.length - 1)
        scale = Fraction(repr(s.scale))
        assert (s.minimum, s.maximum) == (float(low * scale), float(high * scale)), s.name


def test_scales_and_units_are_the_contract() -> None:
    """Physical meaning of every scaled signal."""
    scaled = {(s.name, s.scale, s.unit) for m in DATABASE.messages for s in m.signals if s.scale != 1 or s.unit}
    assert scaled == {
        ("SECONDS", 1, "s"), ("FRACTION", 2**-16, "s"), ("TORQUE", 1e-7, "N m"), ("SPEED", 1e-3, "rad/s"),
        ("CURRENT", 1, "mA"), ("RATE", 1e-9, "rad/s"), *((f"Q{k}", 2**-23, None) for k in range(4)),
    }  # fmt: skip


@EACH_MESSAGE
def test_message_and_signals_have_comments(message: Any) -> None:
    """Who opens the DBC in another program finds every message and signal explained."""
    assert message.comment
    assert [s.name for s in message.signals if not s.comment] == []


@EACH_MESSAGE
def test_cycle_time_and_send_type(message: Any) -> None:
    """GenMsgCycleTime is set, and agrees with what the frame is sent per, at 100 Hz and 10 Hz."""
    base = message.dbc.attributes["CycleBase"]
    name = base.definition.choices[base.value]
    assert message.cycle_time == {"Tick": 10, "Star": 100, "Second": 1000}[name]
    assert message.send_type == "Cyclic"
    assert MESSAGES[message.frame_id].sent_per == name.lower()


def test_data_ids_are_unique_and_not_the_default() -> None:
    """A message without a data id of its own could be taken for another."""
    data_ids = [m.dbc.attributes["DataID"].value for m in DATABASE.messages]
    assert len(set(data_ids)) == len(data_ids)
    assert 0 not in data_ids


def test_commands_win_arbitration_over_telemetry() -> None:
    """The lower id wins a CAN bus: tick, then commands, then telemetry, then life signs."""
    kinds = ["SYNC", "RW4_CMD", "RW1_TLM", "FOGX_RATE", "STR_QA", "HEARTBEAT_PLANT"]
    assert [IDS[name] for name in kinds] == sorted(IDS[name] for name in kinds)
    assert max(IDS[f"RW{k}_CMD"] for k in range(1, 5)) < min(IDS[f"RW{k}_TLM"] for k in range(1, 5))


def test_value_tables() -> None:
    """Numbers that both sides and the graders know by name."""
    tables = {
        ("CYCLE_DONE", "MODE"): {0: "standby", 1: "detumble", 2: "point", 3: "safe", 4: "degraded"},
        ("RW1_CMD", "MODE"): {0: "off", 1: "torque"},
        ("RW1_TLM", "STATUS"): {0: "ok", 1: "fault", 2: "no_command", 3: "speed_limit"},
        ("FOGX_RATE", "STATUS"): {0: "ok", 1: "fault", 2: "out_of_range"},
        ("STR_QA", "AGE"): {15: "not_valid"},
        ("HEARTBEAT_FSW", "STATE"): {
            0: "boot", 4: "stopped", 5: "operational", 127: "pre_operational", 128: "failed",
        },
    }  # fmt: skip
    for (message, signal), choices in tables.items():
        found = next(s for s in MESSAGES[IDS[message]].signals if s.name == signal)
        assert found.choices == choices


def test_units_of_one_kind_differ_only_in_id_and_ends() -> None:
    """The four wheels, and the three gyro axes, speak the same language."""
    for kind, units in (("RW{}_CMD", "1234"), ("RW{}_TLM", "1234"), ("FOG{}_RATE", "XYZ")):
        first, *others = (MESSAGES[IDS[kind.format(unit)]].signals for unit in units)
        assert all(signals == first for signals in others)


@EACH_MESSAGE
def test_run_time_table_says_what_the_dbc_says(message: Any) -> None:
    """bus.icd.messages, which parses nothing, agrees with cantools' reading of the DBC."""
    ours = MESSAGES[message.frame_id]
    assert (ours.name, [ours.sender], set(ours.receivers)) == (message.name, message.senders, message.receivers)
    assert (ours.cycle_time_ms, ours.data_id) == (message.cycle_time, message.dbc.attributes["DataID"].value)
    assert [(s.name, s.start_bit, s.length_bits, s.is_signed) for s in ours.signals] == [
        (s.name, s.start, s.length, s.is_signed) for s in message.signals
    ]
    assert [(s.scale, s.minimum, s.maximum, s.unit, s.choices) for s in ours.signals] == [
        (s.scale, s.minimum, s.maximum, s.unit or "", {n: str(c) for n, c in (s.choices or {}).items()})
        for s in message.signals
    ]


@pytest.mark.parametrize(
    ("path", "generate", "command"),
    [
        ("bus/icd/codec.py", generate_codec, "generate_codec"),
        ("bus/icd/native_codec.py", generate_native_codec, "generate_codec"),
        ("bus/icd/message_table.py", generate_table, "generate_codec"),
        ("docs/icd.md", generate_page, "generate_icd_page"),
    ],
)
def test_generated_files_are_up_to_date(path: str, generate: Any, command: str) -> None:
    """A change of the DBC that was not carried into what is generated from it is caught here."""
    written = (ROOT / path).read_text(encoding="utf-8")
    assert written == generate(DATABASE), f"run: python -m tools.design.{command}"


def test_nothing_is_parsed_at_run_time() -> None:
    """The modules of the loop load neither cantools nor its parser: start-up time and the flight side's imports.

    Nor, not compiled, what only a compiled loop uses.
    """
    modules = "bus.icd.batches, bus.icd.messages, bus.icd.codec, bus.icd.e2e, bus.icd.load"
    unwanted = {"cantools", "textparser"}
    if not COMPILED:
        unwanted |= {"bus.icd.native_codec", "librt", "mypy_extensions"}
    code = f"import sys, {modules}; print({unwanted} & {{*sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
