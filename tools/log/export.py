"""`hilsat export`: signals of a log as CSV or npz, frames as candump log, ASC or BLF.

hilsat export run.mcap --to csv --topic /truth/attitude > attitude.csv
hilsat export run.mcap --to csv -o directory            one file for each topic
hilsat export run.mcap --to npz -o run.npz              all signals; keys like truth.attitude.error_deg
hilsat export run.mcap --to log -o run.log              frames for canplayer, cantools, SavvyCAN
hilsat export run.mcap --to scene -o scene.mcap         a copy with a 3D scene for Foxglove, for a log without one

What the log lacks, and topics that cannot be read, are named on stderr. Files that are there already stay as they are.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, TextIO

import can
import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError, UsageError
from bus.telemetry.cdr import FRAMES_SCHEMA
from bus.words import suggest
from tools.log.candump import CandumpWriter
from tools.log.completeness import warn_of_missing
from tools.log.mcap_reader import Run, read_run
from tools.log.outputs import create
from tools.log.python_can_mcap import iterate_frames

FRAME_WRITERS: Final[dict[str, type[Any]]] = {"log": CandumpWriter, "asc": can.ASCWriter, "blf": can.BLFWriter}
FORMATS: Final = ("csv", "npz", *FRAME_WRITERS, "scene")
SCENE_PREFIX: Final = "/scene/"  # pictures, not signals: exported only when they are named


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "export", help="write a log's signals or frames in another format", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("log", type=Path, help="MCAP file")
    parser.add_argument(
        "--to", choices=FORMATS, required=True, help="csv, npz: signals; log, asc, blf: frames; scene: a log"
    )
    parser.add_argument("--topic", action="append", default=[], metavar="T", help="only this topic; may be repeated")
    parser.add_argument("-o", "--out", type=Path, help="file, or directory for csv of several topics; csv: stdout")
    parser.add_argument("--force", action="store_true", help="replace files of that name")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Export; exit code 0, also where some topics cannot be read, which is said; 3 where none can."""
    log = read_run(args.log)
    for topic in args.topic:
        if topic not in log.topics:
            hint = suggest(topic, log.topics)
            raise UsageError(f"{args.log}: there is no topic {topic}; {hint}there are: {', '.join(sorted(log.topics))}")
    warn_of_missing(log, "export")
    if args.to == "csv":
        export_csv(log, args.topic, args.out, args.force)
    elif args.out is None:
        raise UsageError(f"--to {args.to} needs a file to write: -o FILE.{'mcap' if args.to == 'scene' else args.to}")
    elif args.to == "npz":
        export_npz(log, args.topic, args.out, args.force)
    elif args.to == "scene":
        export_scene(log, args.out, args.force)
    else:
        export_frames(log, args.topic, args.out, args.to, args.force)
    return 0


def _skip(topic: str, error: Exception) -> None:
    print(f"hilsat export: {topic} is left out: {error}", file=sys.stderr)


# -- csv -----------------------------------------------------------------------------------------------------------


def export_csv(log: Run, topics: list[str], out: Path | None, force: bool = False) -> None:
    """Write one topic to a file or stdout, or several into a directory. Floats keep all their digits.

    Of several topics, one that cannot be read is left out and named; RecordError when none can.
    """
    if len(topics) == 1 and (out is None or not out.is_dir()):
        if out is None:
            write_csv(log, topics[0], sys.stdout)
        else:
            _write_csv_file(log, topics[0], out, force)
        return
    if out is None:
        raise UsageError(
            f"csv on stdout takes one --topic of: {', '.join(sorted(log.topics))}; or name a directory, -o DIR"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{out}: cannot make the directory: {error.strerror}") from None
    done = 0
    for topic in topics or [name for name in log.topics if not name.startswith(SCENE_PREFIX)]:
        try:
            _write_csv_file(log, topic, out / f"{_name_file(topic)}.csv", force)
            done += 1
        except RecordError as error:
            _skip(topic, error)
    if not done and log.topics:
        raise RecordError(f"{log.path}: none of its topics can be written")


def _name_file(topic: str) -> str:
    """A file name for a topic, which is any text: no other directory, not hidden, not too long."""
    return re.sub(r"[^\w.+-]", "_", topic.strip("/").replace("/", "."))[:200].lstrip(".") or "topic"


def _write_csv_file(log: Run, topic: str, path: Path, force: bool) -> None:
    with create(path, log.path, force) as part, open(part, "w", newline="", encoding="utf-8") as file:
        write_csv(log, topic, file)


def write_csv(log: Run, topic: str, file: TextIO) -> None:
    """Write one topic: a header line, then one line a record (one a frame for frames); t_s first."""
    info = log.topics[topic]
    if info.schema_name == FRAMES_SCHEMA:
        _write_frames(log, topic, file)
    elif info.encoding == "cdr":
        _write_signals(log, topic, file)
    elif info.encoding == "json":
        _write_json(log, topic, file)
    else:
        raise RecordError(f"{topic} is {info.encoding[:40] or 'of no encoding'}, which cannot be written as csv")


def _write_frames(log: Run, topic: str, file: TextIO) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["t_s", "id", "dlc", "data"])
    for frames in log.iterate_frames(topic.removeprefix("/can/")):
        data = frames["data"].tobytes()
        columns = (frames[name].tolist() for name in ("t_ns", "id", "dlc"))
        for number, (t_ns, can_id, dlc) in enumerate(zip(*columns, strict=True)):
            writer.writerow([t_ns * 1e-9, f"{can_id:#05x}", dlc, data[8 * number : 8 * number + min(dlc, 8)].hex()])


