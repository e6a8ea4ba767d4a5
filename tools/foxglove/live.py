"""A bench that is flown at the pace of the clock and served to Foxglove on this machine, with a service a fault.

The services take the request of their button as JSON: keys as of a fault in a scenario, `for_s` besides; `{}` is what
stands on the button. They are answered once the plant has taken the fault, or with all reasons why it has not.
"""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Final

import foxglove
from foxglove.websocket import Capability, WebSocketServer

from bus.errors import UsageError
from bus.telemetry.link import MemoryLink
from fsw.telemetry import SOURCE as FSW_SOURCE
from plant_server.ground.desk import FaultDesk
from plant_server.truth import SOURCE as PLANT_SOURCE
from tools.config.scenario import Resolved
from tools.foxglove.buttons import CLEAR, Button, list_buttons
from tools.foxglove.feed import Advertised, Feed, Send
from tools.log.recorder import Recorder
from tools.run.bench import Bench
from tools.run.provenance import describe_run, list_attachments

HOST: Final = "127.0.0.1"
ORIGIN: Final = "hilsat live"
RATE_HZ: Final = 25.0  # of wall time: how often viewers get a tick
AGAIN_S: Final = 1.0  # how often they get what does not change
BEHIND_S: Final = 1.0  # how far the bench may fall behind the clock before it lets go of what it has missed
PATIENCE_S: Final = 5.0  # how long a service waits for the bench

Reply = dict[str, Any]


class LiveBench:
    """A bench, its server, and what viewers ask of it.

    port : 0 for any that is free
    log  : a file that does not exist yet; None: no log
    Raises UsageError for a port that is taken.
    """

    def __init__(self, resolved: Resolved, port: int, log: Path | None = None) -> None:
        self._asked: queue.SimpleQueue[tuple[Button, Any, Future[Reply]]] = queue.SimpleQueue()
        self._context = foxglove.Context()
        self._server = self._serve(resolved.scenario.name, port)
        self.url = f"ws://{HOST}:{self._server.port}"
        self.app_url = self._server.app_url() or ""
        self._recorder = None
        try:
            if log is not None:
                attachments = list_attachments(resolved)
                self._recorder = Recorder(log, metadata=describe_run(resolved, "in process"), attachments=attachments)
            self._feed = Feed(self._advertise, resolved.scenario.plant.wheels, self._recorder)
            self._links = MemoryLink(self._feed, PLANT_SOURCE), MemoryLink(self._feed, FSW_SOURCE)
            self.bench = Bench(resolved, self._links[0], self._links[1])
        except BaseException:
            self._server.stop()
            raise
        self._desk = FaultDesk(self.bench.plant_node, resolved.ticks, allowed=True)

    def _serve(self, name: str, port: int) -> WebSocketServer:
        services = [self._make_service(button) for button in list_buttons()]
        try:
            return foxglove.start_server(
                name=f"hilsat {name}", host=HOST, port=port, context=self._context, services=services,
                capabilities=[Capability.Services, Capability.Time], supported_encodings=["json"],
            )  # fmt: skip
        except RuntimeError as error:
            raise UsageError(
                f"port {port} of {HOST} cannot be had ({error}); is another `hilsat live` running? Name another --port, "
                "or 0 for any that is free"
            ) from None

    def _advertise(self, what: Advertised) -> Send:
        schema = foxglove.Schema(name=what.schema_name, encoding=what.schema_encoding, data=what.schema)
        channel = foxglove.Channel(what.topic, schema=schema, message_encoding=what.encoding, context=self._context)
        return lambda data, t_ns: channel.log(data, log_time=t_ns)

    # -- what viewers ask ------------------------------------------------------------------------------------------

    def _make_service(self, button: Button) -> foxglove.Service:
        def handle(request: foxglove.ServiceRequest) -> bytes:
            """Runs in a thread of the server's: the bench is touched by its own thread alone."""
            future: Future[Reply] = Future()
            self._asked.put((button, request.payload, future))
            try:
                return json.dumps(future.result(PATIENCE_S)).encode()
            except TimeoutError:
                return json.dumps(_refuse("the bench does not answer; has the run ended?")).encode()

        def describe(name: str, text: str) -> foxglove.MessageSchema:
            schema = foxglove.Schema(name=name, encoding="jsonschema", data=text.encode())
            return foxglove.MessageSchema(encoding="json", schema=schema)

        schema = foxglove.ServiceSchema(
            f"hilsat{button.service.replace('/', '.')}",
            request=describe("hilsat.FaultRequest", '{"type": "object"}'),
            response=describe("hilsat.FaultReply", '{"type": "object", "properties": {"state": {"type": "string"}}}'),
        )
        return foxglove.Service(button.service, schema=schema, handler=handle)

    def _answer_all(self) -> None:
        while not self._asked.empty():
            button, payload, future = self._asked.get()
            future.set_result(self._answer(button, payload))

    def _answer(self, button: Button, payload: bytes) -> Reply:
        try:
            request = json.loads(payload) if payload.strip() else {}
        except (ValueError, RecursionError):
            return _refuse("the request is no JSON")
        if not isinstance(request, dict):
            return _refuse("the request must be an object: keys as of a fault in a scenario, and for_s")
        desk = self._desk
        if button.service == CLEAR:
            outcome = desk.clear(request, ORIGIN)
            return _refuse(*outcome.reasons) if outcome.reasons else {"state": "accepted", "ids": list(outcome.ids)}
        fault = (request or dict(button.request)) | {"kind": button.service.rpartition("/")[2]}
        for_s = fault.pop("for_s", None)
        outcome, item = desk.set(fault, ORIGIN, for_s=for_s)
        if item is None:
            return _refuse(*outcome.reasons)
        tick_s = self.bench.tick_s
        return {"state": "accepted", "id": item.id, "t_s": item.tick * tick_s, "text": item.fault.describe()}

    # -- flying ----------------------------------------------------------------------------------------------------

    def fly(self, speed: float, on_behind: Callable[[float], None]) -> None:
        """Fly to the end of the scenario at the pace of the clock, times `speed`.

        on_behind : is told by how much [s], when the machine is too slow
        """
        bench, tick_s = self.bench, self.bench.tick_s / speed
        start = time.monotonic() - bench.tick * tick_s
        publish_at = again_at = 0.0
        while bench.tick < bench.ticks:
            self._answer_all()
            bench.step()
            now = time.monotonic()
            if now >= publish_at:
                self._publish(now >= again_at)
                publish_at = now + 1.0 / RATE_HZ
                again_at = now + AGAIN_S if now >= again_at else again_at
            left = start + bench.tick * tick_s - time.monotonic()
            if left < -BEHIND_S:
                on_behind(-left)
                start -= left
            elif left > 0.0:
                time.sleep(left)
        self._publish(True)

    def _publish(self, again: bool) -> None:
        for link in self._links:
            link.flush()
        self._feed.publish(again)
        self._server.broadcast_time(round(self.bench.t_s * 1e9))

    def close(self, reason: str) -> None:
        """End the log and the server. Raises RecordError when the log cannot be finished."""
        try:
            self.bench.close(reason)
            if self._recorder is not None:
                self._recorder.close()
        finally:
            self._answer_late()
            self._server.stop()

    def _answer_late(self) -> None:
        while not self._asked.empty():
            self._asked.get()[2].set_result(_refuse("the run has ended"))


def _refuse(*reasons: str) -> Reply:
    return {"state": "refused", "reasons": list(reasons)}
