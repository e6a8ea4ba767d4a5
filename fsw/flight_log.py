"""What the flight software writes to the log: its telemetry, a row a tick, and every change of mode in words."""

from __future__ import annotations

from bus.telemetry.link import Link, Row, TickPacker, announce_topics, stamp
from fsw.flight import Flight
from fsw.modes import Mode
from fsw.telemetry import FIRST_CHANNEL, TICK_TOPICS, make_control_topics, make_flattener


class FlightLog:
    """Feeds one telemetry link."""

    def __init__(self, flight: Flight, link: Link, tick_ns: int) -> None:
        self._flight = flight
        self.link = link
        self._tick_ns = tick_ns
        self._mode_changes = 0
        law, detector = flight.controller.internals, flight.detector.internals
        every_tick = TickPacker(TICK_TOPICS, FIRST_CHANNEL)
        on_control = TickPacker(make_control_topics(law, detector), FIRST_CHANNEL + len(TICK_TOPICS))
        self._pack, self._pack_control = every_tick.pack_stamped, on_control.pack_stamped
        self._flatten_law, self._flatten_detector = make_flattener(law), make_flattener(detector)
        link.announce(announce_topics((every_tick, on_control)), self.pack_rows)

    def write(self, tick: int) -> None:
        """Log the cycle of this tick."""
        flight, link = self._flight, self.link
        t_ns = tick * self._tick_ns
        modes = flight.modes
        if modes.changes != self._mode_changes:
            self._mode_changes = modes.changes
            level = "warning" if modes.mode is Mode.SAFE else "info"
            link.event(t_ns, level, "fsw", f"mode {modes.mode.name.lower()}: {modes.reason}")
        link.write_row(flight.publish(tick, t_ns, link.dropped))

    def pack_rows(self, rows: list[Row]) -> list[bytes]:
        """The records of each cycle, from what `Flight.publish` gave."""
        pack, records = self._pack, []
        for tick, t_ns, q_err, error_deg, detection, cycle_ns, max_cycle_ns, lateness_ns, dropped, control in rows:
            (q_ib, omega_bi_b_rad_s, bias_b_rad_s, _), _, gyro_state, wheel_alarm, fault_hat_b_rad_s, _, _ = detection
            head = stamp(tick, t_ns)
            data = pack(head, (
                *q_ib, *omega_bi_b_rad_s, *bias_b_rad_s, *q_err, error_deg,
                *fault_hat_b_rad_s, *gyro_state, *wheel_alarm,
                cycle_ns * 1e-3, max_cycle_ns * 1e-3, lateness_ns * 1e-3, dropped,
            ))  # fmt: skip
            records.append(data if control is None else data + self._pack_control_row(head, tick, control))
        return records

    def _pack_control_row(self, head: bytes, tick: int, control: Row) -> bytes:
        tau_cmd_b_nm, tau_rw_cmd_nm, tau_fault_hat_b_nm, mode, slips, refused, foreign, implausible, law, detector = (
            control
        )
        return self._pack_control(head, (
            *tau_cmd_b_nm, *tau_rw_cmd_nm, *tau_fault_hat_b_nm, tick, mode, slips, refused, foreign, implausible,
            *self._flatten_law(law), *self._flatten_detector(detector),
        ))  # fmt: skip
