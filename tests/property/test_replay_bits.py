"""One bit of a recorded input that a forger has changed, checksum of the record included: the replay finds it, and where.

What holds, and is asked of every bit here:

- frames: id, length and data of an id that the flight software listens to: the frame is refused by its own checksum or
  missed. That shows on the tick itself in what was made of it, at the latest in the counters of the next control tick.
  A length over 8 cannot be received, and makes the record damaged. Three spare bytes of a frame carry nothing; an id that
  nobody listens to is counted as foreign before and after. Those, and nothing else, differ in nothing.
- slips: on the tick itself, or, where the bits are more than CYCLE_DONE carries, with the counters of the next control tick.
- flags: safe mode on the tick itself; shedding where something is there to shed; others are no flags and damage.
- commands: text that is no command any more is damage; a command that the ground could not have given is refused on its
  tick; another number shows when it first makes a difference, at the latest once the target moves. The words of who sent
  it, and the time that the tick stands for, are not read.
"""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import RecordError
from bus.telemetry.packing import HEAD as STAMP
from bus.telemetry.packing import PREFIX, pack_input
from tools.config.scenario import Resolved
from tools.log.mcap_reader import Run, read_run
from tools.replay.compare import Outcome, compare_replay
from tools.replay.flight_again import FlightAgain
from tools.replay.inputs import CycleInput, parse_input
from tools.run.bench import Bench

STRANGER: Final = 0x1FF  # an id that nobody listens to
COMMANDED: Final = 43  # tick
TARGET = "target_q: [0.8660254, 0.3, -0.2, 0.3464102], max_rate_deg_s: 0.4, max_acceleration_deg_s2: 0.01"
FAST: Final = (
    "zhang2018-flight",
    "duration_s=1.3",
    f"faults=[{{unit: bus, kind: babble, node: wheel.1, can_id: {STRANGER}, rate_hz: 100, at_s: 0.5}}]",
    f"fsw.timeline=[{{do: slew, at_s: {COMMANDED / 100}, {TARGET}}}]",
)
SLOW: Final = ("ithaco-hold", "duration_s=6", "fsw.modes.damping_nm_s=0.1")


class Flown(NamedTuple):
    """A run in memory."""

    run: Run
    resolved: Resolved
    inputs: dict[int, bytes]

    @property
    def control_ticks(self) -> int:
        """Ticks from one run of the control group to the next."""
        return self.resolved.scenario.fsw.executive.control_divider

    def replay(self, tick: int, forged: bytes) -> Outcome:
        """With another input on that tick."""
        scenario = self.resolved.scenario
        tick_ns = 1_000_000_000 // scenario.clock.tick_hz
        again = FlightAgain(scenario.fsw, tick_ns, self.resolved.run_hash)
        return compare_replay(self.run, again, tick_ns, lambda at, data: forged if at == tick else data)


def fly(path: Path, scenario: str, *overrides: str) -> Flown:
    with Bench.open(scenario, ["expect=[]", *overrides], log=path) as bench:
        bench.run_to_end()
    run = read_run(path)
    return Flown(run, bench.resolved, {record.sequence: record.data for record in run.iterate("/fsw/input")})


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """100 Hz, control every tenth tick, a command, and frames of a stranger from tick 50 on."""
    return fly(tmp_path_factory.mktemp("fast") / "run.mcap", *FAST)


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """10 Hz, control on every tick, wheels with slow telemetry."""
    return fly(tmp_path_factory.mktemp("slow") / "run.mcap", *SLOW)


def forge(data: bytes, **changes: Any) -> bytes:
    """The record of an input with something else in it, and a right checksum."""
    given_then = parse_input(0, data)
    text = "\n".join(command.to_json() for command in given_then.commands)
    parts = {"slips": given_then.slips, "flags": given_then.flags, "commands": text, "frames": given_then.frames}
    record = pack_input(1, STAMP.pack(0, 0, 0, *STAMP.unpack(bytes(20) + data[:12])[3:]), **(parts | changes))
    return record[PREFIX.size + STAMP.size - 12 :]


