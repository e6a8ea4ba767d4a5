"""What the vehicle says by itself: messages that are made of what the flight knows after a cycle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

from bus.mavlink import words
from bus.mavlink.component import single
from bus.mavlink.dialect import (
    MAVLink_attitude_quaternion_message,
    MAVLink_attitude_target_message,
    MAVLink_available_modes_message,
    MAVLink_current_mode_message,
    MAVLink_debug_float_array_message,
    MAVLink_esc_status_message,
    MAVLink_sys_status_message,
    MAVLink_system_time_message,
)
from bus.mavlink.packets import Message
from fsw.flight import Flight
from fsw.modes import MODE_VERBS, Mode
from fsw.node import FswNode
from fsw.telemetry import flatten

SYS_STATUS, SYSTEM_TIME, ATTITUDE_QUATERNION, ATTITUDE_TARGET, ESC_STATUS = 1, 2, 31, 83, 291
DEBUG_FLOAT_ARRAY, AVAILABLE_MODES, CURRENT_MODE = 350, 435, 436
RATES_HZ: Final = {
    ATTITUDE_QUATERNION: 10.0, ESC_STATUS: 5.0, DEBUG_FLOAT_ARRAY: 2.0, ATTITUDE_TARGET: 2.0, SYS_STATUS: 1.0,
    SYSTEM_TIME: 1.0, CURRENT_MODE: 0.5,
}  # fmt: skip

# MAV_SYS_STATUS_SENSOR
GYRO, STAR_TRACKER, RATE_CONTROL, STABILISATION, MOTORS = 1, 128, 1024, 2048, 32768
PRESENT: Final = GYRO | STAR_TRACKER | RATE_CONTROL | STABILISATION | MOTORS
GEOFENCE: Final = 1 << 20  # there is none; MAVProxy calls one that is not well a breach
NOT_SELECTABLE: Final = 2  # MAV_MODE_PROPERTY
NO_THRUST: Final = 64  # ATTITUDE_TARGET_TYPEMASK: thrust means nothing here
UNKNOWN_MV, UNKNOWN_CA, UNKNOWN_PERCENT = 0xFFFF, -1, -1
RPM: Final = 30.0 / math.pi  # of 1 rad/s
FLOATS: Final = 58  # that DEBUG_FLOAT_ARRAY carries

STATES: Final = {
    Mode.STANDBY: words.STATE_STANDBY, Mode.DETUMBLE: words.STATE_ACTIVE, Mode.POINT: words.STATE_ACTIVE,
    Mode.DEGRADED: words.STATE_CRITICAL, Mode.SAFE: words.STATE_EMERGENCY,
}  # fmt: skip
FIXED_FIELDS: Final = (
    ("tau_fault_hat_b_nm", 3), ("omega_bt_b_rad_s", 3), ("q_tb", 4), ("error_deg", 1), ("tau_cmd_b_nm", 3),
    ("tau_rw_nm", 4), ("gyro_fault_hat_b_rad_s", 3), ("bias_b_rad_s", 3),
)  # fmt: skip


class Downlink:
    """Makes the messages of one vehicle."""

    def __init__(self, node: FswNode) -> None:
        self._node = node
        self._flight: Flight = node.flight
        self.rates_hz = RATES_HZ
        self.messages: dict[int, Callable[[int], Sequence[Message]]] = {
            SYS_STATUS: lambda _: [self.make_sys_status()],
            SYSTEM_TIME: lambda _: [MAVLink_system_time_message(0, self._boot_ms)],
            ATTITUDE_QUATERNION: lambda _: [self.make_attitude()],
            ATTITUDE_TARGET: lambda _: [self.make_target()],
            ESC_STATUS: lambda _: [self.make_wheels()],
            DEBUG_FLOAT_ARRAY: lambda _: [self.make_internals()],
            AVAILABLE_MODES: make_modes,
            CURRENT_MODE: lambda _: [self.make_current_mode()],
        }

    @property
    def _boot_ns(self) -> int:
        return self._flight.inputs.sensors.tick * self._node.tick_ns

    @property
    def _boot_ms(self) -> int:
        return self._boot_ns // 1_000_000 & 0xFFFFFFFF

    def find_status(self) -> tuple[int, int, int]:
        """Return base mode, custom mode and state for the heartbeat."""
        mode = self._flight.modes.mode
        armed = 0 if mode is Mode.STANDBY else words.FLAG_ARMED
        return words.FLAG_CUSTOM_MODE | words.FLAG_HIL | armed, int(mode), STATES[mode]

    def make_attitude(self) -> Message:
        """The estimate: q_ib scalar first and the body's rate [rad/s]."""
        estimate = self._flight.detection.estimate
        q0, q1, q2, q3 = _all_single(estimate.q_ib)
        x, y, z = _all_single(estimate.omega_bi_b_rad_s)
        return MAVLink_attitude_quaternion_message(self._boot_ms, q0, q1, q2, q3, x, y, z)

    def make_target(self) -> Message:
        """The target: q_it scalar first and its rate in its own axes [rad/s]."""
        target = self._flight.guidance.target
        x, y, z = _all_single(target.omega_ti_t_rad_s)
        return MAVLink_attitude_target_message(self._boot_ms, NO_THRUST, _all_single(target.q_it), x, y, z, 0.0)

    def make_wheels(self) -> Message:
        """The four wheels: speed with its sign, supply voltage and motor current; NaN where not known."""
        sensors, fitted = self._flight.inputs.sensors, self._flight.vehicle.fitted
        heard = [wheel.valid and there for wheel, there in zip(sensors.wheels, fitted, strict=True)]
        rpm = [_clip(wheel.speed_rad_s * RPM, -(2**31), 2**31 - 1) for wheel in sensors.wheels]
        volts = [single(power.bus_v) if power.valid else math.nan for power in sensors.powers]
        amperes = [single(w.current_a) if good else math.nan for w, good in zip(sensors.wheels, heard, strict=True)]
        return MAVLink_esc_status_message(0, self._boot_ns // 1000, rpm, volts, amperes)

    def make_sys_status(self) -> Message:
        """Which parts are there, in use and well, how full the cycle is, and what was refused and lost."""
        flight, sensors = self._flight, self._flight.inputs.sensors
        mode, detection, health = flight.modes.mode, flight.detection, flight.health
        damps = detection.rate_good and mode is not Mode.STANDBY
        points = mode is Mode.POINT or mode is Mode.DEGRADED
        enabled = GYRO | STAR_TRACKER | (RATE_CONTROL | MOTORS if damps else 0) | (STABILISATION if points else 0)
        well = GEOFENCE
        well |= GYRO if max(detection.gyro_state) < 2 and all(sensors.gyro_valid) else 0
        well |= STAR_TRACKER if sensors.star_valid else 0
        well |= RATE_CONTROL if detection.rate_good else 0
        well |= STABILISATION if detection.estimate.valid and flight.out_of_reach == "" else 0
        well |= (
            MOTORS
            if not any(health.alarm) and not any(health.kind) and health.available == flight.vehicle.fitted
            else 0
        )
        powers = [power for power in sensors.powers if power.valid]
        volts = max([power.bus_v for power in powers]) if powers else -1.0
        amperes = sum([power.bus_current_a for power in powers])
        counters, inputs = flight.executive, flight.inputs.counters
        return MAVLink_sys_status_message(
            PRESENT, enabled, well,
            _clip(counters.last_cycle_ns * 1000.0 / self._node.tick_ns, 0, 0xFFFF),
            _clip(volts * 1e3, 0, 0xFFFE) if powers else UNKNOWN_MV,
            _clip(amperes * 1e2, -0x8000, 0x7FFF) if powers else UNKNOWN_CA,
            UNKNOWN_PERCENT,
            0, _count(inputs.refused), _count(counters.slips), _count(inputs.implausible), _count(inputs.unit_fault),
            _count(flight.inputs.count_rivals()),
        )  # fmt: skip

    def make_internals(self) -> Message:
        """What observer and law hold inside, in the order of `list_internals`, as far as there is room."""
        flight = self._flight
        values = flatten((
            flight.tau_fault_hat_b_nm, flight.error.omega_bt_b_rad_s, flight.error.q_tb, flight.error_deg,
            flight.tau_cmd_b_nm, flight.wheel_commands.tau_rw_nm, flight.detection.fault_hat_b_rad_s,
            flight.detection.estimate.bias_b_rad_s, *flight.observer.internals, *flight.controller.internals,
        ))  # fmt: skip
        floats = [single(float(value)) for value in values[:FLOATS]]
        return MAVLink_debug_float_array_message(
            self._boot_ns // 1000, b"observer", 0, floats + [0.0] * (FLOATS - len(floats))
        )

    def list_internals(self) -> list[str]:
        """The name of each number of `make_internals`."""
        flight = self._flight
        shapes = list(FIXED_FIELDS)
        for family, internals in (("observer", flight.observer.internals), ("law", flight.controller.internals)):
            fields: tuple[str, ...] = getattr(type(internals), "_fields")  # noqa: B009
            for name, value in zip(fields, internals, strict=True):
                shapes.append((f"{family}.{name}", len(value) if isinstance(value, tuple) else 1))
        names = [name if size == 1 else f"{name}[{i}]" for name, size in shapes for i in range(size)]
        return names[:FLOATS]

    def make_current_mode(self) -> Message:
        """The mode, and the one to be in once everything is as it should be."""
        modes = self._flight.modes
        return MAVLink_current_mode_message(0, int(modes.mode), int(modes.intended))


def make_modes(index: int) -> list[Message]:
    """The mode of that number, 1 the first, or all of them for 0."""
    every = list(Mode)
    return [
        MAVLink_available_modes_message(
            len(every),
            i,
            0,
            int(mode),
            0 if mode in MODE_VERBS.values() else NOT_SELECTABLE,
            mode.name.lower().encode(),
        )
        for i, mode in enumerate(every, 1)
        if index in (0, i)
    ]


def _all_single(values: Sequence[float]) -> list[float]:
    return [single(value) for value in values]


def _clip(value: float, low: int, high: int) -> int:
    """The whole number next to a value, within limits; the low one for what is no number."""
    return min(high, max(low, round(value))) if math.isfinite(value) else low


def _count(number: Any) -> int:
    """A counter as 16 bits carry it: one that is full stays full."""
    return min(int(number), 0xFFFF)
