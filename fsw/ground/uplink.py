"""What the ground tells the vehicle: each thing becomes a command in the node's queue, for the tick that comes.

A command that cannot be obeyed is answered with why, at once, by the same check as decides on its tick. What is obeyed is
logged with its tick, so that a replay does it again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from bus.clock import MonotonicClock
from bus.commands import Command
from bus.mavlink import words
from bus.mavlink.component import Asked, CommandRequest
from bus.mavlink.packets import Message
from bus.units import DEG
from bus.words import describe
from fsw import tuning
from fsw.guidance.timeline import PREFIX
from fsw.modes import MODE_VERBS, Mode
from fsw.node import FswNode

ORIGIN: Final = "ground"
SET_MODE, SET_ATTITUDE_TARGET = 11, 82
NO_RATES, NO_ATTITUDE = (1, 2, 4), 128  # ATTITUDE_TARGET_TYPEMASK
NORM_TOLERANCE: Final = 0.01
MOST_WAITING: Final = 64  # commands for later ticks
LONGEST_COMMAND: Final = 1000  # characters of JSON
MOST_ARGUMENTS: Final = 8
LONGEST_VERB: Final = 40
AGAIN_NS: Final = 1_000_000_000  # the same refusal is said once in this time
CHOICE: Final = ", ".join(f"{int(mode)} {mode.name.lower()}" for mode in MODE_VERBS.values())
VERB_OF_MODE: Final = {int(mode): verb for verb, mode in MODE_VERBS.items()}


class Uplink:
    """Takes what comes from the ground for one node."""

    def __init__(self, node: FswNode, clock: MonotonicClock) -> None:
        self._node = node
        self._clock = clock
        self.tick = 0  # the one that comes
        self.describe: Callable[[], dict[str, object]] = dict
        self._wanted: tuple[Any, ...] | None = None  # the attitude target that was last obeyed
        self._course: object = None  # of guidance, that came of it
        self._is_new = False  # and is not known yet
        self._pending: dict[str, float] = {}  # numbers that will be set on the tick that comes
        self._complaint = ("", 0)  # and when it was said
        self.commands: dict[int, Callable[[CommandRequest], int]] = {
            words.CMD_DO_SET_MODE: self._set_mode,
            words.CMD_ARM_DISARM: self._arm,
        }
        self.others: dict[int, Callable[[Message, str], None]] = {
            SET_ATTITUDE_TARGET: self._point,
            SET_MODE: self._take_mode,
        }

    def note_cycle(self) -> None:
        """After the cycle: what was pending is so now."""
        if self._is_new:
            self._is_new = False
            self._course = self._node.flight.guidance.course
        if self._pending:
            self._pending = {}

    def order(self, verb: str, arguments: dict[str, Any], at_tick: int | None = None) -> str:
        """Queue a command for the tick that comes, or a later one; return why it cannot be, empty where it can."""
        tick = self.tick if at_tick is None else max(self.tick, at_tick)
        command = Command(tick, verb, arguments, ORIGIN)
        problem = self._object(command)
        if problem:
            self._complain(f"command {verb[:LONGEST_VERB]} ({ORIGIN}) refused: {problem}")
        else:
            self._node.commands.add(command)
        return problem

    def _object(self, command: Command) -> str:
        """Why a command is not taken; what is checked first bounds the time that the rest takes."""
        if len(command.verb) > LONGEST_VERB or len(command.arguments) > MOST_ARGUMENTS:
            return "no command is that long"
        if len(self._node.commands) >= MOST_WAITING:
            return f"{MOST_WAITING} commands wait already"
        try:
            if len(command.to_json()) > LONGEST_COMMAND:
                return "no command is that long"
        except (TypeError, ValueError, RecursionError):
            return "its arguments hold what is no number"
        return self._node.flight.check(command, command.tick)

    def _complain(self, text: str) -> None:
        """Put a refusal on record; one that is repeated, once a second."""
        now_ns = self._clock.now_ns()
        before, said_ns = self._complaint
        if text != before or now_ns - said_ns >= AGAIN_NS:
            self._complaint = (text, now_ns)
            self._node.log.link.event(self.tick * self._node.tick_ns, "warning", "fsw", text)

    # -- modes -----------------------------------------------------------------------------------------------------

    def _set_mode(self, request: CommandRequest) -> int:
        """MAV_CMD_DO_SET_MODE: param1 has the flag for custom modes, param2 is one."""
        flags, mode = request.whole(1), request.whole(2, -1)
        if flags is None or mode is None or not flags & words.FLAG_CUSTOM_MODE:
            self._complain(f"DO_SET_MODE refused: give a custom mode: param1 1, param2 {CHOICE}")
            return words.DENIED
        return self._enter(mode)

    def _take_mode(self, message: Message, address: str) -> None:
        """SET_MODE, as older ground programs send it."""
        if message.base_mode & words.FLAG_CUSTOM_MODE:
            self._enter(message.custom_mode)

    def _arm(self, request: CommandRequest) -> int:
        """MAV_CMD_COMPONENT_ARM_DISARM: to disarm is to command standby, to arm to command pointing, out of that standby."""
        wanted = request.whole(1, -1)
        if wanted not in (0, 1):
            self._complain("ARM_DISARM refused: param1 is 1 or 0")
            return words.DENIED
        if wanted == 0:
            return self._enter(Mode.STANDBY)
        if self._node.flight.modes.intended is not Mode.STANDBY:
            return words.ACCEPTED
        return self._enter(Mode.POINT)

    def _enter(self, number: int) -> int:
        verb = VERB_OF_MODE.get(number)
        if verb is None:
            self._complain(f"mode {describe(number)} cannot be commanded; there are: {CHOICE}")
            return words.DENIED
        return words.TEMPORARILY_REJECTED if self.order(verb, {}) else words.ACCEPTED

    # -- targets ---------------------------------------------------------------------------------------------------

    def _point(self, message: Message, address: str) -> None:
        """SET_ATTITUDE_TARGET: an attitude to turn to, a rate of the body, or an attitude that turns at a rate.

        Ground programs repeat it all the time: one that says what is followed already changes nothing.
        """
        mask = message.type_mask
        rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        rate = [0.0 if mask & bit else value / DEG for bit, value in zip(NO_RATES, rates, strict=True)]
        q = None if mask & NO_ATTITUDE else [float(value) for value in message.q]
        problem = _judge(q, rate)
        if not problem and q is None and all(mask & bit for bit in NO_RATES):
            problem = "its mask leaves nothing to do"
        if problem:
            self._complain(f"SET_ATTITUDE_TARGET refused: {problem}")
            return
        flight = self._node.flight
        wanted = (q, rate, flight.slew_rate_deg_s, flight.slew_acceleration_deg_s2)
        is_followed = self._is_new or self._course is flight.guidance.course
        if wanted != self._wanted or not is_followed:
            word, arguments = self._choose_course(q, rate)
            if not self.order(PREFIX + word, arguments):
                self._wanted, self._is_new = wanted, True

    def _choose_course(self, q: list[float] | None, rate: list[float]) -> tuple[str, dict[str, Any]]:
        flight = self._node.flight
        acceleration = flight.slew_acceleration_deg_s2
        if q is None:
            return "rate", {"rate_deg_s": rate, "max_acceleration_deg_s2": acceleration}
        if any(rate):
            return "track", {"target_q": q, "rate_deg_s": rate}
        if flight.slew_rate_deg_s > 0.0:
            limits = {"max_rate_deg_s": flight.slew_rate_deg_s, "max_acceleration_deg_s2": acceleration}
            return "slew", {"target_q": q} | limits
        return "hold", {"target_q": q}

    # -- numbers ---------------------------------------------------------------------------------------------------

    def set_number(self, name: str, value: float) -> str:
        """Set a number that can be changed in flight; return why not, empty where it is done on the tick that comes."""
        problem = self.order(tuning.VERB, {"name": name, "value": value})
        if not problem:
            self._pending[name] = value
        return problem

    def read_number(self, name: str) -> float:
        """Return a number as it is, or will be on the tick that comes."""
        value = self._pending.get(name)
        return tuning.read(self._node.flight, name) if value is None else value

    # -- requests in JSON ------------------------------------------------------------------------------------------

    def answer(self, asked: Asked) -> None:
        """Do what a request in JSON asks for: a command by its verb, or the state of the vehicle."""
        what = asked.what
        if what.get("do") == "status":
            asked.reply("done", **clean(self._tell_status()))
        elif what.get("do") != "command":
            asked.reply("refused", reasons=["do: there are: command, status; faults are the plant's, component 25"])
        else:
            verb, arguments, at_tick = what.get("verb"), what.get("arguments", {}), what.get("at_tick")
            good_tick = at_tick is None or (type(at_tick) is int and 0 <= at_tick < 1 << 53)
            known = {"do", "verb", "arguments", "at_tick"}
            if (
                not isinstance(verb, str)
                or not isinstance(arguments, dict)
                or not good_tick
                or not what.keys() <= known
            ):
                asked.reply(
                    "refused", reasons=["a command has verb, arguments (an object) and at_tick (a whole number)"]
                )
                return
            problem = self.order(verb, arguments, at_tick)
            if problem:
                asked.reply("refused", reasons=[problem])
            else:
                asked.reply("accepted", tick=self.tick if at_tick is None else max(self.tick, at_tick))

    def _tell_status(self) -> dict[str, Any]:
        flight = self._node.flight
        modes, estimate, target = flight.modes, flight.detection.estimate, flight.guidance.target
        return {
            "tick": self.tick, "mode": modes.mode.name.lower(), "intended": modes.intended.name.lower(),
            "reason": modes.reason, "waits_for": modes.waits_for, "q_ib": estimate.q_ib,
            "omega_bi_b_rad_s": estimate.omega_bi_b_rad_s, "q_it": target.q_it,
            "omega_ti_t_rad_s": target.omega_ti_t_rad_s, "error_deg": flight.error_deg,
            "tau_fault_hat_b_nm": flight.tau_fault_hat_b_nm, "wheel_kind": flight.health.kind,
            "gyro_state": flight.detection.gyro_state, "out_of_reach": flight.out_of_reach,
            "slips": flight.executive.slips, "numbers": {n: tuning.read(flight, n) for n in tuning.list_names(flight)},
        } | self.describe()  # fmt: skip


def _judge(q: list[float] | None, rate_deg_s: list[float]) -> str:
    """Why an attitude and a rate cannot be followed."""
    if q is not None:
        square = sum([part * part for part in q])
        if not abs(math.sqrt(square) - 1.0) <= NORM_TOLERANCE:  # NaN is not either
            return "the quaternion is not of unit length"
    if not all(math.isfinite(value) for value in rate_deg_s):
        return "a rate is no number"
    return ""


def clean(value: Any) -> Any:
    """Return a value as JSON can carry it: what is no number is null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: clean(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [clean(item) for item in value]
    return value
