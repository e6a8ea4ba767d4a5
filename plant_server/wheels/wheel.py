"""One wheel of a bank, whatever its model: its faults, and what the bank asks of it."""

from __future__ import annotations

from typing import NamedTuple, cast

from mypy_extensions import mypyc_attr

from plant_server.faults.effects import CURRENT_STEP_A, SPEED_STEP_RAD_S, WheelDisturbance, WheelEffect
from plant_server.faults.timeline import ActiveFault, FaultChain, FaultTimeline

WheelFault = ActiveFault[WheelEffect]


class Pending(NamedTuple):
    """A fault that has changed nothing yet, and what the wheel would be without it."""

    fault: WheelFault
    without: WheelDisturbance


@mypyc_attr(allow_interpreted_subclasses=True)
class Wheel:
    """A wheel between its faults and its bank. Torques are those on the body, about the wheel's axis [N m]."""

    __slots__ = (
        "_chain", "_held_a", "_held_rad_s", "_pending", "_timeline", "current_a", "inertia", "is_odd", "is_steady",
        "limited", "max_speed_rad_s", "speed_per_nm", "state",
    )  # fmt: skip

    def __init__(
        self, unit: str, inertia_kgm2: float, max_speed_rad_s: float, timeline: FaultTimeline, step_s: float
    ) -> None:
        self._timeline = timeline
        self._chain = cast(FaultChain[WheelEffect], timeline.chains[unit])
        self._pending: tuple[Pending, ...] = ()
        self._held_a = 0.0  # what a frozen reading shows
        self._held_rad_s = 0.0
        self.inertia = inertia_kgm2
        self.max_speed_rad_s = max_speed_rad_s  # beyond it the torque is another than at the last step
        self.speed_per_nm = step_s / inertia_kgm2  # how much of it a torque on the body costs the rotor in a step
        self.state = WheelDisturbance()  # what the faults make of it now
        self.is_odd = False  # its telemetry says something else than is so
        self.is_steady = False  # its torque stays what it is but for a speed limit, while command and faults do
        self.limited = False  # at its speed limit
        self.current_a = 0.0  # of the motor at the end of the last step, positive with the torque on the body

    # -- moving --------------------------------------------------------------------------------------------------------

    def start(self, h_nms: float, speed_rad_s: float) -> None:
        """Take the absolute spin momentum and the speed relative to the body at t = 0."""

    def drive(self, step: int, command: float, mode: int, speed_rad_s: float) -> float:
        """Return the mean torque on the body over the integration step `step` [N m].

        command : in the unit of its mode, see WheelBank.receive_modes; 0.0 of mode OFF where there is none
        """
        raise NotImplementedError

    # -- faults --------------------------------------------------------------------------------------------------------

    def look(self, step: int, t_s: float, speed_rad_s: float) -> int:
        """Bring the faults up to date for the step at t_s; return the step of the next look that is due."""
        chain = self._chain
        if step >= chain.next_edge:
            chain.refresh(step)
        for fault in chain.active:
            fault.bring_to(t_s, speed_rad_s)
        self.state = state = self._compose(None)
        self.is_odd = (
            state.speed_frozen
            or state.current_frozen
            or (state.speed_gain, state.speed_offset_rad_s, state.speed_lsb_rad_s) != (1.0, 0.0, 0.0)
            or (state.current_gain, state.current_offset_a, state.current_lsb_a) != (1.0, 0.0, 0.0)
        )
        self._pending = tuple(Pending(fault, self._compose(fault)) for fault in chain.without_effect_yet())
        self._take_up()
        return chain.next_edge if all(fault.is_settled() for fault in chain.active) else step + 1

    def _compose(self, left_out: WheelFault | None) -> WheelDisturbance:
        """Return what all active faults but one make of the wheel, in the order of their onsets."""
        state = WheelDisturbance()
        for fault in self._chain.active:
            if fault is not left_out:
                fault.effect.disturb(state, fault.now)
        return state

    def _take_up(self) -> None:
        """Do with a new `state` whatever a step then need not do."""

    def note_output(self, step: int, speed_rad_s: float, current_a: float) -> None:
        """Note which of the pending faults make the telemetry that is due on this step another."""
        state = self.state
        for fault, without in self._pending:
            if (
                without.silent != state.silent
                or without.late_ticks != state.late_ticks
                or without.counter_frozen != state.counter_frozen
                or _differ(
                    self._show_speed(without, speed_rad_s), self._show_speed(state, speed_rad_s), SPEED_STEP_RAD_S
                )
                or _differ(self._show_current(without, current_a), self._show_current(state, current_a), CURRENT_STEP_A)
            ):
                self._note(fault, step)

    def _note(self, fault: WheelFault, step: int) -> None:
        self._timeline.note_effect(fault, step)
        self._pending = tuple(entry for entry in self._pending if entry.fault is not fault)

    @property
    def has_pending(self) -> bool:
        """Whether a fault has changed nothing yet."""
        return bool(self._pending)

    # -- telemetry -----------------------------------------------------------------------------------------------------

    def report(self, speed_rad_s: float, current_a: float) -> tuple[float, float]:
        """Return speed and current as the telemetry has them, given what the sensors say."""
        speed, current = self._show_speed(self.state, speed_rad_s), self._show_current(self.state, current_a)
        self._held_rad_s, self._held_a = speed, current
        return speed, current

    def _show_speed(self, state: WheelDisturbance, speed_rad_s: float) -> float:
        if state.speed_frozen:
            return self._held_rad_s
        return _show(speed_rad_s, state.speed_gain, state.speed_offset_rad_s, state.speed_lsb_rad_s)

    def _show_current(self, state: WheelDisturbance, current_a: float) -> float:
        if state.current_frozen:
            return self._held_a
        return _show(current_a, state.current_gain, state.current_offset_a, state.current_lsb_a)


def _differ(value: float, other: float, step: float) -> bool:
    """Return whether two readings are different in a frame with such steps."""
    return round(value / step) != round(other / step)


def _show(value: float, gain: float, offset: float, lsb: float) -> float:
    shown = gain * value + offset
    return lsb * round(shown / lsb) if lsb > 0.0 else shown
