"""What a flight of a shootout comes to, in a dozen figures, from the log of the run alone.

From `/truth/attitude`, `/truth/wheels` (every tick) and `/fsw/control`, `/fsw/executive` (every control period). A command
holds until the next one; the torque that a wheel gave is logged as its mean over the tick. Commands are as sent: within the
limits, in whole steps of a frame. A wheel that is dead is still told its torque, so the impulse and the effort count what
was asked of it; the energy counts what the wheels gave.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.modes import Mode
from tools.log.mcap_reader import Run

Floats = NDArray[np.float64]
BOUNDS_DEG: Final = (5.0, 1.0, 0.1)
QUIET_S: Final = 15.0  # settled: the error has stayed within the bound this long and to the end of the run ...
QUIET_SHARE: Final = 0.1  # ... or this share of a run that is short
STEADY_S: Final = 30.0  # the end of the run over which the steady error is taken ...
STEADY_SHARE: Final = 0.25  # ... or this share of a run that is short
FULL: Final = 0.999  # share of a wheel's torque from which on it counts as saturated
POINTING: Final = (float(Mode.POINT), float(Mode.DEGRADED))


@dataclass(frozen=True, slots=True)
class Series:
    """One flight, sample by sample: n ticks, m control periods. Times are those of the samples."""

    end_s: float  # of the run: the last command holds until then
    t_s: Floats  # (n,)
    error_deg: Floats  # (n,), true pointing error
    speed_rad_s: Floats  # (n, 4), of the rotors relative to the body
    tau_rw_true_nm: Floats  # (n, 4), mean over the tick that ends with the sample
    control_t_s: Floats  # (m,)
    tau_cmd_b_nm: Floats  # (m, 3), body torque commanded, as sent
    tau_rw_cmd_nm: Floats  # (m, 4), wheel torques commanded, as sent
    mode: Floats  # (m,)
    max_torque_nm: Floats  # (4,), of the wheels, as the flight software knows them


@dataclass(frozen=True, slots=True)
class Figures:
    """The figures of one flight; a settling time is None where the flight had not settled by its end."""

    settled_5_deg_s: float | None  # last time that the error exceeds 5 deg [s]
    settled_1_deg_s: float | None  # 1 deg
    settled_01_deg_s: float | None  # 0.1 deg
    steady_deg: float  # median error over the last STEADY_S [deg]
    impulse_nms: float  # integral of the norm of the body torque commanded [N m s]
    peak_rw_nm: float  # largest torque that a wheel was told [N m]
    variation_nm_s: float  # total variation of the wheel torques commanded, all four, per second [N m/s]
    energy_j: float  # mechanical work of the wheels without its sign, sum of integrals of |tau_i omega_i| [J]
    effort_n2m2s: float  # integral of the sum of squares of the wheel torques commanded [N^2 m^2 s]
    saturated_share: float  # of time, with at least one wheel told its whole torque [1]
    pointing_share: float  # of time, in a mode in which the law is asked [1]


def read_series(run: Run, end_s: float, max_torque_nm: tuple[float, ...]) -> Series:
    """Return the series of a run's log. Raises RecordError where the log has not what it takes."""
    attitude, wheels, control = (run.signals(name) for name in ("/truth/attitude", "/truth/wheels", "/fsw/control"))
    return Series(
        end_s=end_s,
        t_s=_read(run.t_ns("/truth/attitude") * 1e-9),
        error_deg=_read(attitude["error_deg"]),
        speed_rad_s=_read(wheels["speed_rad_s"]),
        tau_rw_true_nm=_read(wheels["tau_rw_true_nm"]),
        control_t_s=_read(run.t_ns("/fsw/control") * 1e-9),
        tau_cmd_b_nm=_read(control["tau_cmd_b_nm"]),
        tau_rw_cmd_nm=_read(control["tau_rw_cmd_nm"]),
        mode=_read(run.signals("/fsw/executive")["mode"]),
        max_torque_nm=np.array(max_torque_nm),
    )


def _read(values: Any) -> Floats:
    return np.asarray(values, np.float64)


def find_figures(series: Series) -> Figures:
    """Return the figures of a flight."""
    hold_s = np.diff(series.control_t_s, append=series.end_s)
    commands = series.tau_rw_cmd_nm
    full = np.any(np.abs(commands) >= FULL * series.max_torque_nm, axis=1)
    settled = [find_settling_s(series.t_s, series.error_deg, bound, series.end_s) for bound in BOUNDS_DEG]
    return Figures(
        settled_5_deg_s=settled[0],
        settled_1_deg_s=settled[1],
        settled_01_deg_s=settled[2],
        steady_deg=find_steady_deg(series.t_s, series.error_deg, series.end_s),
        impulse_nms=float(np.sum(np.linalg.norm(series.tau_cmd_b_nm, axis=1) * hold_s)),
        peak_rw_nm=float(np.max(np.abs(commands))),
        variation_nm_s=float(np.sum(np.abs(np.diff(commands, axis=0)))) / series.end_s,
        energy_j=find_energy_j(series.t_s, series.tau_rw_true_nm, series.speed_rad_s),
        effort_n2m2s=float(np.sum(np.sum(commands * commands, axis=1) * hold_s)),
        saturated_share=float(np.sum(hold_s[full])) / series.end_s,
        pointing_share=float(np.sum(hold_s[np.isin(series.mode, POINTING)])) / series.end_s,
    )


def find_settling_s(t_s: Floats, error_deg: Floats, bound_deg: float, end_s: float) -> float | None:
    """Return the last time that the error exceeds the bound [s], 0 where it never does; None: not settled.

    Not settled is what exceeds the bound within QUIET_S of the end (of a run shorter than 150 s: within its last tenth).
    An error that is not known exceeds every bound.
    """
    above = np.flatnonzero(~(error_deg <= bound_deg))
    if not above.size:
        return 0.0
    last_s = float(t_s[above[-1]])
    return last_s if end_s - last_s >= min(QUIET_S, QUIET_SHARE * end_s) else None


def find_steady_deg(t_s: Floats, error_deg: Floats, end_s: float) -> float:
    """Return the median error over the last STEADY_S (of a run shorter than 120 s: over its last quarter) [deg]."""
    return float(np.median(error_deg[t_s >= end_s - min(STEADY_S, STEADY_SHARE * end_s)]))


def find_energy_j(t_s: Floats, tau_rw_nm: Floats, speed_rad_s: Floats) -> float:
    """Return the sum over the wheels of the integral of |tau omega| [J]: mechanical, braking counts as driving does.

    The torque is constant over a tick and the speed goes in a straight line from one sample to the next; a tick on which
    it passes zero is two triangles.
    """
    before, after = speed_rad_s[:-1], speed_rad_s[1:]
    p, q = np.abs(before), np.abs(after)
    whole = p + q
    crossing = np.divide(p * p + q * q, whole, out=np.zeros_like(whole), where=whole > 0.0)
    mean = 0.5 * np.where(before * after < 0.0, crossing, whole)
    return float(np.sum(np.abs(tau_rw_nm[1:]) * mean * np.diff(t_s)[:, None]))


def list_unknown(figures: Figures) -> list[str]:
    """Return the names of the figures that are no number: an overflow, or a log with holes."""
    values = {name: getattr(figures, name) for name in Figures.__dataclass_fields__}
    return [name for name, value in values.items() if value is not None and not math.isfinite(value)]
