"""What the flight software writes to the log: its telemetry, a row a cycle, and what happened in words."""

from __future__ import annotations

from collections.abc import Sequence

from bus.commands import Command
from bus.telemetry.link import Link, Row, TickPacker, announce_topics, pack_input, stamp
from fsw.flight import Flight
from fsw.modes import Mode
from fsw.telemetry import (
    CONTROL_TOPICS,
    FIRST_CHANNEL,
    INPUT_CHANNEL,
    INPUT_TOPIC,
    TICK_TOPICS,
    flatten,
    make_diagnostics,
    read_internals,
)

SAFE_ASKED, SHEDDING = 1, 2  # flags of /fsw/input
WAIT_S = 1.0  # a mode that waits for longer says for what


class FlightLog:
    """Feeds one telemetry link."""

    def __init__(self, flight: Flight, link: Link, tick_ns: int) -> None:
        self._flight = flight
        self.link = link
        self._tick_ns = tick_ns
        self._mode_changes = 0
        self._waited_for, self._since_tick, self._said = "", 0, False
        self._every_tick = TickPacker(TICK_TOPICS, FIRST_CHANNEL)
        self._on_control = TickPacker(CONTROL_TOPICS, FIRST_CHANNEL + len(TICK_TOPICS))
        packers = [self._every_tick, self._on_control]
        diagnostics = make_diagnostics(flight)
        if diagnostics:
            packers.append(TickPacker(diagnostics, FIRST_CHANNEL + len(TICK_TOPICS) + len(CONTROL_TOPICS)))
        self._diagnostics = packers[2] if diagnostics else None
        link.announce(announce_topics(packers, inputs={INPUT_CHANNEL: INPUT_TOPIC}), self.pack_rows)

    def write(self, tick: int, frames: bytes, commands: Sequence[Command], flags: int) -> None:
        """Log the cycle of this tick: what it was given, what it knows, and, in words, every change of mode.

        flags : SAFE_ASKED, SHEDDING, as in /fsw/input
        """
        flight, link = self._flight, self.link
        t_ns = tick * self._tick_ns
        self._say_mode(tick, t_ns)
        error, detection, counters = flight.error, flight.detection, flight.executive
        estimate = detection.estimate
        control = diagnostics = None
        if flight.control_ran:
            control = self._note_control(tick)
        slot = flight.diagnostics_slot
        if tick >= slot.next_tick and slot.take(tick, bool(flags & SHEDDING)) and self._diagnostics is not None:
            diagnostics = tuple(read_internals(flight).values())
        text = "\n".join([command.to_json() for command in commands]) if commands else ""
        link.write_row((
            tick, t_ns, counters.slips, flags, text, frames,
            estimate.q_ib, estimate.omega_bi_b_rad_s, estimate.bias_b_rad_s, error.q_tb, flight.error_deg,
            flight.guidance.target.q_it,
            detection.fault_hat_b_rad_s, detection.gyro_state, flight.health.alarm,
            counters.last_cycle_ns, counters.max_cycle_ns, counters.last_lateness_ns, link.dropped, control, diagnostics,
        ))  # fmt: skip

    def _note_control(self, tick: int) -> Row:
        """What the control group and the executive have to show, in the order of CONTROL_TOPICS."""
        flight = self._flight
        counters, inputs, health = flight.executive, flight.inputs.counters, flight.health
        target = flight.guidance.target
        return (
            target.omega_ti_t_rad_s, target.alpha_ti_t_rad_s2,
            flight.tau_cmd_b_nm, flight.wheel_commands.tau_rw_nm, flight.allocation.margin,
            flight.tau_fault_hat_b_nm,
            health.effectiveness, health.available, health.explained_b_nm,
            tick, flight.modes.mode, counters.slips, inputs.refused, inputs.foreign, inputs.implausible, inputs.unit_fault,
            counters.skipped, counters.caught_up, flight.diagnostics_slot.shed, flight.torques_saturated,
        )  # fmt: skip

    def pack_rows(self, rows: list[Row]) -> list[bytes]:
        """The records of each cycle, from what `write` noted."""
        pack, records = self._every_tick.pack_stamped, []
        for (
            tick, t_ns, slips, flags, commands, frames, q_ib, omega_bi, bias, q_err, error_deg, q_it, fault_hat, gyro_state,
            wheel_alarm, cycle_ns, max_cycle_ns, lateness_ns, dropped, control, diagnostics,
        ) in rows:  # fmt: skip
            head = stamp(tick, t_ns)
            data = pack(head, (
                *q_ib, *omega_bi, *bias, *q_err, error_deg, *q_it, *fault_hat, *gyro_state,
                *wheel_alarm, cycle_ns * 1e-3, max_cycle_ns * 1e-3, lateness_ns * 1e-3, dropped,
            ))  # fmt: skip
            if control is not None:
                data += self._on_control.pack_stamped(head, flatten(control))
            if diagnostics is not None and self._diagnostics is not None:
                data += self._diagnostics.pack_stamped(head, flatten(diagnostics))
            records.append(data + pack_input(INPUT_CHANNEL, head, slips, flags, commands, frames))
        return records

    def _say_mode(self, tick: int, t_ns: int) -> None:
        """A line for every change of mode, and one for what a mode has been waiting for for WAIT_S."""
        modes = self._flight.modes
        if modes.changes != self._mode_changes:
            self._mode_changes = modes.changes
            level = "warning" if modes.mode is Mode.SAFE else "info"
            self.link.event(t_ns, level, "fsw", f"mode {modes.mode.name.lower()}: {modes.reason}")
            self._waited_for, self._said = "", False
        if modes.waits_for != self._waited_for:
            self._waited_for, self._since_tick, self._said = modes.waits_for, tick, False
        elif self._waited_for and not self._said and (tick - self._since_tick) * self._tick_ns >= WAIT_S * 1e9:
            self._said = True
            self.link.event(t_ns, "info", "fsw", f"mode {modes.mode.name.lower()} waits for {modes.waits_for}")
