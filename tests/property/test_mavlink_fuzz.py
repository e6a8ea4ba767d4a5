"""Whatever comes over the MAVLink side: it never raises, is counted, and JSON in parts comes together or not at all."""

from __future__ import annotations

import itertools
import json
import math
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.clock import SystemClock
from bus.mavlink import dialect
from bus.mavlink.component import Component, Identity, Traffic
from bus.mavlink.json_parts import MOST_PARTS, PART_SIZE, PENDING, Assembler, cut_reply, cut_request
from bus.mavlink.packets import LinkCounters, Packets, text_of
from bus.mavlink.parameters import Parameter, Parameters
from bus.run import GroundConfig
from plant_server.faults import KINDS, UNITS
from plant_server.ground import PlantGround, open_ground
from tools.run.bench import Bench

PLANT = (1, 25)
MESSAGES = sorted(dialect.mavlink_map)
NUMBERS = {
    "f": [math.nan, math.inf, -math.inf, -0.0, 1e38, -1e38, 3.4028234663852886e38, 1e-45, 0.0, 1.0, 420.0],
    "B": [0, 1, 25, 128, 255], "b": [-128, -1, 0, 127], "H": [0, 1, 420, 512, 65535], "h": [-32768, -1, 0, 32767],
    "I": [0, 1, 2**31, 2**32 - 1], "i": [-(2**31), -1, 0, 2**31 - 1],
    "Q": [0, 1, 2**63, 2**64 - 1], "q": [-(2**63), -1, 0, 2**63 - 1],
}  # fmt: skip


