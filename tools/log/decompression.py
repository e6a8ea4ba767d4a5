"""Unpacks chunks within bounds: what a chunk says of its own size is the most that it may cost.

Compressed data has a size of its own inside, which a decompressor believes: 160 kB can ask for gigabytes. Here the size
that the chunk's head declares is the bound, and no chunk may declare more than MAX_CHUNK_BYTES.
"""

from __future__ import annotations

from typing import Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard

MAX_CHUNK_BYTES: Final = 64 * 1024 * 1024  # ours are 0.5 MB, those of other writers some MB


class DamagedData(Exception):
    """Data that is not what its head says. Never leaves the reading of a log: the chunk is left out and counted."""


def decompress(name: str, packed: bytes, size: int) -> bytes:
    """The `size` bytes of a chunk, packed with zstd, lz4 or nothing. Raises DamagedData when they are not there."""
    if size > MAX_CHUNK_BYTES:
        raise DamagedData(f"it declares {size} bytes, more than the {MAX_CHUNK_BYTES} that are read")
    try:
        data = _decompress(name, packed, size)
    except (zstandard.ZstdError, RuntimeError, MemoryError, EOFError, ValueError) as error:
        raise DamagedData(f"{name} data: {error}") from None
    if len(data) != size:
        raise DamagedData(f"it declares {size} bytes and has {'more' if len(data) > size else len(data)}")
    return data


def _decompress(name: str, packed: bytes, size: int) -> bytes:
    if name == "zstd":
        own = zstandard.get_frame_parameters(packed).content_size
        if own == size:
            return zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).decompress(packed, max_output_size=size)
        return _unpack_start("zstd", packed, size + 1)
    if name == "lz4":
        unpacker = lz4.frame.LZ4FrameDecompressor()
        data = bytes(unpacker.decompress(packed, max_length=size + 1))
        if not unpacker.eof:
            raise DamagedData("its lz4 data has no end")
        return data
    if name == "":
        return packed
    raise DamagedData(f'its compression "{name[:20]}" is not one of zstd, lz4, none')


def decompress_beginning(name: str, packed: bytes, size: int) -> bytes:
    """As many as there are of the `size` bytes of a chunk whose end is missing; nothing where even that fails."""
    try:
        return _unpack_start(name, packed, min(size, MAX_CHUNK_BYTES))
    except (zstandard.ZstdError, RuntimeError, MemoryError, EOFError, ValueError):
        return b""


def _unpack_start(name: str, packed: bytes, most: int) -> bytes:
    """The first bytes that come out, `most` at most."""
    if name == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).stream_reader(packed) as reader:
            return bytes(reader.read(most))
    if name == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most)) if most else b""
    return packed[:most]
