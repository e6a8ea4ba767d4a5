"""What the flight software writes to the log: its telemetry, a row a cycle, and what happened in words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any, Final

from bus.commands import Command
from bus.native import COMPILED
from bus.telemetry.link import Link, Row, TickPacker, announce_topics, pack_input, stamp
from bus.wheels import ACTIONS, CLEAR_LATCH
from fsw.flight import Flight
from fsw.modes import Mode
from fsw.records import NO_KIND, NO_WHEEL, Detection, Flags4, WheelHealth
from fsw.telemetry import (
    CONTROL_TOPICS,
    FIRST_CHANNEL,
    INPUT_CHANNEL,
    INPUT_TOPIC,
    LINK_HEALTH,
    TICK_TOPICS,
    flatten,
    make_diagnostics,
    read_control,
    read_internals,
    read_link_health,
    read_tick,
)
from fsw.wheel_kinds import BIAS, DRIVER_GAIN, FRICTION, NONE, TORQUE_GAIN, UNKNOWN, WORDS

if COMPILED:  # never where librt may be missing
    from fsw.native_log import pack_cycle

SAFE_ASKED: Final = 1  # flags of /fsw/input
SHEDDING: Final = 2
LINK_CHANNEL: Final = 150
ALARM: Final = 2  # states of a gyro axis from here on: the axis is not used as it is
SOUND_GYRO = (0, 0, 0)
WAIT_S: Final = 1.0  # a mode that waits for longer says for what


class FlightLog:
    """Feeds one telemetry link."""

    def __init__(self, flight: Flight, link: Link, tick_ns: int) -> None:
        self._flight = flight
        self.link = link
        self._tick_ns = tick_ns
        self._mode_changes = 0
        self._requests_said = 0
        self._rivals_said: set[int] = set()
        self._kinds, self._available, self._dither = NO_KIND, flight.vehicle.fitted, 0
        self._dead = NO_WHEEL
        self._gyro_state, self._star_heard, self._star_lost = SOUND_GYRO, False, False
        self._waited_for, self._since_tick, self._said = "", 0, False
        self._every_tick = TickPacker(TICK_TOPICS, FIRST_CHANNEL)
        self._on_control = TickPacker(CONTROL_TOPICS, FIRST_CHANNEL + len(TICK_TOPICS))
        attitude, detection, timing = self._every_tick.prefixes
        self._prefixes = (attitude, detection, timing)
        packers = [self._every_tick, self._on_control]
        diagnostics = make_diagnostics(flight)
        if diagnostics:
            packers.append(TickPacker(diagnostics, FIRST_CHANNEL + len(TICK_TOPICS) + len(CONTROL_TOPICS)))
        self._diagnostics = packers[2] if diagnostics else None
        self._links = TickPacker([LINK_HEALTH], LINK_CHANNEL)
        packers.append(self._links)
        link.announce(announce_topics(packers, inputs={INPUT_CHANNEL: INPUT_TOPIC}), self.pack_rows)
        for words in flight.cautions:
            link.event(0, "warning", "fsw", words)

    def write(self, tick: int, frames: bytes, commands: Sequence[Command], flags: int) -> None:
        """Log the cycle of this tick: what it was given, what it knows, and, in words, every change of mode.

        flags : SAFE_ASKED, SHEDDING, as in /fsw/input
        """
        flight, link = self._flight, self.link
        t_ns = tick * self._tick_ns
        links = None
        self._say_mode(tick, t_ns)
        if flight.outputs.requests_sent != self._requests_said:
            self._say_request(t_ns)
        if flight.control_ran:
            self._say_rivals(t_ns)
            if flight.inputs.watch.is_troubled:
                links = read_link_health(flight)
                self._say_links()
            self._say_sensors(t_ns)
            health = flight.health
            if health.kind != self._kinds or health.available != self._available or health.dither != self._dither:
                self._say_wheels(health, t_ns)
            if health.dead != self._dead:
                self._say_dead(health.dead, t_ns)
        counters = flight.executive
        diagnostics = None
        control = read_control(flight) if flight.control_ran else None
        slot = flight.diagnostics_slot
        if tick >= slot.next_tick and slot.take(tick, bool(flags & SHEDDING)) and self._diagnostics is not None:
            diagnostics = tuple(read_internals(flight).values())
        text = "\n".join([command.to_json() for command in commands]) if commands else ""
        if COMPILED:
            head = stamp(tick, t_ns)
            known = self._pack_known(head)
            link.write_row((
                tick, t_ns, self._pack(known, head, counters.slips, flags, text, frames, control, diagnostics, links)
            ))  # fmt: skip
        else:
            link.write_row((
                tick, t_ns, counters.slips, flags, text, frames, read_tick(flight),
                counters.last_cycle_ns, counters.max_cycle_ns, counters.last_lateness_ns, link.dropped, control,
                diagnostics, links,
            ))  # fmt: skip

    def pack_rows(self, rows: list[Row]) -> list[bytes]:
        """The records of each cycle, from what `write` noted."""
        if COMPILED:
            return [row[2] for row in rows]
        pack_known, records = self._every_tick.pack_stamped, []
        for (
            tick, t_ns, slips, flags, commands, frames, known, cycle_ns, max_cycle_ns, lateness_ns, dropped, control,
            diagnostics, links,
        ) in rows:  # fmt: skip
            head = stamp(tick, t_ns)
            data = pack_known(head, (*known, cycle_ns * 1e-3, max_cycle_ns * 1e-3, lateness_ns * 1e-3, dropped))
            records.append(self._pack(data, head, slips, flags, commands, frames, control, diagnostics, links))
        return records

    def _pack_known(self, head: bytes) -> bytes:
        """The records of TICK_TOPICS at once: compiled, that costs less than to keep what they are made of."""
        return pack_cycle(self._prefixes, head, self._flight, self.link.dropped)

    def _pack(
        self, known: bytes, head: bytes, slips: int, flags: int, commands: str, frames: bytes,
        control: tuple[Any, ...] | None, diagnostics: tuple[Any, ...] | None, links: tuple[Any, ...] | None,
    ) -> bytes:  # fmt: skip
        """The records of a cycle: those of TICK_TOPICS, then what ran on it, then what it was given."""
        data = known
        if control is not None:
            data += self._on_control.pack_stamped(head, flatten(control))
        if diagnostics is not None and self._diagnostics is not None:
            data += self._diagnostics.pack_stamped(head, flatten(chain.from_iterable(diagnostics)))
        if links is not None:
            data += self._links.pack_stamped(head, flatten(links))
        return data + pack_input(INPUT_CHANNEL, head, slips, flags, commands, frames)

    def _say_rivals(self, t_ns: int) -> None:
        """A line, once an id, when a second node is seen to send what only one may."""
        inputs = self._flight.inputs
        if inputs.count_rivals():
            for can_id in inputs.list_rivals():
                if can_id not in self._rivals_said:
                    self._rivals_said.add(can_id)
                    self.link.event(t_ns, "warning", "fsw", f"two senders of 0x{can_id:03X} on the bus")

    def _say_links(self) -> None:
        """A line for every unit that falls silent or is heard again, every babbling id, and what the controller reports."""
        for tick, level, words in self._flight.inputs.watch.take_lines():
            self.link.event(tick * self._tick_ns, level, "fsw", words)

    def _say_sensors(self, t_ns: int) -> None:
        """A line for every axis of the gyro that is found wrong, and when there is no attitude from the star tracker."""
        sensors, detection = self._flight.inputs.sensors, self._flight.detection
        if detection.gyro_state != self._gyro_state:
            self._say_gyro(detection, t_ns)
        if sensors.star_valid != self._star_heard:
            if not self._star_heard and self._star_lost:
                self.link.event(t_ns, "info", "fsw", "star_tracker gives an attitude again")
            elif self._star_heard:
                self._star_lost = True
                self.link.event(t_ns, "warning", "fsw", f"star_tracker: no attitude for {sensors.star_age_s:.1f} s")
            self._star_heard = sensors.star_valid

    def _say_gyro(self, detection: Detection, t_ns: int) -> None:
        """A line for every axis that is found faulty, told what is wrong with it, or found well again."""
        for i, axis in enumerate("xyz"):
            state, before = detection.gyro_state[i], self._gyro_state[i]
            if state >= ALARM and state > before:
                found = "fault isolated" if state == ALARM else "fault classified"
                size = detection.fault_hat_b_rad_s[i]
                self.link.event(t_ns, "warning", "fsw", f"gyro.{axis}: {found}, about {size:.2g} rad/s")
            elif before >= ALARM and state < ALARM:
                self.link.event(t_ns, "info", "fsw", f"gyro.{axis}: no fault any more")
        self._gyro_state = detection.gyro_state

    def _say_request(self, t_ns: int) -> None:
        """A line for every request to a wheel."""
        outputs = self._flight.outputs
        self._requests_said = outputs.requests_sent
        wheel, action, mask = outputs.last_request
        bits = f" 0x{mask:04X}" if action == CLEAR_LATCH else ""
        self.link.event(t_ns, "info", "fsw", f"wheel.{wheel + 1} asked to {ACTIONS[action]}{bits}")

    def _say_wheels(self, health: WheelHealth, t_ns: int) -> None:
        """A line for every wheel of which something else is thought, or that is taken out of use or into use again."""
        event = self.link.event
        for i in (0, 1, 2, 3):
            name, kind = f"wheel.{i + 1}", health.kind[i]
            if kind != self._kinds[i]:
                level = "info" if kind == NONE else "warning"
                event(t_ns, level, "fsw", f"{name}: {WORDS[kind]}{_tell_numbers(health, i)}")
            if health.available[i] and not self._available[i]:
                event(t_ns, "info", "fsw", f"{name} is used again")
            elif self._available[i] and not health.available[i]:
                event(t_ns, "warning", "fsw", f"{name} is switched off and not used")
        if health.dither == 2 and self._dither != 2:
            event(
                t_ns,
                "warning",
                "fsw",
                "a fault cannot be told apart: the wheels in use leave no null space to dither in",
            )
        elif health.dither == 1 and self._dither != 1:
            event(t_ns, "info", "fsw", "dither in the wheels' null space, to tell a wheel's fault apart")
        elif health.dither == 0 and self._dither == 1:
            event(t_ns, "info", "fsw", "dither ends")
        self._kinds, self._available, self._dither = health.kind, health.available, health.dither

    def _say_dead(self, dead: Flags4, t_ns: int) -> None:
        """A line for every wheel that is given up, or comes back."""
        for i in (0, 1, 2, 3):
            if dead[i] and not self._dead[i]:
                self.link.event(t_ns, "warning", "fsw", f"wheel.{i + 1} gives no torque: none is planned on it")
            elif self._dead[i] and not dead[i]:
                self.link.event(t_ns, "info", "fsw", f"wheel.{i + 1} gives torque again")
        self._dead = dead

    def _say_mode(self, tick: int, t_ns: int) -> None:
        """A line for every change of mode, and one for what a mode has been waiting for for WAIT_S."""
        modes = self._flight.modes
        if modes.changes != self._mode_changes:
            self._mode_changes = modes.changes
            level = "warning" if modes.mode is Mode.SAFE or modes.mode is Mode.DEGRADED else "info"
            self.link.event(t_ns, level, "fsw", f"mode {modes.mode.name.lower()}: {modes.reason}")
            self._waited_for, self._said = "", False
        if modes.waits_for != self._waited_for:
            self._waited_for, self._since_tick, self._said = modes.waits_for, tick, False
        elif self._waited_for and not self._said and (tick - self._since_tick) * self._tick_ns >= WAIT_S * 1e9:
            self._said = True
            self.link.event(t_ns, "info", "fsw", f"mode {modes.mode.name.lower()} waits for {modes.waits_for}")


def _tell_numbers(health: WheelHealth, wheel: int) -> str:
    """The numbers that belong to what is thought of a wheel, in words."""
    kind = health.kind[wheel]
    if kind == UNKNOWN:
        return f", {health.deficit_nm[wheel] * 1e3:.2f} mN m"
    if kind == DRIVER_GAIN:
        return f" {health.driver_gain[wheel]:.2f}"
    if kind == TORQUE_GAIN:
        return f" {health.torque_gain[wheel]:.2f}, confidence {health.confidence[wheel]:.2f}"
    if kind in (FRICTION, BIAS):
        return f" {health.friction_nm[wheel] * 1e3:.2f} mN m, confidence {health.confidence[wheel]:.2f}"
    return ""
