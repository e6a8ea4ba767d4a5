"""What a ground station costs the flight software: in real time with and without a flood, in lock-step with its telemetry.

In real time 100 Hz for 20 s, three times: without a link, with a ground station that listens, and with that and a process of
its own that sends the flight software's socket as many datagrams as it can, 10 000 a second at most: good commands, good
requests, rubbish. The socket's queue holds ten datagrams; who sends faster than they are read waits. In process two benches
turn about, in CPU time, which other work on the machine changes little. In lock-step pairs of runs, one with a gateway and
a ground station that listens, one without; what is compared is the wall time of the ticks.
"""

from __future__ import annotations

import contextlib
import os
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from bus.mavlink import words
from bus.mavlink.dialect import MAVLink, MAVLink_command_long_message, MAVLink_param_request_list_message
from tools.config.loader import load_scenario
from tools.config.scenario_files import find_scenario
from tools.ground.launch import GatewayPlan, plan_gateway
from tools.ground.side_link import SideLink
from tools.inject.bench_finder import list_benches
from tools.log.mcap_reader import read_run
from tools.run.bench import Bench
from tools.run.runner import RunReport, run_processes

SCENARIO: Final = "zhang2018-flight"  # 100 Hz
REALTIME_S: Final = 20.0
FLOOD_HZ: Final = 10_000.0
PAIRS: Final = 9
CHUNK: Final = 100  # ticks
GREET_S: Final = 0.5  # between two heartbeats, as the gateway's
ROOT = Path(__file__).resolve().parents[2]


def measure_ground(seconds: float) -> dict[str, Any]:
    """Return the figures; seconds: simulated, of a run in lock-step."""
    results: dict[str, Any] = {
        "real time, no link": _measure_realtime(None, flood=False),
        "real time, a station listens": _with_station(lambda plan: _measure_realtime(plan, flood=False)),
        "real time, a station and a flood": _with_station(lambda plan: _measure_realtime(plan, flood=True)),
    }
    return results | {"in process": _measure_in_process(seconds), "lock-step": _measure_pairs(seconds)}


def _measure_realtime(plan: GatewayPlan | None, flood: bool) -> dict[str, Any]:
    """One run in real time: the longest cycle, how late it was released at most, and deadlines missed."""
    settings = ["clock.mode=realtime", f"duration_s={REALTIME_S}", "faults=[]", "expect=[]"]
    with tempfile.TemporaryDirectory(prefix="measure-") as directory, contextlib.ExitStack() as stack:
        out = Path(directory)
        flooder: list[subprocess.Popen[str]] = []

        def begin(tick: int) -> None:
            if flood and not flooder:
                flooder.append(stack.enter_context(_flood(_find_socket(out))))

        report = run_processes(load_scenario(find_scenario(SCENARIO), settings), out, begin, plan)
        if report.exit_code:
            return {"failed": "; ".join(report.problems)}
        figures = _read_timing(report)
        if flooder:
            flooder[0].terminate()
            figures["datagrams/s that were taken"] = float(flooder[0].communicate()[0]) / REALTIME_S
        return figures


def _read_timing(report: RunReport) -> dict[str, Any]:
    run = read_run(report.log)
    cycle_us, late_us = [], []
    for topic, record in run.iterate_topics("/fsw/timing"):
        values = run.decode(topic, record.data)
        cycle_us.append(float(values["cycle_us"]))
        late_us.append(float(values["lateness_us"]))
    slips = 0.0
    for topic, record in run.iterate_topics("/fsw/executive"):
        slips = run.decode(topic, record.data)["slips"]
    return {
        "cycle, us, p50": statistics.median(cycle_us),
        "cycle, us, worst": max(cycle_us),
        "released late, us, p50": statistics.median(late_us),
        "released late, us, worst": max(late_us),
        "deadlines missed": slips,
    }


