"""`hilsat export`: signals of a log as CSV or npz, frames as candump log, ASC or BLF.

hilsat export run.mcap --to csv --topic /truth/attitude > attitude.csv
hilsat export run.mcap --to csv -o directory            one file for each topic
hilsat export run.mcap --to npz -o run.npz              all signals; keys like truth.attitude.error_deg
hilsat export run.mcap --to log -o run.log              frames for canplayer, cantools, SavvyCAN
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, TextIO

import can
import numpy as np

from bus.errors import RecordError, UsageError
from bus.telemetry.cdr import FRAMES_SCHEMA
from tools.log.mcap_reader import Run, read_run
from tools.log.python_can_mcap import iterate_frames

FRAME_WRITERS: Final[dict[str, type[Any]]] = {"log": can.CanutilsLogWriter, "asc": can.ASCWriter, "blf": can.BLFWriter}
FORMATS: Final = ("csv", "npz", *FRAME_WRITERS)


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "export", help="write a log's signals or frames in another format", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("log", type=Path, help="MCAP file")
    parser.add_argument("--to", choices=FORMATS, required=True, help="csv, npz: signals; log, asc, blf: frames")
    parser.add_argument("--topic", action="append", default=[], metavar="T", help="only this topic; may be repeated")
    parser.add_argument("-o", "--out", type=Path, help="file, or directory for csv of several topics; csv: stdout")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Export; exit code 0."""
    log = read_run(args.log)
    unknown = [topic for topic in args.topic if topic not in log.topics]
    if unknown:
        raise UsageError(f"{args.log}: there is no topic {unknown[0]}; there are: {', '.join(sorted(log.topics))}")
    with _file_errors(args.out):
        if args.to == "csv":
            export_csv(log, args.topic, args.out)
        elif args.out is None:
            raise UsageError(f"--to {args.to} needs a file to write: -o FILE.{args.to}")
        elif args.to == "npz":
            export_npz(log, args.topic, args.out)
        else:
            export_frames(log, args.topic, args.out, args.to)
    return 0


@contextlib.contextmanager
def _file_errors(out: Path | None) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise RecordError(f"{out or 'stdout'}: cannot write: {error.strerror}") from None


def export_csv(log: Run, topics: list[str], out: Path | None) -> None:
    """Write one topic to a file or stdout, or several into a directory. Floats keep all their digits."""
    if len(topics) == 1 and (out is None or not out.is_dir()):
        if out is None:
            write_csv(log, topics[0], sys.stdout)
        else:
            with open(out, "w", newline="") as file:
                write_csv(log, topics[0], file)
        return
    if out is None:
        raise UsageError(
            f"csv on stdout takes one --topic of: {', '.join(sorted(log.topics))}; or name a directory, -o DIR"
        )
    out.mkdir(parents=True, exist_ok=True)
    for topic in topics or log.topics:
        with open(out / (topic.strip("/").replace("/", ".") + ".csv"), "w", newline="") as file:
            write_csv(log, topic, file)


def write_csv(log: Run, topic: str, file: TextIO) -> None:
    """Write one topic: a header line, then one line a record (one a frame for frames); t_s first."""
    writer = csv.writer(file, lineterminator="\n")
    info = log.topics[topic]
    if info.schema_name == FRAMES_SCHEMA:
        writer.writerow(["t_s", "id", "dlc", "data"])
        for frame in log.frames(topic.removeprefix("/can/")):
            writer.writerow(
                [
                    frame["t_ns"] * 1e-9,
                    f"{frame['id']:#05x}",
                    frame["dlc"],
                    frame["data"][: frame["dlc"]].tobytes().hex(),
                ]
            )
    elif info.encoding == "cdr":
        columns = {"t_s": (log.t_ns(topic) * 1e-9).tolist()} | _split_vectors(log, topic)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    else:
        records = [{"t_s": record.pop("t_ns") * 1e-9} | record for record in map(dict, log.records(topic))]
        names = list(dict.fromkeys(name for record in records for name in record))
        writer.writerow(names)
        writer.writerows([_as_cell(record.get(name, "")) for name in names] for record in records)


def _split_vectors(log: Run, topic: str) -> dict[str, list[Any]]:
    """Field or field[i] -> values."""
    columns: dict[str, list[Any]] = {}
    for name, values in log.signals(topic).items():
        if values.ndim == 1:
            columns[name] = values.tolist()
        else:
            columns |= {f"{name}[{index}]": values[:, index].tolist() for index in range(values.shape[1])}
    return columns


def _as_cell(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, dict | list) else value


def export_npz(log: Run, topics: list[str], out: Path) -> None:
    """Write the signals of the topics (default: of all) as a compressed numpy archive, with t_ns for each topic."""
    arrays: dict[str, Any] = {}
    for topic in topics or log.topics:
        info = log.topics[topic]
        if info.encoding == "cdr" and info.schema_name != FRAMES_SCHEMA:
            key = topic.strip("/").replace("/", ".")
            arrays[f"{key}.t_ns"] = log.t_ns(topic)
            arrays |= {f"{key}.{name}": values for name, values in log.signals(topic).items()}
    if not arrays:
        raise UsageError(f"{', '.join(topics)}: no signals to write as npz; use --to csv")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    out.write_bytes(buffer.getvalue())


def export_frames(log: Run, topics: list[str], out: Path, form: str) -> None:
    """Write the frames of the buses (default: of all) with python-can's writer for the format."""
    wrong = [topic for topic in topics if log.topics[topic].schema_name != FRAMES_SCHEMA]
    if wrong:
        raise UsageError(f"{wrong[0]} has no frames; --to {form} takes frames, from the topics /can/...")
    with FRAME_WRITERS[form](out) as writer:
        for message in iterate_frames(log, [topic.removeprefix("/can/") for topic in topics]):
            writer.on_message_received(message)
