"""Decodes recorded frames in bulk with a DBC: every frame of a message at once, by shifts and masks over 64 bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


class MessageDecoder:
    """Decodes the frames of one message of a DBC.

    Raises RecordError for a text that is no DBC, a message that it has not, or one with multiplexed or float signals.
    """

    def __init__(self, dbc: str, name: str) -> None:
        self._message = _find_message(dbc, name)

    def select(self, frames: NDArray[Any]) -> NDArray[Any]:
        """The frames of the message that are long enough. frames: structured array with t_ns, id, dlc, data."""
        message = self._message
        flags = 0x80000000 if message.is_extended_frame else 0
        mine: NDArray[Any] = frames[(frames["id"] == message.frame_id | flags) & (frames["dlc"] >= message.length)]
        return mine

    def decode(self, mine: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Signal -> physical values, and `t_ns` [ns], of frames that were selected."""
        data = np.ascontiguousarray(mine["data"])
        little, big = data.view("<u8").ravel(), data.view(">u8").ravel().astype("<u8")
        decoded: dict[str, NDArray[Any]] = {"t_ns": mine["t_ns"].copy()}
        for signal in self._message.signals:
            decoded[signal.name] = _decode_signal(signal, little if signal.byte_order == "little_endian" else big)
        return decoded


def _find_message(dbc: str, name: str) -> Message:
    import cantools  # a third of what reading a log takes to start, and few readers decode
    from cantools.database.can import Database

    try:
        database = cantools.database.load_string(dbc, database_format="dbc", strict=False)
    except (cantools.Error, ValueError, KeyError, IndexError, RecursionError) as error:
        raise RecordError(f"the attached DBC cannot be read: {str(error)[:200]}") from None
    assert isinstance(database, Database)
    message = next((message for message in database.messages if message.name == name), None)
    if message is None:
        names = ", ".join(sorted(message.name for message in database.messages))
        raise RecordError(f"the DBC has no message {name}; there are: {names}")
    if message.length > 8:
        raise RecordError(f"{name} has {message.length} bytes: only messages of classic CAN are decoded in bulk")
    odd = [signal.name for signal in message.signals if signal.is_float or signal.multiplexer_ids is not None]
    if odd:
        raise RecordError(f"{name}: {', '.join(odd)} is multiplexed or a float, which is not decoded in bulk")
    return message


def _decode_signal(signal: Signal, words: NDArray[np.uint64]) -> NDArray[Any]:
    """Physical values: whole numbers stay whole where scale and offset are."""
    if signal.byte_order == "little_endian":
        shift = signal.start
    else:  # the start bit is the most significant one; DBC numbers bits from the right within each byte
        shift = 63 - (signal.start // 8 * 8 + 7 - signal.start % 8) - (signal.length - 1)
    raw = ((words >> np.uint64(shift)) & np.uint64((1 << signal.length) - 1)).astype(np.int64)
    if signal.is_signed:
        raw = np.where(raw >> (signal.length - 1) & 1, raw - (1 << signal.length), raw)
    scale, offset = signal.scale, signal.offset
    if scale == 1 and offset == 0:
        return raw
    return raw * scale + offset
