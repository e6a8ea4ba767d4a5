"""Flight software in a process of its own, fed with recorded inputs; of this version, or of another one in a directory."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from bus.errors import ConfigError, HilsatError, PeerLostError, RecordError, UsageError
from bus.process import name_signal
from bus.settings import NOTHING, fields_of, plain
from tools.replay import child, feeder
from tools.replay.flight_again import Cycle, RecordSorter
from tools.replay.inputs import CycleInput

PATIENCE_S: Final = 30.0  # for one cycle of it, and for its start
NEEDED: Final = ("bus", "fsw")  # packages that a directory must have
HERE: Final = Path(__file__).resolve().parents[2]


class FlightElsewhere:
    """Flight software at boot in a process of its own. `close` ends it; `place`: the directory of its fsw package."""

    def __init__(
        self,
        settings: Mapping[str, Any],
        sparse: Mapping[str, Any],
        tick_ns: int,
        run_hash: int,
        home: Path | None = None,
    ) -> None:
        """Start it, and have it ready for its first cycle.

        settings : in JSON types, as bus.settings.plain makes them of FswConfig
        sparse   : the same without defaults, for a version that does not know all of them
        home     : a directory with `bus` and `fsw` packages, those of this version by default

        Raises UsageError where there are none, ConfigError for settings that it cannot be flown with, RecordError where it
        cannot be fed as this version is, PeerLostError when it dies.
        """
        self.home = check_home(home) if home is not None else HERE
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        ours, theirs = socket.socketpair()
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONHOME"}
        environment["PYTHONPATH"] = os.fspath(self.home)
        if home is not None:
            environment.pop("HILSAT_BUILD", None)  # that of this version, which theirs need not have
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-B", child.__file__, str(theirs.fileno()), feeder.__file__],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._errors,
                env=environment, cwd=self.home, start_new_session=True,
            )  # fmt: skip
        self._wire = ours
        ours.settimeout(PATIENCE_S)
        self.mode = "boot"
        self._tick = -1
        try:
            self._meet({"config": settings, "sparse": sparse, "tick_ns": tick_ns, "run_hash": run_hash})
        except BaseException:
            self.close()
            raise

    def _meet(self, given: Mapping[str, Any]) -> None:
        hello = self._ask(json.dumps(given).encode())
        try:
            words: dict[str, Any] = json.loads(hello)
        except ValueError:
            raise RecordError(f"{self.home}: its process speaks otherwise than this version") from None
        if "error" in words:
            raise self._explain(words)
        self.place = Path(words["place"])
        self.sparse = bool(words["sparse"])  # whether settings at their default values were left to its own defaults
        if self.place.resolve().parent != self.home.resolve():
            raise UsageError(f"{self.home}: Python took fsw from {self.place} instead")
        sorter = RecordSorter(words["topics"])
        self.schemas: Mapping[str, str] = sorter.schemas
        self._sort = sorter.sort

    def cycle(self, given: CycleInput) -> Cycle:
        """Run the cycle that had this input. Raises PeerLostError when the process dies of it, or does not answer."""
        self._tick = given.tick
        text = "\n".join([command.to_json() for command in given.commands]).encode()
        answer = self._ask(child.HEAD.pack(given.tick, given.slips, given.flags, len(text)) + text + given.frames)
        if answer[:1] == child.FAILED:
            raise self._explain(json.loads(answer[1:]))
        _, mode_size, frames_size = child.ANSWER.unpack_from(answer)
        mode_end = child.ANSWER.size + mode_size
        self.mode = answer[child.ANSWER.size : mode_end].decode()
        frames_end = mode_end + frames_size
        return Cycle(answer[mode_end:frames_end], self._sort(answer[frames_end:]))

    def _ask(self, piece: bytes) -> bytes:
        """The answer to a piece."""
        try:
            child.send(self._wire, piece)
            answer = child.receive(self._wire)
        except TimeoutError:
            raise PeerLostError(f"{self._name()} gave no answer to {self._where()} within {PATIENCE_S:g} s") from None
        except OSError:
            answer = b""
        if not answer:
            raise PeerLostError(self._describe_death())
        return answer

    def _explain(self, words: dict[str, Any]) -> HilsatError:
        """The error behind what the process says of itself."""
        said = f"{self._name()}, {self._where()}: {words['error']}"
        if words.get("exit_code") == ConfigError.exit_code:
            return ConfigError(said)
        if words.get("missing"):
            return RecordError(
                f"{said}: what the replay feeds it by is not there, so this version cannot be flown here"
            )
        return RecordError(said)

    def _name(self) -> str:
        return f"the flight software of {self.home}"

    def _where(self) -> str:
        return "at its start" if self._tick < 0 else f"tick {self._tick}"

    def _describe_death(self) -> str:
        try:
            code = self._process.wait(5)
        except subprocess.TimeoutExpired:
            return f"{self._name()} closed its end, {self._where()}"
        ending = f"was killed by {name_signal(-code)}" if code < 0 else f"ended with exit code {code}"
        self._errors.seek(0)
        lines = self._errors.read()[-4000:].decode("utf-8", "replace").strip().splitlines()
        return f"{self._name()} {ending}, {self._where()}{': ' + lines[-1] if lines else ''}"

    def close(self) -> None:
        """End it. Harmless when repeated."""
        self._wire.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(2)
        if self._process.returncode is None:
            self._process.kill()
            self._process.wait()
        self._errors.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def check_home(home: Path) -> Path:
    """The directory, absolute. Raises UsageError unless it has flight software in it."""
    missing = [name for name in NEEDED if not (home / name / "__init__.py").is_file()]
    if missing:
        raise UsageError(
            f"--fsw {home}: there is no package {' and no '.join(missing)} in it; name a directory such as a checkout of "
            "another version, with bus/ and fsw/ in it"
        )
    return home.resolve()


def leave_out_defaults(settings: Any) -> dict[str, Any]:
    """Settings in JSON types without those that have their default values; words that tell kinds apart stay."""
    sparse: dict[str, Any] = {}
    kind: Any = type(settings)
    for name, (_, default) in fields_of(kind).items():
        value = getattr(settings, name)
        if name != "kind" and default is not NOTHING and value == default:
            continue
        is_group = hasattr(type(value), "__dataclass_fields__") and not hasattr(value, "plain_settings")
        sparse[name] = leave_out_defaults(value) if is_group else plain(value)
    return sparse
