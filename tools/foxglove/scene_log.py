"""Puts the scene of a run into its log once the run is over, at five instants a simulated second.

The scene is made from what the log holds, truth and faults, never while the run goes: no tick waits for it. It goes to the
end of the file in chunks of its own; their log times lie among those of the run, and readers put messages in order by the
index of each chunk. Its topics are marked as not deterministic: digest, diff and replay pass them over.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.errors import RecordError, UsageError
from tools.foxglove.scene import Scene
from tools.foxglove.schemas import BODY, FAULTS, FRAMES, PREFIX, TOPICS, WHEELS
from tools.log.mcap_reader import Run
from tools.log.mcap_writer import McapWriter

RATE_HZ: Final = 5.0  # of simulated time
MOST: Final = 20_000  # instants of one scene: a longer run has fewer a second
CHUNK_BYTES: Final = 256 * 1024  # small, for they are read beside those of the run
MESSAGE: Final = struct.Struct("<BQHIQQ")
STARTS, ENDS = ("onset",), ("end", "cleared")


class Instant(NamedTuple):
    """What is so at one instant of a scene."""

    tick: int
    t_ns: int
    q_ib: tuple[float, ...]
    q_it: tuple[float, ...] | None
    tau_nm: tuple[float, ...]


def has_scene(run: Run) -> bool:
    """Whether a log has one."""
    return any(name.startswith(PREFIX) for name in run.topics)


def add_scene(writer: McapWriter, parts: Sequence[bytes]) -> None:
    """Write the messages of `make_scene` at the end of a log that is open for more."""
    for topic in TOPICS:
        schema = (topic.schema_name, "jsonschema", topic.schema)
        writer.add_channel(topic.channel, topic.name, "json", schema, {"deterministic": "false"})
    start, size = 0, 0
    for at, part in enumerate(parts):
        size += len(part)
        if size >= CHUNK_BYTES or at == len(parts) - 1:
            writer.write_chunk(list(parts[start : at + 1]))
            start, size = at + 1, 0


def make_scene(run: Run, wheels: Sequence[Any]) -> list[bytes]:
    """The scene of a log as Message records, in order of time; none for a log without truth.

    wheels : of the plant's settings
    Raises UsageError for a log that has a scene or whose numbers of channels are taken.
    """
    if has_scene(run):
        raise UsageError(f"{run.path}: the log has a scene already; open it as it is")
    taken = {channel for info in run.topics.values() for channel in info.channels}
    if taken & {topic.channel for topic in TOPICS}:
        raise UsageError(f"{run.path}: the log uses the channels {[t.channel for t in TOPICS]} for something else")
    scene = Scene(wheels)
    changes = _list_changes(run)
    acting: dict[str, dict[str, str]] = {}  # unit -> id -> kind
    parts: list[bytes] = []
    shown: tuple[Any, ...] = ()
    for instant in _list_instants(run):
        tick, t_ns = instant.tick, instant.t_ns
        changed = not parts
        if changed:
            parts.append(_record(BODY.channel, tick, t_ns, scene.format_body(t_ns)))
        while changes and changes[0][0] <= t_ns:
            apply_change(acting, changes.pop(0)[1])
            changed = True
        if changed:
            words = {unit: list(kinds.values()) for unit, kinds in acting.items()}
            parts.append(_record(FAULTS.channel, tick, t_ns, scene.format_faults(t_ns, words)))
        parts.append(_record(FRAMES.channel, tick, t_ns, scene.format_frames(t_ns, instant.q_ib, instant.q_it)))  # type: ignore[arg-type]
        shares = scene.grade_torques(instant.tau_nm)
        faulted = tuple(bool(acting.get(f"wheel.{number}")) for number in range(1, len(shares) + 1))
        if (shares, faulted) != shown:
            shown = (shares, faulted)
            parts.append(_record(WHEELS.channel, tick, t_ns, scene.format_wheels(t_ns, shares, faulted)))
    return parts


def _record(channel: int, tick: int, t_ns: int, payload: bytes) -> bytes:
    return MESSAGE.pack(5, 22 + len(payload), channel, tick & 0xFFFFFFFF, t_ns, t_ns) + payload


def _list_changes(run: Run) -> list[tuple[int, dict[str, Any]]]:
    """Onsets and ends of faults, by time [ns]."""
    found = [(record["t_ns"], record) for record in run.faults if record["phase"] in (*STARTS, *ENDS)]
    return sorted(found, key=lambda change: change[0])


def apply_change(acting: dict[str, dict[str, str]], record: dict[str, Any]) -> None:
    """Note in `acting` (unit -> id -> kind) the onset or the end of a fault, as /faults has it."""
    of_unit = acting.setdefault(str(record["unit"]), {})
    if record["phase"] in STARTS:
        of_unit[str(record.get("id"))] = str(record["fault"])
    else:
        of_unit.pop(str(record.get("id")), None)


def _list_instants(run: Run) -> Iterator[Instant]:
    """The truth at the instants of the scene; those at which it is no number are left out."""
    if not run.has("/truth/attitude") or not run.has("/truth/wheels"):
        return
    try:
        t_ns, q_ib = run.t_ns("/truth/attitude"), run.signals("/truth/attitude")["q_ib"]
        tau, ticks = run.signals("/truth/wheels")["tau_rw_true_nm"], run.ticks("/truth/attitude")
    except KeyError as error:
        raise RecordError(f"{run.path}: the truth in it has no {error}, so there is no scene") from None
    if len(tau) != len(q_ib):
        raise RecordError(f"{run.path}: truth of attitude and wheels do not go together, so there is no scene")
    rows = _pick(t_ns)
    target = _read_target(run, t_ns[rows])
    sound = np.isfinite(q_ib[rows]).all(axis=1) & np.isfinite(tau[rows]).all(axis=1)
    for at, row in enumerate(rows.tolist()):
        if sound[at]:
            q_it = None if target is None else tuple(target[at].tolist())
            yield Instant(int(ticks[row]), int(t_ns[row]), tuple(q_ib[row].tolist()), q_it, tuple(tau[row].tolist()))


def _pick(t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of the first record in every fifth of a second, or of a longer stretch where there would be too many."""
    length_ns = int(t_ns[-1] - t_ns[0])
    step_ns = max(round(1e9 / RATE_HZ), length_ns // MOST)
    _, rows = np.unique((t_ns - t_ns[0]) // step_ns, return_index=True)
    return rows.astype(np.int64)


def _read_target(run: Run, t_ns: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """The target's attitude at these times, None for a log without one."""
    if not run.has("/fsw/attitude") or "q_it" not in run.signals("/fsw/attitude"):
        return None
    times, values = run.t_ns("/fsw/attitude"), run.signals("/fsw/attitude")["q_it"]
    rows = np.clip(np.searchsorted(times, t_ns, side="right") - 1, 0, None)
    found = np.asarray(values[rows], np.float64)
    return found if np.isfinite(found).all() else None


def write_copy(run: Run, wheels: Sequence[Any], out: Path) -> None:
    """Write a copy of a finished log with a scene. Raises as `make_scene`, and RecordError for a log that was cut."""
    parts = make_scene(run, wheels)
    if not parts:
        raise RecordError(f"{run.path}: the log has no truth, so there is no scene to make of it")
    out.write_bytes(Path(run.path).read_bytes())
    writer = McapWriter.resume(out)
    add_scene(writer, parts)
    writer.close()
