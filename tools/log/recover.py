"""`hilsat recover`: writes what a killed run left behind into a complete log, and says what is missing."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bus.errors import RecordError
from tools.log.completeness import EARLY, check_completeness
from tools.log.mcap_reader import Run
from tools.log.mcap_records import McapContent, Stretch
from tools.log.mcap_writer import McapWriter
from tools.log.outputs import create
from tools.log.recorder import FLUSH_S

UNFINISHED = "the recorder did not finish it: its disk was full, or it failed in another way"


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was found in a log, and what became of it."""

    path: str
    out: str | None  # None: there was nothing to write that the log is not already
    complete: bool  # nothing is missing, as far as the log itself tells
    closed: bool  # the file ends as it should: viewers take it as it is
    messages: int
    salvaged: int  # messages of these that came out of the chunk the file ends in
    last_s: float | None  # log time of the last message [s]
    cut_bytes: int  # at the end of the file, part of no whole record
    damaged_chunks: int
    lost: tuple[str, ...]  # what is missing, and why, in words
    holes: bool  # something else is missing than the end of the run


def recover(path: Path, out: Path, force: bool = False) -> Recovery:
    """Write a complete log with everything whole that `path` holds; return what was found.

    A log that is closed and not damaged is left alone, whatever it lacks: there is no more to be had from it. force: `out`
    may replace a file. Raises RecordError when `path` is no MCAP file or `out` cannot be written, UsageError when `out` is
    there already.
    """
    content = McapContent(path)
    found = _describe(content)
    if found.closed and not content.lost_chunks and not content.damage:
        return found
    with create(out, path, force) as part:
        found = dataclasses.replace(found, out=str(out))
        try:
            _write(content, part, found)
        except RecordError as error:
            raise RecordError(str(error).replace(str(part), str(out))) from None
    return found


def _describe(content: McapContent) -> Recovery:
    run = Run(content)
    completeness = check_completeness(run)
    lost = completeness.describe()
    unfinished = content.complete and "run" in run.metadata and not {"recording", "recovery"} & run.metadata.keys()
    if unfinished:
        lost.append(UNFINISHED)
    elif not content.complete:
        how = "the file ends inside a record" if content.size > content.whole else "the file has no end"
        lost.append(
            f"what came last: {how}; a recorder that is killed leaves about {FLUSH_S:g} s (wall time) unwritten"
        )
    last_ns = max((tally.last_ns for tally in content.tallies.values() if tally.last_ns is not None), default=None)
    return Recovery(
        path=str(content.path),
        out=None,
        complete=not lost,
        closed=content.complete,
        messages=sum(tally.count for tally in content.tallies.values()),
        salvaged=content.salvaged,
        last_s=None if last_ns is None else last_ns * 1e-9,
        cut_bytes=0 if content.complete else content.size - content.whole,
        damaged_chunks=len(content.lost_chunks),
        lost=tuple(lost),
        holes=unfinished
        or bool(completeness.damage)
        or any(gap.ran and gap.reason != EARLY for gap in completeness.gaps),
    )


def _write(content: McapContent, out: Path, found: Recovery) -> None:
    writer = McapWriter(out)
    try:
        for channel in content.channels.values():
            schema = content.schemas.get(channel.schema_id)
            text = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
            writer.add_channel(channel.id, channel.topic, channel.message_encoding, text, channel.metadata)
        for metadata in content.metadata:
            writer.add_metadata(metadata.name, metadata.metadata)
        for attachment in content.attachments:
            writer.add_attachment(attachment.name, attachment.media_type, attachment.data)
        for stretch in content.stretches():
            writer.write_chunk(_list_parts(content, stretch))
        values = {key: "; ".join(v) if isinstance(v, tuple) else str(v) for key, v in dataclasses.asdict(found).items()}
        writer.add_metadata("recovery", values)
        writer.close()
    except RecordError:
        writer.abandon()
        raise


def _list_parts(content: McapContent, stretch: Stretch) -> list[bytes]:
    """The messages of a chunk, without what else is in it and without those of channels that nothing is known of."""
    table = stretch.table
    known = [channel in content.channels for channel in table.channel.tolist()]
    if all(known) and int(table.size.sum()) == len(stretch.data):
        return [stretch.data]
    places = zip(known, table.offset.tolist(), table.size.tolist(), strict=True)
    return [stretch.data[at : at + size] for good, at, size in places if good]


def format_recovery(found: Recovery) -> str:
    """The finding for people."""
    until = "no message" if found.last_s is None else f"{found.messages} messages, the last at {found.last_s:.3f} s"
    if found.complete:
        return f"{found.path}: complete ({until}); nothing to recover"
    done = f"written to {found.out}" if found.out else "closed, so there is no more to recover; it is not complete"
    lines = [f"{found.path}: {until}; {done}"]
    if found.salvaged:
        lines.append(f"  {found.salvaged} of them out of the chunk that the file ends in")
    if found.cut_bytes:
        lines.append(f"  {found.cut_bytes} bytes at the end belong to no whole record")
    return "\n".join([*lines, *(f"  lost: {what}" for what in found.lost)])


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser("recover", help="make a killed run's log whole", description=__doc__)
    parser.add_argument("log", type=Path, help="MCAP file of a killed run")
    parser.add_argument("-o", "--out", type=Path, help="file to write (default: LOG with .recovered.mcap)")
    parser.add_argument("--force", action="store_true", help="replace a file of that name")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Recover; exit code 0 when nothing but the end of the run is missing, 3 when something before it is."""
    found = recover(args.log, args.out or args.log.with_suffix(".recovered.mcap"), args.force)
    if args.json:
        print(json.dumps(dataclasses.asdict(found)))
    else:
        print(format_recovery(found), file=sys.stdout)
    return 3 if found.holes else 0
