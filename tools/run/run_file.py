"""What a running bench says of itself to whoever looks for it: `run.json` in its private directory, with its sockets."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bus.errors import RecordError
from bus.run import GroundConfig

if TYPE_CHECKING:  # who looks for a bench need not wait for all that a scenario can be made of
    from tools.config.scenario import Resolved

RUN_FILE: Final = "run.json"
PREFIX: Final = "hilsat-"  # of private directories
PLANT_SOCKET, FSW_SOCKET = "plant.sock", "fsw.sock"
LARGEST: Final = 65536  # bytes of a run file


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFile:
    """One running bench, or one side of it."""

    name: str  # of the scenario
    side: str  # both, plant or fsw: what this program runs of the bench
    out: str | None  # absolute path of the directory of its log; None: it has none
    pid: int  # of the program that was started
    clock: str
    bus: str  # address
    inject: str  # off or allowed
    plant: str | None  # path of the plant's socket; None: it has none
    fsw: str | None  # of the flight software's
    started: str  # UTC


def describe_bench(
    resolved: Resolved,
    private: Path,
    *,
    address: str,
    out: Path | None = None,
    side: str = "both",
    linked: bool = False,
) -> RunFile:
    """Return what a bench says of itself. It has sockets where injection is allowed, or for a gateway (`linked`)."""
    scenario = resolved.scenario
    has_sockets = linked or scenario.inject == "allowed"
    return RunFile(
        name=scenario.name,
        side=side,
        out=None if out is None else str(out.absolute()),
        pid=os.getpid(),
        clock=scenario.clock.mode,
        bus=address,
        inject=scenario.inject,
        plant=str(private / PLANT_SOCKET) if has_sockets and side != "fsw" else None,
        fsw=str(private / FSW_SOCKET) if has_sockets and side != "plant" else None,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def ground_of(bench: RunFile, socket: str | None) -> GroundConfig | None:
    """Return what a side with this socket is told; None for one without."""
    return None if socket is None else GroundConfig(socket=socket, inject=bench.inject == "allowed")


def write_run_file(private: Path, bench: RunFile) -> None:
    """Write it, whole from the first moment that it is there. Raises RecordError."""
    part = private / f"{RUN_FILE}.part"
    try:
        part.write_text(json.dumps(asdict(bench)), encoding="utf-8")
        part.rename(private / RUN_FILE)
    except OSError as error:
        raise RecordError(f"{private}: cannot write {RUN_FILE}: {error.strerror or error}") from None


def read_run_file(private: Path) -> RunFile | None:
    """Return what a private directory says of its bench; None when it says nothing that can be believed.

    Its sockets must be in the directory itself.
    """
    try:
        with open(private / RUN_FILE, "rb") as file:
            what = json.loads(file.read(LARGEST))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(what, dict) or not _is_sound(what):
        return None
    for socket in (what["plant"], what["fsw"]):
        if socket is not None and Path(socket).parent != private.absolute():
            return None
    return RunFile(**{item.name: what[item.name] for item in fields(RunFile)})


def _is_sound(what: dict[str, Any]) -> bool:
    texts = ("name", "side", "clock", "bus", "inject", "started")
    maybe = ("out", "plant", "fsw")
    return (
        all(isinstance(what.get(key), str) for key in texts)
        and all(key in what and isinstance(what[key], str | None) for key in maybe)
        and type(what.get("pid")) is int
        and 0 < what["pid"] < 2**31
    )