class Wire:
    """In place of an endpoint: hands packets in, keeps what is sent."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self._packets = Packets(*PLANT, self.counters)
        self.waiting: list[tuple[bytes, str]] = []
        self.sent: list[bytes] = []

    def poll(self, most: int = 8) -> list[tuple[Any, str]]:
        taken, self.waiting = self.waiting[:most], self.waiting[most:]
        return [(message, sender) for data, sender in taken for message in self._packets.read(data)]

    def try_send(self, message: Any, to: str) -> bool:
        self.sent.append(self._packets.write(message, len(self.sent) % 256))
        return True

    send = try_send

    def close(self) -> None:
        pass


def make_component() -> tuple[Component, Wire]:
    wire = Wire()
    store = [0.0]

    def write(value: float) -> str:
        store[0] = value
        return ""

    parameters = Parameters([Parameter("A", lambda: store[0], write), Parameter("B", lambda: math.nan)])
    traffic = Traffic(
        commands={420: lambda request: int(request.whole(1) is None) + int(request.number(2) > 0.0)},
        messages={2: lambda _: [dialect.MAVLink_system_time_message(0, 0)]},
        rates_hz={2: 50.0},
    )
    component = Component(
        wire, Identity(25, 18, 8, 0), SystemClock(), lambda: (0, 0, 4), parameters, traffic,  # type: ignore[arg-type]
        lambda asked: asked.reply("done", what=asked.what),
    )  # fmt: skip
    return component, wire


def pack(message: Any, seq: int = 0) -> bytes:
    protocol = dialect.MAVLink(None, 255, 190)
    protocol.seq = seq
    return bytes(message.pack(protocol))


def make_message(number: int, chance: random.Random) -> Any:
    """A message of this number with an odd value in each field; half of them for the component."""
    cls = dialect.mavlink_map[number]
    values: dict[str, Any] = {}
    for name, kind, count in zip(
        cls.ordered_fieldnames, cls.native_format[1:].decode(), cls.array_lengths, strict=False
    ):
        if kind in "cs" or cls.fieldtypes[cls.fieldnames.index(name)] == "char":
            values[name] = chance.choice([b"", b"A", b"\xff\xfe", b"x" * 16, b"a\0b"])
        elif count:
            values[name] = [chance.choice(NUMBERS[kind]) for _ in range(count)]
        else:
            values[name] = chance.choice(NUMBERS[kind])
    if chance.random() < 0.5:
        values |= {key: v for key, v in zip(("target_system", "target_component"), PLANT, strict=True) if key in values}
    return cls(*[values[name] for name in cls.fieldnames])


# -- packets -------------------------------------------------------------------------------------------------------


@given(st.binary(max_size=400))
def test_noise_never_raises_and_is_counted(data: bytes) -> None:
    """No message comes of it but by a checksum that fits; every datagram that is not empty is counted."""
    packets = Packets(*PLANT)
    packets.read(data)
    counters = packets.counters
    counted = counters.received + counters.garbage + counters.bad_checksum + counters.unknown
    assert (counted > 0) == bool(data)


@given(st.sampled_from(MESSAGES), st.integers(0, 2**32), st.data())
def test_cut_and_flipped_packets_never_raise(number: int, seed: int, data: st.DataObject) -> None:
    """One cut anywhere is garbage; one with a bit turned is no message, whichever bit it is."""
    whole = pack(make_message(number, random.Random(seed)))
    packets = Packets(*PLANT)
    assert len(packets.read(whole)) == 1
    cut = data.draw(st.integers(1, len(whole) - 1))
    assert packets.read(whole[:cut]) == []
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    flipped = bytearray(whole)
    flipped[bit // 8] ^= 1 << bit % 8
    assert packets.read(bytes(flipped)) == []
    counters = packets.counters
    assert counters.received == 1
    assert counters.garbage + counters.bad_checksum + counters.unknown >= 2


@pytest.mark.parametrize("number", MESSAGES)
def test_odd_values_in_every_field_of_every_message_never_raise(number: int) -> None:
    """200 of each: the component takes them, answers what is to be answered, and what it sends can be read."""
    chance = random.Random(number)
    component, wire = make_component()
    for i in range(200):
        wire.waiting.append((pack(make_message(number, chance), i % 256), f"peer {i % 20}"))
        component.poll()
    reader = Packets(255, 190)
    assert sum(len(reader.read(data)) for data in wire.sent) == len(wire.sent)
    counters = wire.counters
    assert counters.received == 200
    assert counters.garbage == counters.bad_checksum == counters.unknown == 0


@given(st.binary(max_size=40))
def test_texts_of_fields_are_texts(raw: bytes) -> None:
    """Whatever is in one, to its end mark; what is no UTF-8 is shown escaped."""
    text = text_of(raw)
    text.encode("utf-8")
    assert "\0" not in text
    if raw.isascii():
        assert text == raw.split(b"\0")[0].decode()


# -- JSON in parts -------------------------------------------------------------------------------------------------

LEAVES = st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False)
LEAVES |= st.text(max_size=300)
OBJECTS = st.dictionaries(
    st.text(max_size=8), LEAVES | st.lists(LEAVES, max_size=2) | st.dictionaries(st.text(max_size=3), LEAVES, max_size=2),
    max_size=3,
)  # fmt: skip


@given(OBJECTS, st.randoms(use_true_random=False))
def test_parts_in_any_order_and_doubled_come_together(what: dict[str, Any], chance: random.Random) -> None:
    """Each object exactly once by the time all parts are there, whatever their order; doubles give no second one at once."""
    messages = [reread(message) for message in cut_reply(what, 5, 0, 255, 190)]
    order = [*messages, *chance.sample(messages, k=len(messages) // 2)]
    chance.shuffle(order)
    assembler = Assembler()
    found = [done for message in order if (done := assembler.add(message)) is not None]
    assert found[0] == what
    assert len(found) <= 1 + len(messages) // 2


@given(OBJECTS, st.data())
def test_with_a_part_missing_nothing_comes(what: dict[str, Any], data: st.DataObject) -> None:
    """And the whole once it is sent again."""
    messages = [reread(message) for message in cut_request(what, 5, 255, 190)]
    lost = data.draw(st.integers(0, len(messages) - 1))
    assembler = Assembler()
    assert all(assembler.add(message) is None for i, message in enumerate(messages) if i != lost)
    assert assembler.add(messages[lost]) == what


@given(st.lists(OBJECTS, min_size=2, max_size=PENDING // 2), st.randoms(use_true_random=False))
def test_parts_of_several_texts_do_not_mix(texts: list[dict[str, Any]], chance: random.Random) -> None:
    """By sender and token, whatever the order in which they come."""
    messages = [(i, reread(message)) for i, what in enumerate(texts) for message in cut_request(what, i // 2, 255, 190)]
    chance.shuffle(messages)
    assembler = Assembler()
    found = {i: done for i, message in messages if (done := assembler.add(message, f"peer {i % 2}")) is not None}
    assert found == dict(enumerate(texts))


@given(st.integers(0, 2**32))
def test_parts_that_make_no_sense_give_nothing(seed: int) -> None:
    """Counts of 0, parts beyond them, lengths beyond the field, text that is no object: nothing, and little is kept."""
    chance = random.Random(seed)
    assembler = Assembler()
    for _ in range(200):
        text = chance.choice([b"[1]", b"{", b"\xff" * 9, b"3", b"nan", b'{"a":NaN}', b"[" * 230, b""]).ljust(
            PART_SIZE, b"\0"
        )
        message = dialect.MAVLink_hilsat_request_message(
            chance.randrange(2**32), 1, 25, chance.randrange(4), chance.randrange(4), chance.choice([0, 1, 9, 230, 255]),
            list(text),
        )  # fmt: skip
        done = assembler.add(reread(message), "peer")
        assert done is None or json.loads(json.dumps(done)) is not None
    assert len(assembler._pending) <= PENDING


def test_what_is_too_long_is_refused() -> None:
    """One byte more than fits."""
    most = MOST_PARTS * PART_SIZE - len('{"a":""}')
    assert len(cut_reply({"a": "x" * most}, 1, 0, 1, 1)) == MOST_PARTS
    with pytest.raises(ValueError, match="do not fit"):
        cut_reply({"a": "x" * (most + 1)}, 1, 0, 1, 1)


def reread(message: Any) -> Any:
    """The message as the other side gets it."""
    (found,) = Packets(255, 190).read(pack(message))
    return found


# -- the plant -----------------------------------------------------------------------------------------------------

NAMES = sorted({name for kinds in KINDS.values() for name in kinds})
MAGNITUDES = sorted({key for kinds in KINDS.values() for cls in kinds.values() for key in cls.__dataclass_fields__})
ODD = st.sampled_from(
    [0, 1, -1, 0.5, 1e300, -1e308, 1e-300, 10**30, 10**310, True, None, "", "x", "\ud800", "a\0b", [], {}, [[]], "1"]
)
FAULTS = st.fixed_dictionaries(
    {},
    optional={
        "unit": st.sampled_from(UNITS) | ODD, "kind": st.sampled_from(NAMES) | ODD, "at_s": ODD, "until_s": ODD, "id": ODD,
        "latch": ODD, "profile": st.sampled_from(["step", "pulse", "walk", "poisson"]) | ODD, "rise_s": ODD, "tau_s": ODD,
        "length_s": ODD, "period_s": ODD, "rate_per_h": ODD, **dict.fromkeys(MAGNITUDES, ODD),
    },
)  # fmt: skip
REQUESTS = st.fixed_dictionaries(
    {"do": st.sampled_from(["set", "set", "set", "clear", "list", "catalogue", "status"]) | ODD},
    optional={
        "fault": FAULTS | ODD, "at_tick": ODD, "for_s": ODD, "wait": ODD, "id": ODD, "unit": st.sampled_from(UNITS) | ODD,
        "x": ODD,
    },
)  # fmt: skip


@pytest.fixture(scope="module")
def plant() -> Iterator[tuple[Bench, PlantGround]]:
    bench = Bench.open("zhang2018", ["duration_s=20", "faults=[]", "expect=[]"], log="memory")
    with tempfile.TemporaryDirectory(prefix="hs-", dir="/tmp") as name:
        path = Path(name) / "p.sock"
        yield bench, open_ground(bench.plant_node, GroundConfig(socket=str(path), inject=True), SystemClock())


TOKENS = itertools.count(1)


@given(REQUESTS)
def test_no_request_to_a_plant_raises(plant: tuple[Bench, PlantGround], what: dict[str, Any]) -> None:
    """Each is answered, first by accepted, done or refused with reasons; what was accepted is in the list."""
    bench, ground = plant
    component = ground.component
    text = json.dumps(what)
    parts = [text[i : i + PART_SIZE].encode() for i in range(0, len(text), PART_SIZE)]
    token = next(TOKENS)
    before = len(bench.plant_node.plant.list_faults())
    for i, part in enumerate(parts):
        message = dialect.MAVLink_hilsat_request_message(
            token, *PLANT, i, len(parts), len(part), list(part.ljust(PART_SIZE, b"\0"))
        )
        component._take(reread(message), f"peer {token}")
    asked = component._asked[(f"peer {token}", 255, 190, token)]
    reply = json.loads(b"".join(bytes(m.text[: m.length]) for m in asked._replies[0]))
    if reply["state"] == "accepted" and what["do"] == "set":
        assert len(bench.plant_node.plant.list_faults()) == before + 1
    elif reply["state"] == "refused":
        assert reply["reasons"]
        assert all(isinstance(reason, str) and reason for reason in reply["reasons"])
    else:
        assert reply["state"] in ("accepted", "done")
    component._later.clear()
