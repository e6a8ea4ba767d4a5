"""A cycle of the flight software's log as bytes at once: for the compiled build, where nothing is boxed on the way.

The plain one never imports this: there, packing many numbers by one call of struct is quicker.
"""

from __future__ import annotations

from typing import Final

from librt.strings import BytesWriter, write_f64_le

from bus.telemetry.native_packing import write3, write4
from fsw.flight import Flight

_writer: Final = BytesWriter()  # one for all: nothing can come in between while a function uses it


def pack_cycle(prefixes: tuple[bytes, bytes, bytes], head: bytes, flight: Flight, dropped: int) -> bytes:
    """Return the records of TICK_TOPICS, values in the order of `read_tick` and what `FlightLog` adds.

    prefixes : of the three records
    dropped  : ticks whose telemetry found no room so far
    """
    attitude, detection_prefix, timing = prefixes
    detection, counters = flight.detection, flight.executive
    estimate = detection.estimate
    writer = _writer
    writer.truncate(0)
    writer.write(attitude)
    writer.write(head)
    write4(writer, estimate.q_ib)
    write3(writer, estimate.omega_bi_b_rad_s)
    write3(writer, estimate.bias_b_rad_s)
    write4(writer, flight.error.q_tb)
    write_f64_le(writer, flight.error_deg)
    write4(writer, flight.guidance.target.q_it)
    writer.write(detection_prefix)
    writer.write(head)
    write3(writer, detection.fault_hat_b_rad_s)
    x, y, z = detection.gyro_state
    write3(writer, (float(x), float(y), float(z)))
    a, b, c, d = flight.health.alarm
    write4(writer, (1.0 if a else 0.0, 1.0 if b else 0.0, 1.0 if c else 0.0, 1.0 if d else 0.0))
    writer.write(timing)
    writer.write(head)
    write_f64_le(writer, counters.last_cycle_ns * 1e-3)
    write_f64_le(writer, counters.max_cycle_ns * 1e-3)
    write_f64_le(writer, counters.last_lateness_ns * 1e-3)
    write_f64_le(writer, float(dropped))
    return writer.getvalue()
