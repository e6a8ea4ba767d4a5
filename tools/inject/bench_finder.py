"""Finds the benches that run: each has a private directory with `run.json` in it, under the temporary directory.

Only directories that belong to this user and that nobody else can write to are looked into. What a killed bench left
behind is passed over: its socket refuses, or its process is gone.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path

from bus.errors import PeerLostError, UsageError
from tools.run.run_file import PREFIX, RunFile, read_run_file

ALLOW = "inject: allowed in the scenario, or hilsat run --inject"


@dataclass(frozen=True, slots=True)
class FoundBench:
    """A bench that runs, and its private directory."""

    private: Path
    about: RunFile

    def describe(self) -> str:
        """Return what people tell it apart by."""
        about = self.about
        side = "" if about.side == "both" else f", {about.side} alone"
        return f"{about.name} (process {about.pid}, since {about.started}{side}): {about.out or self.private}"


def find_plant(wanted: Path | None = None) -> FoundBench:
    """Return the one bench whose plant takes faults.

    wanted : directory of its log, or its private one; None: the only one that runs
    Raises PeerLostError when there is none, UsageError when one has to be chosen or takes none.
    """
    if wanted is not None:
        return _check(_find_wanted(wanted))
    found = [bench for bench in list_benches() if bench.about.side != "fsw"]
    willing = [bench for bench in found if bench.about.plant is not None and bench.about.inject == "allowed"]
    if len(willing) == 1:
        return _check(willing[0])
    if willing:
        listed = "\n".join(f"  --run {bench.about.out or bench.private}   {bench.about.name}" for bench in willing)
        raise UsageError(f"{len(willing)} benches run; choose one:\n{listed}")
    if found:
        raise UsageError("\n".join(_say_closed(bench) for bench in found))
    raise PeerLostError(
        f"no bench runs here (looked for {PREFIX}* in {tempfile.gettempdir()}); start one with hilsat run SCENARIO "
        "--inject, and give both programs the same TMPDIR"
    )


def list_benches(place: Path | None = None) -> list[FoundBench]:
    """Return every bench of this user that runs, the oldest first. place : None for the temporary directory"""
    entries: list[str] = []
    with contextlib.suppress(OSError):
        entries = [entry.path for entry in os.scandir(place or tempfile.gettempdir()) if entry.name.startswith(PREFIX)]
    found = [bench for path in entries if (bench := look_into(Path(path))) is not None]
    return sorted(found, key=lambda bench: (bench.about.started, bench.about.pid))


def look_into(private: Path) -> FoundBench | None:
    """Return the bench whose private directory this is; None when it is none, or of another user, or dead."""
    private = private.absolute()
    try:
        status = os.lstat(private)
    except (OSError, ValueError):
        return None
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o022:
        return None
    about = read_run_file(private)
    if about is None or not _lives(about):
        return None
    return FoundBench(private, about)


def listens(path: str) -> bool:
    """Return whether somebody holds this socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as probe:
        try:
            probe.connect(path)
        except OSError:
            return False
    return True


def _lives(about: RunFile) -> bool:
    try:
        os.kill(about.pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # a process of somebody else has its number by now
        return False
    # Where the socket is not there yet, the plant is about to make it.
    return about.plant is None or not os.path.lexists(about.plant) or listens(about.plant)


def _find_wanted(wanted: Path) -> FoundBench:
    if (bench := look_into(wanted)) is not None:
        return bench
    out = str(wanted.absolute())
    matching = [bench for bench in list_benches() if bench.about.out is not None and _is_same(bench.about.out, out)]
    chosen = next((bench for bench in matching if bench.about.side != "fsw"), next(iter(matching), None))
    if chosen is None:
        raise PeerLostError(
            f"{wanted}: no bench runs that logs there; --run takes the directory of a running bench's log"
        )
    return chosen


def _is_same(one: str, other: str) -> bool:
    return one == other or (os.path.exists(one) and os.path.exists(other) and os.path.samefile(one, other))


def _check(bench: FoundBench) -> FoundBench:
    if bench.about.plant is None or bench.about.inject != "allowed":
        raise UsageError(_say_closed(bench))
    return bench


def _say_closed(bench: FoundBench) -> str:
    if bench.about.side == "fsw":
        return f"{bench.about.name} is flight software alone; faults are the plant's, in the terminal where it runs"
    return f"bench {bench.about.name} runs, but its scenario does not allow injection: {ALLOW}"