def _write_signals(log: Run, topic: str, file: TextIO) -> None:
    writer = csv.writer(file, lineterminator="\n")
    fields = log.signals(topic)
    names = fields.fields
    shapes = {name: fields.layout[name].shape for name in names}
    writer.writerow(
        ["t_s", *(column for name in names for column in (_index(name, shapes[name][0]) if shapes[name] else [name]))]
    )
    for t_ns, table in log.iterate_tables(topic):
        columns: list[list[Any]] = [(t_ns * 1e-9).tolist()]
        for name in names:
            columns += [column.tolist() for column in _split_columns(table[name])]
        writer.writerows(zip(*columns, strict=True))


def _index(name: str, count: int) -> list[str]:
    return [f"{name}[{index}]" for index in range(count)]


def _split_columns(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    return iter(values[:, None].T if values.ndim == 1 else values.T)


def _write_json(log: Run, topic: str, file: TextIO) -> None:
    writer = csv.writer(file, lineterminator="\n")
    records = [{"t_s": record.pop("t_ns") * 1e-9} | record for record in log.records(topic)]
    names = list(dict.fromkeys(name for record in records for name in record))
    writer.writerow(names)
    writer.writerows([_as_cell(record.get(name, "")) for name in names] for record in records)
    lost = log.count(topic) - len(records)
    if lost:
        print(f"hilsat export: {topic}: {lost} of its records are no JSON objects and are left out", file=sys.stderr)


def _as_cell(value: Any) -> Any:
    text = json.dumps(value) if isinstance(value, dict | list) else value
    return text.encode("utf-8", "replace").decode() if isinstance(text, str) else text


# -- npz and frames ------------------------------------------------------------------------------------------------


def export_npz(log: Run, topics: list[str], out: Path, force: bool = False) -> None:
    """Write the signals of the topics (default: of all) as a compressed numpy archive, with t_ns for each topic.

    A topic that cannot be read is left out and named.
    """
    arrays: dict[str, Any] = {}
    for topic in topics or log.topics:
        info = log.topics[topic]
        if info.encoding == "json" or info.schema_name == FRAMES_SCHEMA:
            continue
        key = topic.strip("/").replace("/", ".")
        try:
            values = dict(log.signals(topic).items())
        except RecordError as error:
            _skip(topic, error)
            continue
        arrays |= {f"{key}.t_ns": log.t_ns(topic)} | {f"{key}.{name}": array for name, array in values.items()}
    if not arrays:
        raise UsageError(f"{', '.join(topics) or log.path}: no signals to write as npz; use --to csv")
    with create(out, log.path, force) as part, open(part, "wb") as file:
        np.savez_compressed(file, **arrays)


def export_frames(log: Run, topics: list[str], out: Path, form: str, force: bool = False) -> None:
    """Write the frames of the buses (default: of all) with python-can's writer for the format."""
    wrong = [topic for topic in topics if log.topics[topic].schema_name != FRAMES_SCHEMA]
    if wrong:
        raise UsageError(f"{wrong[0]} has no frames; --to {form} takes frames, from the topics /can/...")
    if not log.buses():
        raise UsageError(f"{log.path}: no frames are logged, so there is nothing to write as {form}; use --to csv")
    with create(out, log.path, force) as part, FRAME_WRITERS[form](part) as writer:
        for message in iterate_frames(log, [topic.removeprefix("/can/") for topic in topics]):
            writer.on_message_received(message)


def export_scene(log: Run, out: Path, force: bool = False) -> None:
    """Write a copy of the log with the scene of its run."""
    from tools.foxglove.scene_log import write_copy
    from tools.grading.grade import scenario_of

    wheels = scenario_of(log, Path(log.path)).scenario.plant.wheels
    with create(out, Path(log.path), force) as part:
        write_copy(log, wheels, part)
