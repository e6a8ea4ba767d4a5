"""candump's log format as the kernel's tools write it, error frames and remote frames included.

python-can's writer gives every error frame the class 0x80 and no data, and a remote frame no length.
"""

from __future__ import annotations

import can

from bus.wire.frames import EFF_FLAG, ERR_FLAG


class CandumpWriter(can.CanutilsLogWriter):
    """Writes lines like `(1.000000) bus0 20000004#0008000000006000` and `(1.100000) bus0 191#R8 R`."""

    def on_message_received(self, msg: can.Message) -> None:
        """Write one frame."""
        channel = "".join(letter if letter.isprintable() and letter != " " else "_" for letter in str(msg.channel))
        if not (msg.is_error_frame or msg.is_remote_frame):
            msg.channel = channel
            super().on_message_received(msg)
            return
        stamp_s = max(msg.timestamp, self.last_timestamp or 0.0)
        self.last_timestamp = stamp_s
        if msg.is_error_frame:
            what = f"{msg.arbitration_id | ERR_FLAG:08X}#{bytes(msg.data).hex().upper()}"
        else:
            can_id = f"{msg.arbitration_id & ~EFF_FLAG:08X}" if msg.is_extended_id else f"{msg.arbitration_id:03X}"
            what = f"{can_id}#R{msg.dlc or ''} R"
        self.file.write(f"({stamp_s:f}) {channel} {what}\n")
