"""Opens logs for a replay: each with the flight software that is to fly it, wherever that runs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from bus.errors import ConfigError, RecordError
from bus.icd.messages import dbc_path
from bus.settings import plain
from fsw.config import FswConfig
from tools.grading.grade import SCENARIO_ATTACHMENT, scenario_of
from tools.log.mcap_reader import Run, read_run
from tools.replay.flight_again import FlightAgain, Flown
from tools.replay.origin import check_icd, describe_origin
from tools.replay.process import FlightElsewhere, check_home, leave_out_defaults

NANO: Final = 1_000_000_000
OTHER_DBC: Final = Path("bus/icd/icd.dbc")  # in a directory of another version


@dataclass(frozen=True, slots=True)
class Choice:
    """What is to fly."""

    overrides: tuple[str, ...] = ()  # fsw.key=value: other settings
    process: bool = False  # in a process of its own
    home: Path | None = None  # of another version, which runs in a process of its own

    @property
    def is_other(self) -> bool:
        """Whether it is something else than what flew, so that it is an open loop."""
        return bool(self.overrides) or self.home is not None


@dataclass(frozen=True, slots=True)
class Opened:
    """A log and how to fly it."""

    run: Run
    tick_ns: int
    _config: FswConfig | None  # None: only the other version can read it
    _settings: dict[str, Any]
    _run_hash: int
    _choice: Choice

    @contextlib.contextmanager
    def fly(self) -> Iterator[Flown]:
        """The flight software at boot. Raises ConfigError, RecordError or PeerLostError where it does not start."""
        choice = self._choice
        if not choice.process and choice.home is None:
            assert self._config is not None
            yield FlightAgain(self._config, self.tick_ns, self._run_hash)
            return
        sparse = self._settings if self._config is None else leave_out_defaults(self._config)
        with FlightElsewhere(self._settings, sparse, self.tick_ns, self._run_hash, choice.home) as flown:
            yield flown


def open_log(log: Path, choice: Choice) -> Opened:
    """The log, found to be one that can be flown with.

    Raises RecordError where its scenario or ICD are not those of this version (with --fsw, of that one), ConfigError for
    overrides that are wrong, UsageError for a directory that has no flight software.
    """
    dbc = Path(dbc_path()) if choice.home is None else check_home(choice.home) / OTHER_DBC
    recorded = read_run(log)
    run_hash = int(recorded.metadata.get("run", {}).get("run_hash", "0"), 16)
    config, settings, tick_hz = _read_settings(recorded, log, choice)
    if not dbc.is_file():
        raise RecordError(
            f"{choice.home}: there is no {OTHER_DBC}, so whether it knows the frames of {log} cannot be said"
        )
    check_icd(recorded, dbc)
    return Opened(recorded, NANO // tick_hz, config, settings, run_hash, choice)


def _read_settings(recorded: Run, log: Path, choice: Choice) -> tuple[FswConfig | None, dict[str, Any], int]:
    """Settings of the flight software, the same in JSON types, and the tick rate [Hz]."""
    try:
        scenario = scenario_of(recorded, log, choice.overrides).scenario
        return scenario.fsw, plain(scenario.fsw), scenario.clock.tick_hz
    except ConfigError as error:
        if choice.overrides and _is_sound(recorded, log):  # so that the overrides are what is wrong
            raise
        if choice.home is not None and not choice.overrides:  # it may know what this version does not
            return None, *_read_raw(recorded, log)
        raise RecordError(
            f"{log}: its scenario cannot be flown by this version: {error.problems[0]}; {describe_origin(recorded)}"
        ) from None


def _is_sound(recorded: Run, log: Path) -> bool:
    """Whether the scenario as recorded can be read."""
    try:
        scenario_of(recorded, log)
    except ConfigError:
        return False
    return True


def _read_raw(recorded: Run, log: Path) -> tuple[dict[str, Any], int]:
    """Settings and tick rate as they stand in the log, whatever they are."""
    text = recorded.attachment(SCENARIO_ATTACHMENT) or b""
    try:
        scenario = yaml.safe_load(text)
        settings, tick_hz = dict(scenario["fsw"]), int(scenario["clock"]["tick_hz"])
        if not 1 <= tick_hz <= 1000:
            raise ValueError(f"{tick_hz} Hz")
    except (yaml.YAMLError, TypeError, KeyError, ValueError, RecursionError) as error:
        raise RecordError(f"{log}: its scenario has no settings of flight software: {error}") from None
    return settings, tick_hz


def list_logs(paths: Sequence[Path]) -> list[Path]:
    """The logs of these paths: of a directory every run.mcap in it. Raises RecordError for one without."""
    logs: list[Path] = []
    for path in paths:
        found = sorted(path.rglob("run.mcap")) if path.is_dir() else [path]
        if not found:
            raise RecordError(f"{path}: there is no run.mcap in this directory or below it")
        logs += found
    return logs
