"""The codec of what is sent on every tick: in native integers where this package is compiled, else bus/icd/codec.py.

Who imports a function from here calls that of bus/icd/native_codec.py straight where compiled: the compiler goes by the
first of two imports, which therefore is the native one. Where not compiled, neither that module nor librt is loaded.
"""

from __future__ import annotations

from bus.icd import codec
from bus.icd.codec import Decoder
from bus.native import COMPILED

__all__ = [
    "DECODERS",
    "decode_STR_QA",
    "decode_STR_QB",
    "decode_commands",
    "decode_sensors",
    "encode_CYCLE_DONE",
    "encode_STR_QA",
    "encode_STR_QB",
    "encode_SYNC",
    "encode_fogs",
    "encode_rw_cmds",
    "encode_rw_tlms",
]


if COMPILED:
    from bus.icd.native_codec import (
        decode_commands,
        decode_sensors,
        decode_STR_QA,
        decode_STR_QB,
        encode_CYCLE_DONE,
        encode_fogs,
        encode_rw_cmds,
        encode_rw_tlms,
        encode_STR_QA,
        encode_STR_QB,
        encode_SYNC,
    )
else:
    from bus.icd.codec import (
        decode_commands,
        decode_sensors,
        decode_STR_QA,
        decode_STR_QB,
        encode_CYCLE_DONE,
        encode_fogs,
        encode_rw_cmds,
        encode_rw_tlms,
        encode_STR_QA,
        encode_STR_QB,
        encode_SYNC,
    )

DECODERS: dict[int, Decoder] = codec.DECODERS | {0x1B0: decode_STR_QA, 0x1B1: decode_STR_QB}
