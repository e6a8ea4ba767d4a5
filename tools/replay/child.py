"""A process in which flight software flies on recorded inputs: `python -P child.py FD FEEDER`, started by process.py.

FD      : a socket to whoever feeds it
FEEDER  : path of feeder.py, which is run with whatever `bus` and `fsw` packages are found first on PYTHONPATH

Imports the standard library alone until it has spoken: what is missing in another version is to be named and not to end in
a traceback. Every piece is its length, four bytes, and so many bytes. First comes {config, sparse, tick_ns, run_hash}; the
answer is {topics, place, sparse} or {error, exit_code}. Then a cycle a piece: HEAD, commands, frames; the answer is ANSWER,
mode, frames, records; or, where it did not fly, JSON {error, exit_code} behind a byte 1.
"""

from __future__ import annotations

import importlib.util
import json
import socket
import struct
import sys
from types import ModuleType
from typing import Any

LENGTH = struct.Struct("<I")
HEAD = struct.Struct("<QIII")  # tick, slips, flags, bytes of the commands' text
ANSWER = struct.Struct("<BBI")  # 0, bytes of the mode, bytes of the frames
FAILED = b"\1"


def receive(wire: socket.socket) -> bytes:
    """One piece; b"" when nobody will send any more."""
    head = receive_exactly(wire, LENGTH.size)
    return receive_exactly(wire, LENGTH.unpack(head)[0]) if head else b""


def receive_exactly(wire: socket.socket, size: int) -> bytes:
    """So many bytes; b"" when the other end closed before."""
    pieces = []
    while size:
        piece = wire.recv(min(size, 1 << 20))
        if not piece:
            return b""
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)


def send(wire: socket.socket, piece: bytes) -> None:
    """One piece."""
    wire.sendall(LENGTH.pack(len(piece)) + piece)


def main() -> int:
    """Fly until whoever feeds it has no more."""
    wire = socket.socket(fileno=int(sys.argv[1]))
    try:
        feeder, commands_of, hello = _start(sys.argv[2], json.loads(receive(wire)))
    except Exception as error:
        send(wire, json.dumps(_explain(error)).encode())
        return 0
    send(wire, json.dumps(hello).encode())
    while piece := receive(wire):
        tick, slips, flags, size = HEAD.unpack_from(piece)
        text = piece[HEAD.size : HEAD.size + size].decode()
        try:
            commands = [commands_of(line) for line in text.split("\n")] if text else []
            frames, records = feeder.feed(tick, slips, flags, commands, piece[HEAD.size + size :])
            mode = feeder.mode.encode()
        except Exception as error:
            send(wire, FAILED + json.dumps(_explain(error)).encode())
            return 0
        send(wire, ANSWER.pack(0, len(mode), len(frames)) + mode + frames + records)
    return 0


def _start(path: str, given: dict[str, Any]) -> tuple[Any, Any, dict[str, Any]]:
    """The feeder, how it reads a command, and what is to be said of them."""
    module = _load(path)
    from bus.errors import ConfigError
    from bus.settings import build

    sparse = False
    try:
        config = build(module.FswConfig, given["config"], "fsw")
    except ConfigError:
        config, sparse = build(module.FswConfig, given["sparse"], "fsw"), True
    feeder = module.Feeder(config, given["tick_ns"], given["run_hash"])
    place = sys.modules["fsw"].__path__[0]
    return feeder, module.Command.from_json, {"topics": feeder.topics, "place": place, "sparse": sparse}


def _load(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location("replay_feeder", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _explain(error: Exception) -> dict[str, Any]:
    """What went wrong, for whoever feeds."""
    code = getattr(error, "exit_code", None)
    words = str(error) if code is not None else f"{type(error).__name__}: {error}"
    return {"error": words, "exit_code": code, "missing": isinstance(error, ImportError)}


if __name__ == "__main__":
    sys.exit(main())