def flip(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def replay_or_damage(flown: Flown, tick: int, forged: bytes) -> int | str | None:
    """The tick of the first divergence, None for no divergence, "damaged" where the record is refused by its tick."""
    try:
        outcome = flown.replay(tick, forged)
    except RecordError as error:
        if f"/fsw/input of tick {tick} is damaged" not in str(error):
            raise
        return "damaged"
    return None if outcome.first is None else outcome.first.tick


def test_a_forgery_that_changes_nothing_is_the_record_itself(fast: Flown) -> None:
    """So what the tests below find is the bit that they changed, and not their own packing."""
    for tick in (0, COMMANDED, 60):
        assert forge(fast.inputs[tick]) == fast.inputs[tick]
    assert fast.replay(60, fast.inputs[60]).same


def choose_frame_bit(flown: Flown, seed: int) -> tuple[int, CycleInput, int]:
    """A tick, its input and a bit of its frames; every part of a frame as often as the data."""
    dice = random.Random(seed)
    tick = dice.randrange(len(flown.inputs) - flown.control_ticks)
    given_then = parse_input(tick, flown.inputs[tick])
    first, last = dice.choice([(0, 32), (32, 40), (40, 64), (64, 128), (64, 128)])
    return tick, given_then, 128 * dice.randrange(len(given_then.frames) // 16) + dice.randrange(first, last)


def judge_frame_bit(flown: Flown, seed: int) -> None:
    tick, given_then, bit = choose_frame_bit(flown, seed)
    frame, within = given_then.frames[bit // 128 * 16 :][:16], bit % 128
    changed = flip(given_then.frames, bit)
    found = replay_or_damage(flown, tick, forge(flown.inputs[tick], frames=changed))
    if 32 <= within < 40 and changed[bit // 128 * 16 + 4] > 8:
        assert found == "damaged"
        return
    stranger = int.from_bytes(frame[:4], "little") == STRANGER
    if 40 <= within < 64 or (stranger and within >= 32):  # spare bytes, and what nobody reads
        assert found is None
    elif stranger:
        listened = flip(frame, within)[:4]
        error_frame = within == 29
        known = int.from_bytes(listened, "little") in KNOWN_IDS
        assert (found is None) == (not known and not error_frame)
    else:
        assert isinstance(found, int)
        next_control = -(-tick // flown.control_ticks) * flown.control_ticks
        assert tick <= found <= next_control


KNOWN_IDS: Final = {0x080, 0x100, 0x701, *range(0x190, 0x194), *range(0x1A0, 0x1A3), 0x1B0, 0x1B1,
                    *range(0x290, 0x294), *range(0x390, 0x394)}  # fmt: skip


@given(seed=st.integers(0, 2**32))
def test_a_bit_of_a_frame_is_found_where_control_runs_less_often(fast: Flown, seed: int) -> None:
    """On its tick where it shows in the estimate or the answer, else at the next control tick; strangers excepted."""
    judge_frame_bit(fast, seed)


@given(seed=st.integers(0, 2**32))
def test_a_bit_of_a_frame_is_found_on_its_tick_where_control_runs_on_every_one(slow: Flown, seed: int) -> None:
    """Slow telemetry of the wheels included."""
    judge_frame_bit(slow, seed)


@given(tick=st.integers(0, 119), bit=st.integers(0, 31))
def test_a_bit_of_the_slips_is_found(fast: Flown, tick: int, bit: int) -> None:
    """CYCLE_DONE carries them on the tick itself; those beyond its field show in the counters of the next control tick."""
    found = replay_or_damage(
        fast, tick, forge(fast.inputs[tick], slips=parse_input(tick, fast.inputs[tick]).slips ^ 1 << bit)
    )
    assert isinstance(found, int)
    assert tick <= found <= -(-tick // 10) * 10


@given(tick=st.integers(0, 119), bit=st.integers(0, 31))
def test_a_bit_of_the_flags_is_found(fast: Flown, tick: int, bit: int) -> None:
    """Safe mode at once; unknown flags are damage; shedding leaves out diagnostics, on ticks that have any."""
    found = replay_or_damage(fast, tick, forge(fast.inputs[tick], flags=1 << bit))
    if bit == 0:
        assert found == tick
    elif bit == 1:
        diagnostics = {record.sequence for record in fast.run.iterate("/fsw/law")}
        assert found == (tick if tick in diagnostics else None)
    else:
        assert found == "damaged"


def list_changes(one: Any, two: Any, path: str = "") -> list[str]:
    """Paths of the leaves that two JSON values do not share."""
    if isinstance(one, dict) and isinstance(two, dict):
        return [p for key in one.keys() | two.keys() for p in list_changes(one.get(key), two.get(key), f"{path}.{key}")]
    return [] if one == two and type(one) is type(two) else [path]


UNREAD = {".origin", ".arguments.at_s"}
LIMITS = {".arguments.max_rate_deg_s", ".arguments.max_acceleration_deg_s2"}  # bind later than the log ends


@given(place=st.integers(0, 2**32), bit=st.integers(0, 6))
def test_a_bit_of_a_command_is_found(fast: Flown, place: int, bit: int) -> None:
    """Damage, a command refused on its tick, or another course from its tick on; words that nobody reads excepted."""
    (command,) = parse_input(COMMANDED, fast.inputs[COMMANDED]).commands
    text = command.to_json()
    changed = flip(text.encode(), 8 * (place % len(text)) + bit).decode()
    found = replay_or_damage(fast, COMMANDED, forge(fast.inputs[COMMANDED], commands=changed))
    try:
        changes = set(list_changes(json.loads(text), json.loads(changed)))
    except ValueError:
        assert found == "damaged"
        return
    if found == "damaged":
        assert changes - UNREAD
    elif changes <= UNREAD:
        assert found is None
    elif not changes & LIMITS and changes != {".tick"}:
        assert isinstance(found, int)
        assert COMMANDED <= found <= COMMANDED + 10


@pytest.mark.parametrize("bit", range(0, 96, 7))
def test_a_bit_of_the_stamp_is_found_on_its_tick(slow: Flown, bit: int) -> None:
    """Encapsulation, seconds and nanoseconds of the record: damage, or the first thing that differs."""
    found = replay_or_damage(slow, 20, flip(slow.inputs[20], bit))
    assert found in (20, "damaged")