def _measure_in_process(seconds: float) -> dict[str, Any]:
    """CPU time of two benches turn about, CHUNK ticks each: one has sockets on both sides, and a station that listens."""
    settings = ["clock.mode=inprocess", f"duration_s={seconds}", "faults=[]", "expect=[]"]
    resolved = load_scenario(find_scenario(SCENARIO), settings)
    spent_s: tuple[list[float], list[float]] = ([], [])
    with tempfile.TemporaryDirectory(prefix="measure-") as name, contextlib.ExitStack() as stack:
        directory = Path(name)
        alone = stack.enter_context(Bench(resolved, log=directory / "alone.mcap"))
        linked = stack.enter_context(Bench(resolved, log=directory / "linked.mcap", ground_dir=directory))
        sides = [SideLink(directory, side, str(directory / f"{side}.sock")) for side in ("plant", "fsw")]
        for link in sides:
            stack.callback(link.close)
        greet_s = 0.0
        for _ in range(resolved.ticks // CHUNK):
            for bench, times_s in zip((alone, linked), spent_s, strict=True):
                begun_s = time.process_time()
                bench.step(CHUNK)
                times_s.append(time.process_time() - begun_s)
            is_due = time.monotonic() >= greet_s
            greet_s = time.monotonic() + GREET_S if is_due else greet_s
            for link in sides:
                if is_due:
                    link.greet()
                link.receive()
        if not linked.fsw_node.ground or not linked.fsw_node.ground.component.endpoint.counters.sent:
            return {"failed": "the station heard nothing"}
    ratios = [one / other for one, other in zip(spent_s[1], spent_s[0], strict=True)]
    return {
        "without a link, cpu-us per tick, median": statistics.median(spent_s[0]) / CHUNK * 1e6,
        "with one, over without, median": statistics.median(ratios),
    }


def _measure_pairs(seconds: float) -> dict[str, Any]:
    """The time of the ticks with a ground station that listens, over that without: the median of pairs."""
    settings = ["clock.mode=lockstep", f"duration_s={seconds}", "faults=[]", "expect=[]"]
    resolved = load_scenario(find_scenario(SCENARIO), settings)

    def fly(plan: GatewayPlan | None) -> float:
        with tempfile.TemporaryDirectory(prefix="measure-") as directory:
            report = run_processes(resolved, Path(directory), lambda tick: None, plan)
            return float(report.details["running_s"]) if not report.exit_code else float("nan")

    ratios, without_s = [], []
    for pair in range(PAIRS):
        if pair % 2:
            linked_s, alone_s = _with_station(fly), fly(None)
        else:
            alone_s = fly(None)
            linked_s = _with_station(fly)
        ratios.append(linked_s / alone_s)
        without_s.append(alone_s)
    return {
        "without a link, us per tick, best": min(without_s) / resolved.ticks * 1e6,
        "with one, over without, median": statistics.median(ratios),
        "with one, over without, of the pairs": " ".join(f"{ratio:.3f}" for ratio in sorted(ratios)),
    }


def _with_station(measure: Callable[[GatewayPlan | None], Any]) -> Any:
    """Measure beside a ground station that takes everything and says nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        with plan_gateway([f"udp:{station.getsockname()[1]}"], None) as plan:
            return measure(plan)


def _find_socket(out: Path) -> str:
    """The socket of the flight software whose log is in this directory."""
    for bench in list_benches():
        if bench.about.out == str(out.absolute()) and bench.about.fsw is not None:
            return bench.about.fsw
    raise FileNotFoundError(f"no bench with its log in {out} runs")


@contextlib.contextmanager
def _flood(path: str) -> Iterator[subprocess.Popen[str]]:
    """A process that floods a socket until it is terminated, and prints how many datagrams were taken."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-P", "-m", "tools.measure.ground", path]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def main(arguments: Sequence[str]) -> int:
    """The flood: PATH of the socket."""
    import signal

    class Ended(Exception):
        """The measurement is over."""

    def end(number: int, frame: object) -> None:
        raise Ended

    signal.signal(signal.SIGTERM, end)
    protocol = MAVLink(None, 255, words.GROUND_COMPONENT)
    system, component = words.SYSTEM_ID, words.FSW_COMPONENT
    request = MAVLink_command_long_message(system, component, words.CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
    packets = [
        request.pack(protocol),
        MAVLink_param_request_list_message(system, component).pack(protocol),
        random.Random(1).randbytes(200),
        request.pack(protocol) * 40,
    ]
    taken = 0
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own, contextlib.suppress(Ended, OSError):
        own.bind(f"{arguments[0]}.flood")  # answers come here and fill the queue: nobody reads them
        due_s = time.monotonic()
        while True:
            own.sendto(packets[taken % len(packets)], arguments[0])
            taken += 1
            due_s = max(due_s + 1.0 / FLOOD_HZ, time.monotonic() - 0.01)
            wait_s = due_s - time.monotonic()
            if wait_s > 1e-3:
                time.sleep(wait_s)
    print(taken)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
