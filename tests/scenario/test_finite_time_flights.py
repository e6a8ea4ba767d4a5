"""The finite-time laws in flight: what is said of their gain, latency looked past with what the wheels were sent."""

from __future__ import annotations

import numpy as np
import pytest

from tools.run.bench import Bench

SAID = "fsw.controller.m: 50 N m, which counts as 0.9124 rad/s^2, is below m_min = 5.042 rad/s^2 of beta 1"


@pytest.mark.parametrize(("check", "said"), [("warn", 1), ("off", 0)])
def test_a_gain_beyond_the_proof_is_told_once_when_the_flight_begins(check: str, said: int) -> None:
    """One warning in the first cycle with `gain_check: warn`, none with `off`."""
    overrides = [f"fsw.controller.gain_check={check}", "expect=[]"]
    with Bench.open("power-integrator", overrides, log="memory") as bench:
        bench.step(20)
        events = [event for event in bench.log.events if event["message"].startswith(SAID)]
        assert len(events) == said
        assert all(event["level"] == 3 and event["timestamp"]["sec"] == 0 for event in events)


@pytest.mark.parametrize(("latency", "least_deg", "most_deg"), [(1, 0.0, 1e-5), (0, 1e-4, 1e-2)])
def test_latency_of_the_loop_is_looked_past(latency: int, least_deg: float, most_deg: float) -> None:
    """One tick of command latency, tilted wheels and all: with the law told of it the error goes to the resolution of the
    star tracker's frames, and without it stays in a limit cycle."""
    overrides = [f"fsw.controller.latency={latency}", "plant.wheels[0].tilt_deg=5", "expect=[]"]
    with Bench.open("power-integrator-100mnm", overrides) as bench:
        bench.step(900)
        errors = []
        for _ in range(100):
            bench.step()
            errors.append(bench.truth.error_deg)
        assert least_deg <= max(errors) < most_deg


def test_what_was_sent_is_what_the_law_reckons_with() -> None:
    """The torque on its way in the law is the sum of the wheels' torques as the frames carry them, after their limits."""
    with Bench.open("power-integrator-100mnm", ["expect=[]"]) as bench:
        for _ in range(30):
            bench.step()
            flight = bench.flight
            wheels = flight.vehicle.wheels
            assert np.abs(flight.wheel_commands.tau_rw_nm).max() <= 0.1
            sent = wheels.combine(flight.wheel_commands.tau_rw_nm)
            assert flight.controller._latency._sent == [pytest.approx(sent, abs=0.0)]  # type: ignore[attr-defined]
