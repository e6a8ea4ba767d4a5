"""What every component of ours does on a link: presence, commands answered once, parameters, streams, texts.

Polled by a loop once a tick, in bounded time, whoever sends what: it takes a few datagrams, sends what is due, and returns.
Nothing that comes in raises. Times here are wall times of a monotonic clock: a ground program waits in wall time, also for a
bench that runs a hundred times faster. Nothing that it sends changes what the loop computes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from bus.clock import MonotonicClock
from bus.mavlink import words
from bus.mavlink.dialect import (
    MAVLink_autopilot_version_message,
    MAVLink_command_ack_message,
    MAVLink_file_transfer_protocol_message,
    MAVLink_heartbeat_message,
    MAVLink_mission_count_message,
    MAVLink_param_error_message,
    MAVLink_param_value_message,
    MAVLink_statustext_message,
    MAVLink_timesync_message,
)
from bus.mavlink.endpoint import Endpoint
from bus.mavlink.json_parts import Assembler, cut_reply
from bus.mavlink.packets import Message, text_of
from bus.mavlink.parameters import Parameter, Parameters

SECOND_NS: Final = 1_000_000_000
HEARTBEAT_NS: Final = SECOND_NS
FORGET_NS: Final = 10 * SECOND_NS  # a listener that has not been heard for so long
LISTENERS: Final = 8
LOOK_NS: Final = 500_000  # between two looks for what has come, where ticks are shorter: a look takes microseconds
FASTEST_US: Final = 20_000  # shortest interval of a stream
SLOWEST_US: Final = 1e10
NEVER_US: Final = -1.0  # as an interval: not sent
APART_NS: Final = 10_000_000  # between the beginnings of two streams: a Unix socket's queue holds ten datagrams
LATER: Final = 512  # messages that wait to be sent to one receiver
AT_ONCE: Final = 16  # of them a poll
RECEIVERS: Final = 16  # for whom messages wait
REMEMBERED: Final = 64  # commands, and requests, that are answered again when they are repeated
PATIENCE_NS: Final = 2 * SECOND_NS  # for a receiver whose queue is full
TEXT_SIZE: Final = 50
FTP_NAK, FTP_NOT_FOUND = 129, 10

HEARTBEAT_ID, PARAM_READ_ID, PARAM_LIST_ID, PARAM_SET_ID, MISSION_LIST_ID = 0, 20, 21, 23, 43
COMMAND_INT_ID, COMMAND_LONG_ID, FTP_ID, TIMESYNC_ID, VERSION_ID, REQUEST_ID = 75, 76, 110, 111, 148, 62000


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """A command as it came: parameters as given, NaN and all."""

    command: int
    params: tuple[float, ...]  # seven
    system: int  # of who asks
    component: int
    address: str

    def number(self, i: int, default: float = 0.0) -> float:
        """Return parameter i, 1-based; the default for one that is not finite."""
        value = self.params[i - 1]
        return value if math.isfinite(value) else default

    def whole(self, i: int, default: int = 0) -> int | None:
        """Return parameter i as a whole number, the default for NaN; None for one that is not whole."""
        value = self.params[i - 1]
        if math.isnan(value):
            return default
        return int(value) if math.isfinite(value) and value == int(value) else None


@dataclass(frozen=True, slots=True)
class Identity:
    """What a component says that it is."""

    component: int
    type: int
    autopilot: int
    capabilities: int


@dataclass(slots=True)
class Traffic:
    """What a component answers and sends, by number. All may be filled after it was made."""

    commands: dict[int, Callable[[CommandRequest], int]] = field(default_factory=dict)  # MAV_CMD -> MAV_RESULT
    messages: dict[int, Callable[[int], Sequence[Message]]] = field(
        default_factory=dict
    )  # made on request (param2) or as a stream
    rates_hz: dict[int, float] = field(default_factory=dict)  # of streams, wall time
    others: dict[int, Callable[[Message, str], None]] = field(default_factory=dict)  # other messages that are taken


class Asked:
    """A request in JSON (HILSAT_REQUEST), and the way to answer it, as often as needed.

    Its answers are kept for a while: whoever asks again by the same token is answered again, and nothing is done twice.
    """

    def __init__(self, component: Component, message: Message, address: str, what: dict[str, Any]) -> None:
        self.what = what
        self.address = address
        self._component = component
        self._token = message.token
        self._to = (message.get_srcSystem(), message.get_srcComponent())
        self._replies: list[list[Message]] = []

    @property
    def key(self) -> tuple[str, int, int, int]:
        """Who asked, by which token."""
        return (self.address, *self._to, self._token)

    def reply(self, state: str, *, final: bool = True, **more: Any) -> None:
        """Queue an answer; one that is too long for the link becomes a refusal."""
        number = len(self._replies)
        try:
            messages = cut_reply({"state": state, **more, "final": final}, self._token, number, *self._to)
        except ValueError as error:
            what = {"state": "refused", "reasons": [f"the answer cannot be sent: {error}"], "final": True}
            messages = cut_reply(what, self._token, number, *self._to)
        self._replies.append(messages)
        self._queue(messages)

    def repeat(self) -> None:
        """Queue all answers given so far once more."""
        for messages in self._replies:
            self._queue(messages)

    def _queue(self, messages: list[Message]) -> None:
        for message in messages:
            self._component.send_later(message, self.address)


class Component:
    """One component of the system on its endpoint."""

    def __init__(
        self,
        endpoint: Endpoint,
        identity: Identity,
        clock: MonotonicClock,
        status: Callable[[], tuple[int, int, int]],
        parameters: Parameters | None = None,
        traffic: Traffic | None = None,
        on_request: Callable[[Asked], None] | None = None,
    ) -> None:
        """status: base mode, custom mode and MAV_STATE for the heartbeat; on_request: takes requests in JSON."""
        self.endpoint = endpoint
        self.identity = identity
        self.parameters = Parameters() if parameters is None else parameters
        self.traffic = Traffic() if traffic is None else traffic
        self._clock = clock
        self._status = status
        self._on_request = on_request
        self._assembler = Assembler()
        self._listeners: dict[str, int] = {}  # when each was last heard [ns]
        self._addresses: list[str] = []  # of those that are still heard
        self._answered: dict[tuple[str, int, int, int], tuple[tuple[float, ...], int]] = {}
        self._asked: dict[tuple[str, int, int, int], Asked] = {}  # the last requests, with their answers
        self._later: dict[str, deque[tuple[Message, int]]] = {}  # by receiver: what waits, and until when
        self._text_id = 0
        self._heartbeat_ns = 0  # when the next is due
        self._streams: dict[int, tuple[int, int]] = {}  # interval and next time [ns]
        self._default_rates: dict[int, float] | None = None
        self._due_ns = 0
        traffic = self.traffic
        traffic.messages.setdefault(VERSION_ID, lambda _: [self._make_version()])
        traffic.messages.setdefault(HEARTBEAT_ID, lambda _: [self._make_heartbeat()])
        traffic.commands.setdefault(words.CMD_REQUEST_MESSAGE, self._request_message)
        traffic.commands.setdefault(words.CMD_SET_MESSAGE_INTERVAL, self._set_interval)
        traffic.commands.setdefault(words.CMD_REQUEST_CAPABILITIES, self._request_version)
        self._takers: dict[int, Callable[[Message, str], None]] = {
            COMMAND_LONG_ID: self._take_command,
            COMMAND_INT_ID: self._take_command,
            PARAM_LIST_ID: self._list_parameters,
            PARAM_READ_ID: self._read_parameter,
            PARAM_SET_ID: self._set_parameter,
            MISSION_LIST_ID: self._count_mission,
            FTP_ID: self._refuse_files,
            TIMESYNC_ID: self._sync_time,
            REQUEST_ID: self._take_request,
        }

    # -- the loop --------------------------------------------------------------------------------------------------

    def poll(self) -> None:
        """Take what has come, send what is due."""
        self.receive()
        self.send()

    def receive(self) -> None:
        """Take what has come. Bounded: at most endpoint.AT_ONCE datagrams and endpoint.PACKETS_AT_ONCE packets."""
        for message, address in self.endpoint.poll():
            self._take(message, address)

    def send(self) -> None:
        """Send what is due. Bounded: AT_ONCE waiting messages to each receiver, each stream once to each listener."""
        if self._later:
            self._send_waiting()
        now_ns = self._clock.now_ns()
        if now_ns >= self._due_ns:
            self._send_due(now_ns)

    @property
    def has_listeners(self) -> bool:
        """Whether anybody is there to hear a stream or a text."""
        return bool(self._addresses)

    def say(self, severity: int, text: str, also: str = "") -> None:
        """Queue a STATUSTEXT for every listener, and for an address besides, in as many parts as it takes."""
        raw = text.encode("utf-8", "replace")
        parts = [raw[i : i + TEXT_SIZE] for i in range(0, len(raw), TEXT_SIZE)] or [b""]
        number = 0
        if len(parts) > 1:
            self._text_id = number = self._text_id % 65535 + 1
        for i, part in enumerate(parts[:255]):
            message = MAVLink_statustext_message(severity, part, number, i)
            for address in self._addresses:  # not at once: a word that finds the queue full must not be lost for that
                self.send_later(message, address)
            if also and also not in self._listeners:
                self.send_later(message, also)

    def broadcast(self, message: Message) -> None:
        """Send a message to every listener."""
        for address in self._addresses:
            self.endpoint.send(message, address)

    def send_later(self, message: Message, address: str) -> None:
        """Queue a message; where too many wait for one receiver, its oldest is dropped and counted."""
        queue = self._later.setdefault(address, deque())
        if len(queue) >= LATER:
            queue.popleft()
            self.endpoint.counters.dropped += 1
        queue.append((message, self._clock.now_ns() + PATIENCE_NS))
        if len(self._later) > RECEIVERS:
            self.endpoint.counters.dropped += len(self._later.pop(next(iter(self._later))))

    def close(self) -> None:
        """Send what waits and can be sent at once, and close the endpoint."""
        for _ in range(LATER // AT_ONCE):
            self._send_waiting()
        self.endpoint.close()

    def _send_waiting(self) -> None:
        """Send some of what waits to each receiver; one whose queue is full holds up no other."""
        for address in list(self._later):
            queue = self._later[address]
            for _ in range(min(AT_ONCE, len(queue))):
                message, until_ns = queue[0]
                if not self.endpoint.try_send(message, address):
                    if self._clock.now_ns() < until_ns:
                        break
                    self.endpoint.counters.dropped += 1
                queue.popleft()
            if not queue:
                del self._later[address]

    def _send_due(self, now_ns: int) -> None:
        self._listeners = {address: t for address, t in self._listeners.items() if now_ns - t < FORGET_NS}
        self._addresses = list(self._listeners)
        self._load_rates()
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + HEARTBEAT_NS
            self.broadcast(self._make_heartbeat())
        for number, (interval_ns, next_ns) in self._streams.items():
            if now_ns >= next_ns:
                self._streams[number] = (interval_ns, max(next_ns + interval_ns, now_ns + interval_ns // 2))
                if self._addresses:
                    for message in self.traffic.messages[number](0):
                        self.broadcast(message)
        self._due_ns = min([self._heartbeat_ns, *[next_ns for _, next_ns in self._streams.values()]])

    def _load_rates(self) -> dict[int, float]:
        """Return the usual rates of the streams; the first time, begin them one after the other, not all at once."""
        if self._default_rates is None:
            self._default_rates = dict(self.traffic.rates_hz)
            due_ns = self._clock.now_ns()
            for number, hz in self._default_rates.items():
                if hz > 0.0:
                    self._streams[number] = (int(SECOND_NS / hz), due_ns)
                    due_ns += APART_NS
        return self._default_rates

    # -- what comes in ---------------------------------------------------------------------------------------------

    def _take(self, message: Message, address: str) -> None:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if system not in (0, words.SYSTEM_ID) or component not in (0, self.identity.component):
            self.endpoint.counters.foreign += 1
            return
        number = message.get_msgId()
        if number == HEARTBEAT_ID:
            self._note_listener(address)
        taker = self._takers.get(number) or self.traffic.others.get(number)
        if taker is not None:
            taker(message, address)

    def _note_listener(self, address: str) -> None:
        """Keep who is there: a heartbeat is what asks for streams and texts."""
        if address and (address in self._listeners or len(self._listeners) < LISTENERS):
            if address not in self._listeners:
                self._due_ns = self._heartbeat_ns = 0  # it hears of us at once
            self._listeners[address] = self._clock.now_ns()
            self._addresses = list(self._listeners)

    # -- commands --------------------------------------------------------------------------------------------------

    def _take_command(self, message: Message, address: str) -> None:
        """Do a command once and answer it; one that is repeated for want of the answer is answered again."""
        if message.get_msgId() == COMMAND_LONG_ID:
            rest = (message.param5, message.param6, message.param7)
            confirmation = message.confirmation
        else:
            rest = (float(message.x), float(message.y), message.z)
            confirmation = 0
        params = (message.param1, message.param2, message.param3, message.param4, *rest)
        system, component, command = message.get_srcSystem(), message.get_srcComponent(), message.command
        key = (address, system, component, command)
        before = self._answered.get(key)
        if confirmation > 0 and before is not None and repr(before[0]) == repr(params):
            result = before[1]
        else:
            handler = self.traffic.commands.get(command)
            request = CommandRequest(command, params, system, component, address)
            result = words.UNSUPPORTED if handler is None else handler(request)
            self._answered.pop(key, None)
            self._answered[key] = (params, result)
            if len(self._answered) > REMEMBERED:
                del self._answered[next(iter(self._answered))]
        self.send_later(MAVLink_command_ack_message(command, result, 0, 0, system, component), address)

    def _request_message(self, request: CommandRequest) -> int:
        number, index = request.whole(1, -1), request.whole(2)
        maker = None if number is None else self.traffic.messages.get(number)
        if maker is None or index is None:
            return words.UNSUPPORTED
        for message in maker(index):
            self.send_later(message, request.address)
        return words.ACCEPTED

    def _request_version(self, request: CommandRequest) -> int:
        self.send_later(self._make_version(), request.address)
        return words.ACCEPTED

    def _set_interval(self, request: CommandRequest) -> int:
        """Set how often a message is sent: -1 never, 0 as usual, else the interval in microseconds."""
        number, interval_us, usual_hz = request.whole(1, -1), request.params[1], self._load_rates()
        if number is None or number not in self.traffic.messages or number == HEARTBEAT_ID:
            return words.UNSUPPORTED
        if interval_us == 0.0:
            rate_hz = usual_hz.get(number, 0.0)
            interval_us = 1e6 / rate_hz if rate_hz > 0.0 else NEVER_US
        if interval_us == NEVER_US:
            self._streams.pop(number, None)
        elif FASTEST_US <= interval_us <= SLOWEST_US:  # NaN is in no range
            self._streams[number] = (int(interval_us * 1e3), self._clock.now_ns())
            self._due_ns = 0
        else:
            text = f"SET_MESSAGE_INTERVAL: {interval_us:g} us is not {FASTEST_US} to {SLOWEST_US:g}, 0 (usual) or -1 (never)"
            self.say(words.WARNING, text, request.address)
            return words.DENIED
        return words.ACCEPTED

    def _take_request(self, message: Message, address: str) -> None:
        what = self._assembler.add(message, address)
        if what is None:
            return
        asked = Asked(self, message, address, what)
        before = self._asked.get(asked.key)
        if before is not None and before.what == what:
            before.repeat()
            return
        self._asked.pop(asked.key, None)
        self._asked[asked.key] = asked
        if len(self._asked) > REMEMBERED:
            del self._asked[next(iter(self._asked))]
        if self._on_request is None:
            asked.reply("refused", reasons=["this component takes no requests; ask the plant"])
        else:
            self._on_request(asked)

    # -- parameters ------------------------------------------------------------------------------------------------

    def _list_parameters(self, message: Message, address: str) -> None:
        for index in range(len(self.parameters.items)):
            self.send_later(self._make_value(index), address)

    def _read_parameter(self, message: Message, address: str) -> None:
        name = text_of(message.param_id)
        index = self.parameters.find(name, message.param_index)
        if index is None:
            self._refuse_parameter(message, name, message.param_index, words.PARAM_DOES_NOT_EXIST, address)
        else:
            self.send_later(self._make_value(index), address)

    def _set_parameter(self, message: Message, address: str) -> None:
        """Set one and echo what is stored; a refused value is answered by PARAM_ERROR, said why, and the stored one."""
        name, value = text_of(message.param_id), float(f"{message.param_value:.7g}")  # 0.99 came as 0.99000001
        index = self.parameters.find(name)
        if index is None:
            self._refuse_parameter(message, name, -1, words.PARAM_DOES_NOT_EXIST, address)
            return
        item = self.parameters.items[index]
        error, why = _try_write(item, value)
        if error:
            self._refuse_parameter(message, name, index, error, address)
            self.say(words.WARNING, f"{name} not set: {why}", address)
        self.send_later(self._make_value(index), address)

    def _refuse_parameter(self, message: Message, name: str, index: int, error: int, address: str) -> None:
        self.send_later(
            MAVLink_param_error_message(
                message.get_srcSystem(), message.get_srcComponent(), name.encode()[:16], index, error
            ),
            address,
        )

    def _make_value(self, index: int) -> Message:
        item = self.parameters.items[index]
        return MAVLink_param_value_message(
            item.name.encode(), single(item.read()), words.PARAM_REAL32, len(self.parameters.items), index
        )

    # -- what ground programs ask on their way in ------------------------------------------------------------------

    def _count_mission(self, message: Message, address: str) -> None:
        self.send_later(
            MAVLink_mission_count_message(
                message.get_srcSystem(), message.get_srcComponent(), 0, getattr(message, "mission_type", 0)
            ),
            address,
        )

    def _refuse_files(self, message: Message, address: str) -> None:
        """There are no files here: said at once, so that nobody waits for them."""
        asked = bytes(message.payload)
        sequence = (int.from_bytes(asked[:2], "little") + 1) & 0xFFFF
        if asked[3] == FTP_NAK:
            return
        head = sequence.to_bytes(2, "little") + bytes([asked[2], FTP_NAK, 1, asked[3], 0, 0]) + asked[8:12]
        payload = list((head + bytes([FTP_NOT_FOUND])).ljust(251, b"\0"))
        self.send_later(
            MAVLink_file_transfer_protocol_message(0, message.get_srcSystem(), message.get_srcComponent(), payload),
            address,
        )

    def _sync_time(self, message: Message, address: str) -> None:
        if message.tc1 == 0:
            self.send_later(MAVLink_timesync_message(self._clock.now_ns(), message.ts1), address)

    def _make_heartbeat(self) -> Message:
        base_mode, custom_mode, state = self._status()
        identity = self.identity
        return MAVLink_heartbeat_message(identity.type, identity.autopilot, base_mode, custom_mode, state, 3)

    def _make_version(self) -> Message:
        return MAVLink_autopilot_version_message(
            self.identity.capabilities, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
        )


def _try_write(item: Parameter, value: float) -> tuple[int, str]:
    """Set a parameter; return the MAV_PARAM_ERROR, 0 for none, and why."""
    if item.write is None:
        return words.PARAM_READ_ONLY, "it can only be read"
    if not (math.isfinite(value) and item.low <= value <= item.high):
        where = (
            f"in {item.low:g} to {item.high:g}" if math.isfinite(item.low + item.high) else "a finite number in range"
        )
        return words.PARAM_OUT_OF_RANGE, f"{value:g} is not {where}"
    why = item.write(value)
    return (words.PARAM_DENIED, why) if why else (0, "")


def single(value: float) -> float:
    """Return a value that fits a 32-bit float: too large ones become infinite."""
    if value != value or abs(value) <= 3.4028234e38:
        return value
    return math.inf if value > 0.0 else -math.inf
