"""`hilsat recover`: writes what a killed run left behind into a complete log, and says what is missing."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bus.errors import RecordError, UsageError
from tools.log.mcap_records import McapContent, read_content
from tools.log.mcap_writer import McapWriter
from tools.log.recorder import FLUSH_S


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was found in a log, and what became of it."""

    path: str
    out: str | None  # None: the log was complete and nothing was written
    complete: bool
    messages: int
    salvaged: int  # messages of these that came out of the chunk the file ends in
    last_s: float | None  # log time of the last message [s]
    cut_bytes: int  # at the end of the file, part of no whole record
    damaged_chunks: int


def recover(path: Path, out: Path) -> Recovery:
    """Write a complete log with everything whole that `path` holds; return what was found.

    A complete log is left alone. Raises RecordError when `path` is no MCAP file or `out` cannot be written, UsageError
    when both are one file.
    """
    content = read_content(path)
    if content.complete and not content.damaged_chunks:
        return _describe(content, None)
    if out.exists() and os.path.samefile(path, out):
        raise UsageError(f"{out}: this is the log to recover; name another file with -o")
    _write(content, out)
    return _describe(content, out)


def _describe(content: McapContent, out: Path | None) -> Recovery:
    last = max((int(s.table.log_time_ns.max()) for s in content.stretches if len(s.table.channel)), default=None)
    return Recovery(
        path=str(content.path),
        out=None if out is None else str(out),
        complete=content.complete and not content.damaged_chunks,
        messages=sum(len(stretch.table.channel) for stretch in content.stretches),
        salvaged=content.salvaged,
        last_s=None if last is None else last * 1e-9,
        cut_bytes=content.size - content.whole,
        damaged_chunks=content.damaged_chunks,
    )


def _write(content: McapContent, out: Path) -> None:
    writer = McapWriter(out)
    try:
        for channel in content.channels.values():
            schema = content.schemas.get(channel.schema_id)
            if schema is None and channel.schema_id:
                raise RecordError(f"{content.path}: {channel.topic} has no schema; this log cannot be made whole")
            text = (schema.name, schema.encoding, schema.data.decode()) if schema else ("", "", "")
            writer.add_channel(channel.id, channel.topic, channel.message_encoding, text, channel.metadata)
        for metadata in content.metadata:
            writer.add_metadata(metadata.name, metadata.metadata)
        for attachment in content.attachments:
            writer.add_attachment(attachment.name, attachment.media_type, attachment.data)
        for stretch in content.stretches:
            writer.write_chunk([stretch.data])
        found = _describe(content, out)
        writer.add_metadata("recovery", {key: str(value) for key, value in dataclasses.asdict(found).items()})
        writer.close()
    except RecordError:
        writer.abandon()
        raise


def format_recovery(found: Recovery) -> str:
    """The finding for people."""
    until = "no message" if found.last_s is None else f"{found.messages} messages, the last at {found.last_s:.3f} s"
    if found.complete:
        return f"{found.path}: complete ({until}); nothing to recover"
    lines = [f"{found.path}: {until}; written to {found.out}"]
    if found.salvaged:
        lines.append(f"  {found.salvaged} of them out of the chunk that the file ends in")
    if found.cut_bytes:
        lines.append(f"  {found.cut_bytes} bytes at the end belong to no whole record")
    if found.damaged_chunks:
        lines.append(f"  lost: {found.damaged_chunks} damaged chunks inside the file")
    lines.append(
        f"  lost: what was logged less than about {FLUSH_S:g} s (wall time) before the end; it was never written"
    )
    return "\n".join(lines)


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("recover", help="make a killed run's log whole", description=__doc__)
    parser.add_argument("log", type=Path, help="MCAP file of a killed run")
    parser.add_argument("-o", "--out", type=Path, help="file to write (default: LOG with .recovered.mcap)")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Recover; exit code 0 when everything whole is in the new file, 3 when chunks inside were damaged."""
    found = recover(args.log, args.out or args.log.with_suffix(".recovered.mcap"))
    if args.json:
        print(json.dumps(dataclasses.asdict(found)))
    else:
        print(format_recovery(found), file=sys.stdout)
    return 3 if found.damaged_chunks else 0
