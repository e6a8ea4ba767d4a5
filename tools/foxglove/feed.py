"""What a live bench sends to viewers: its telemetry with the log's own schemas, and the scene.

A sink for both links of a bench, beside a recorder or without one. Ticks go out when `publish` is called, the newest only:
a viewer wants to see what is so, the log has all. Events and faults go out one by one.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from bus.telemetry.events import FAULTS as FAULT_TOPIC
from bus.telemetry.events import JSON_TOPICS, TF
from tools.foxglove.scene import Scene
from tools.foxglove.scene_log import apply_change
from tools.foxglove.schemas import BODY, FAULTS, FRAMES, TOPICS, WHEELS
from tools.log.message_index import DATA_AT, LayoutIndex
from tools.log.pointing import PointingError
from tools.log.recorder import Recorder
from tools.log.topics import parse_layout

ENCAPSULATION: Final = 4  # bytes ahead of a CDR message's fields
Q_IB: Final = struct.Struct("<4d")
NEEDED: Final = {"/truth/attitude": "q_ib", "/truth/wheels": "tau_rw_true_nm", "/fsw/attitude": "q_it"}

Send = Callable[[bytes, int], None]  # a message and its time [ns]


class Advertised(NamedTuple):
    """A topic as viewers are told of it."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


class Feed:
    """Takes what both sides of a bench say, and passes it on.

    advertise : makes a topic known and returns what sends its messages
    recorder  : keeps everything, where there is one
    """

    def __init__(self, advertise: Callable[[Advertised], Send], wheels: Any, recorder: Recorder | None = None) -> None:
        self._advertise = advertise
        self._recorder = recorder
        self._scene = Scene(wheels)
        self._send: dict[int, Send] = {}  # by channel of the log
        self._topics: dict[int, str] = {}
        self._places: dict[str, int] = {}  # of the fields of NEEDED in their records
        self._newest: dict[int, tuple[int, bytes]] = {}  # source -> tick, Message records
        self._layouts, self._pointing = LayoutIndex(), PointingError()
        self._acting: dict[str, dict[str, str]] = {}
        self._faults_changed = True
        texts = [(t.name, t.schema_name, t.json_schema()) for t in JSON_TOPICS.values() if t.name != TF.name]
        texts += [(topic.name, topic.schema_name, topic.schema) for topic in TOPICS]
        self._json = {
            name: advertise(Advertised(name, "json", schema_name, "jsonschema", schema.encode()))
            for name, schema_name, schema in texts
        }

    # -- what links give -------------------------------------------------------------------------------------------

    def announce(self, source: int, topics_json: bytes) -> None:
        """Make the topics of one side known."""
        if self._recorder is not None:
            self._recorder.announce(source, topics_json)
        for row in json.loads(topics_json):
            channel, topic, schema = row["channel"], row["topic"], row["schema"]
            self._pointing.learn(channel, topic, schema)
            self._topics[channel] = topic
            self._send[channel] = self._advertise(
                Advertised(topic, "cdr", row["schema_name"], "ros2msg", schema.encode())
            )
            if topic in NEEDED:
                fields: Any = parse_layout(schema, topic).fields
                self._places[topic] = ENCAPSULATION + fields[NEEDED[topic]][1]

    def write_ticks(self, source: int, ticks: list[int], t_ns: int, records: list[bytes]) -> None:
        """Keep the newest tick until it is published."""
        if self._recorder is not None:
            self._recorder.write_ticks(source, ticks, t_ns, records)
        self._newest[source] = (t_ns, records[-1])

    def write_json(self, source: int, topic: str, t_ns: int, payload: bytes) -> None:
        """Pass on an event, or what became of a fault."""
        if self._recorder is not None:
            self._recorder.write_json(source, topic, t_ns, payload)
        if topic in self._json:
            self._json[topic](payload, t_ns)
        if topic == FAULT_TOPIC.name:
            record = json.loads(payload)
            if record["phase"] in ("onset", "end", "cleared"):
                apply_change(self._acting, record)
                self._faults_changed = True

    def end_source(self, source: int, reason: str, dropped: int = 0) -> None:
        """One side has ended."""
        if self._recorder is not None:
            self._recorder.end_source(source, reason, dropped)

    # -- what viewers get ------------------------------------------------------------------------------------------

    def publish(self, again: bool) -> None:
        """Send the newest tick of both sides, and the scene of it. `again`: what does not change too, for who came late."""
        if not self._newest:
            return
        parts = [records for _, records in self._newest.values()]
        t_ns = max(time for time, _ in self._newest.values())
        self._newest.clear()
        data = b"".join(parts)
        located = self._layouts.locate(parts, data)
        data = self._pointing.fill(located.pairs, data)
        payloads: dict[str, bytes] = {}
        for channel, pairs in located.pairs.items():
            for time, at in pairs.tolist():
                size = int.from_bytes(data[at + 1 : at + 9], "little") + 9
                payload = data[at + DATA_AT : at + size]
                payloads[self._topics.get(channel, "")] = payload
                if channel in self._send:
                    self._send[channel](payload, time)
        self._draw(t_ns, payloads, again)

    def _draw(self, t_ns: int, payloads: dict[str, bytes], again: bool) -> None:
        scene, send = self._scene, self._json
        q_ib, tau, q_it = (self._read(payloads, topic) for topic in NEEDED)
        if q_ib is not None:
            send[FRAMES.name](scene.format_frames(t_ns, q_ib, q_it), t_ns)
        if tau is not None:
            faulted = [bool(self._acting.get(f"wheel.{number}")) for number in range(1, len(tau) + 1)]
            send[WHEELS.name](scene.format_wheels(t_ns, scene.grade_torques(tau), faulted), t_ns)
        if again:
            send[BODY.name](scene.format_body(t_ns), t_ns)
        if again or self._faults_changed:
            words = {unit: list(kinds.values()) for unit, kinds in self._acting.items()}
            send[FAULTS.name](scene.format_faults(t_ns, words), t_ns)
            self._faults_changed = False

    def _read(self, payloads: dict[str, bytes], topic: str) -> tuple[float, float, float, float] | None:
        """The four numbers that the scene needs of a topic, None where there are none or one is not finite."""
        payload = payloads.get(topic)
        if payload is None or topic not in self._places:
            return None
        w, x, y, z = Q_IB.unpack_from(payload, self._places[topic])
        return (w, x, y, z) if abs(w) + abs(x) + abs(y) + abs(z) < float("inf") else None
