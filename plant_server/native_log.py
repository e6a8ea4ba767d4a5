"""A tick of the plant's log as bytes at once: for the compiled build, where nothing is boxed on the way.

The plain one never imports this: there, packing many numbers by one call of struct is quicker.
"""

from __future__ import annotations

import math
from typing import Final

from librt.strings import BytesWriter, write_f64_le

from bus.attitude import rotate
from bus.telemetry.native_packing import write3, write4, write_frames
from plant_server.plant import Snapshot

_writer: Final = BytesWriter()  # one for all: nothing can come in between while a function uses it


def pack_tick(
    channel: int, head: bytes, frames: bytes, between: bytes, prefixes: tuple[bytes, bytes, bytes], now: Snapshot
) -> bytes:
    """Return the records of a tick: frames, whatever else there is, and the truth, as `PlantLog` orders them.

    prefixes : of the truth's records, in the order of TRUTH_FIELDS, as the values here are in that of `Plant.flatten`
    """
    attitude, wheels, gyro = prefixes
    writer = _writer
    writer.truncate(0)
    write_frames(writer, channel, head, frames)
    writer.write(between)
    writer.write(attitude)
    writer.write(head)
    write4(writer, now.q_ib)
    write3(writer, now.omega_bi_b_rad_s)
    write_f64_le(writer, math.nan)
    write3(writer, rotate(now.q_ib, now.momentum_b_nms))
    writer.write(wheels)
    writer.write(head)
    write4(writer, now.speed_rad_s)
    write4(writer, now.tau_rw_nm)
    write4(writer, now.command_nm)
    write3(writer, now.h_b_nms)
    tx, ty, tz = now.tau_b_nm
    cx, cy, cz = now.command_b_nm
    write3(writer, (tx - cx, ty - cy, tz - cz))
    write3(writer, now.external_b_nm)
    writer.write(gyro)
    writer.write(head)
    write3(writer, now.gyro_bias_rad_s)
    write3(writer, now.gyro_fault_rad_s)
    return writer.getvalue()
