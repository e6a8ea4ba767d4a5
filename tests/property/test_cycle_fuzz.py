"""Whatever arrives on the bus, a flight cycle never raises, and bad frames never move a control output.

Any 0..8 random bytes on any id; the only way in is a frame with the right length, checksum and alive counter.
"""

from __future__ import annotations

from struct import Struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.icd.codec import DECODERS, encode_fogs, encode_rw_tlms, encode_STR_QA, encode_STR_QB, encode_SYNC
from bus.settings import build
from bus.telemetry.link import Link, Row
from fsw.config import FswConfig
from fsw.flight import Flight
from fsw.flight_log import FlightLog

EXAMPLES = settings.default.max_examples
FRAME = Struct("=IB3x8s")
TICK_S = 0.1
CONFIG = build(
    FswConfig,
    {
        "model": {"inertia_kgm2": [[45, 3, 2], [3, 38, -1.5], [2, -1.5, 50]]},
        "estimator": {"kind": "direct"},
        "observer": {"kind": "ilo"},
        "controller": {"kind": "smc"},
    },
    "test",
)


class RowKeeper(Link):
    """Keeps the rows that it is handed."""

    def __init__(self) -> None:
        super().__init__(hold_ticks=1)
        self.rows: list[Row] = []

    def write_row(self, row: Row) -> None:
        self.rows.append(row)

    def write_json(self, topic: str, t_ns: int, payload: bytes) -> None: ...


ids = st.one_of(st.sampled_from(sorted(DECODERS)), st.integers(0, 0x7FF), st.integers(0, 0xFFFFFFFF))
frames = st.lists(st.tuples(ids, st.binary(max_size=8)), max_size=12)


def good_sensors(tick: int) -> bytes:
    counter = tick % 15
    return (
        encode_rw_tlms(counter, (0, 0, 0, 0), (10.0, -20.0, 30.0, 5.0), (0.0, 0.0, 0.0, 0.0), tick & 0xFF)
        + encode_fogs(counter, (0, 0, 0), (0.01, -0.005, 0.002), tick & 0xFF)
        + encode_STR_QA(counter, 0, 0.9, 0.3)
        + encode_STR_QB(counter, 0, -0.2, 0.2449489742783178)
        + encode_SYNC(counter, 0, tick)
    )


def pack(junk: list[tuple[int, bytes]]) -> bytes:
    return b"".join(FRAME.pack(can_id, len(data), data) for can_id, data in junk)


def is_bad(can_id: int, data: bytes) -> bool:
    decoder = DECODERS.get(can_id)
    return decoder is None or decoder(data) is None


@settings(max_examples=3 * EXAMPLES, deadline=None)
@given(frames, frames, frames)
def test_random_bytes_never_raise_and_never_reach_a_control_output(
    first: list[tuple[int, bytes]], second: list[tuple[int, bytes]], third: list[tuple[int, bytes]]
) -> None:
    """A flight with junk between its frames commands exactly what one without does, and counts every junk frame."""
    clean, disturbed = (Flight(CONFIG, TICK_S, 1) for _ in range(2))
    expected_refusals = 0
    for tick, junk in enumerate((first, second, third)):
        junk = [(can_id, data) for can_id, data in junk if is_bad(can_id, data)]
        expected_refusals += len(junk)
        sensors = good_sensors(tick)
        assert disturbed.cycle(tick, pack(junk) + sensors) == clean.cycle(tick, sensors)
    counters = disturbed.inputs.counters
    watch = disturbed.inputs.watch
    seen = counters.refused + counters.foreign + watch.error_frames + watch.flooded
    assert seen == expected_refusals
    assert disturbed.wheel_commands.tau_rw_nm == clean.wheel_commands.tau_rw_nm != (0.0, 0.0, 0.0, 0.0)


@settings(max_examples=3 * EXAMPLES, deadline=None)
@given(st.lists(frames, max_size=4))
def test_a_cycle_survives_nothing_but_junk(batches: list[list[tuple[int, bytes]]]) -> None:
    """With no good frame at all the flight software stays in standby or safe mode and commands no torque."""
    flight = Flight(CONFIG, TICK_S, 1)
    link = RowKeeper()
    log = FlightLog(flight, link, 1)
    for tick, junk in enumerate(batches):
        frames = pack([(i, d) for i, d in junk if is_bad(i, d)])
        flight.cycle(tick, frames)
        log.write(tick, frames, (), 0)
        assert len(log.pack_rows([link.rows.pop()])) == 1
        assert flight.wheel_commands.tau_rw_nm == (0.0, 0.0, 0.0, 0.0)


def test_stale_sensors_lead_to_safe_mode_and_back() -> None:
    """Silence of the units is safe mode with zero torque within the staleness limit; their return leads back."""
    flight = Flight(CONFIG, TICK_S, 1)
    tick = 0
    for tick in range(10):
        flight.cycle(tick, good_sensors(tick))
    assert flight.modes.mode.name == "POINT"
    for tick in range(10, 20):
        flight.cycle(tick, b"")
    assert flight.modes.mode.name == "SAFE"
    assert flight.wheel_commands.tau_rw_nm == (0.0, 0.0, 0.0, 0.0)
    for tick in range(20, 60):
        flight.cycle(tick, good_sensors(tick))
    assert flight.modes.mode.name == "POINT"
    assert flight.wheel_commands.tau_rw_nm != (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("repeat", [1, 3])
def test_a_repeated_frame_is_refused(repeat: int) -> None:
    """The same gyro frame again has the same alive counter: it is counted and not used twice."""
    flight = Flight(CONFIG, TICK_S, 1)
    flight.cycle(0, good_sensors(0) * (1 + repeat))
    assert flight.inputs.counters.refused == repeat * len(good_sensors(0)) // 16
