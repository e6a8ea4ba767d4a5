"""`hilsat inject`: break and heal units of a bench that runs, see what acts, keep it as a scenario.

    hilsat inject catalogue wheel.2                              what can be broken, and the keys of each kind
    hilsat inject wheel.2 loss effectiveness=0.3 --for 20 --wait
    hilsat inject list
    hilsat inject clear wheel.2
    hilsat inject export runs/.../run.mcap -o faults.yaml        the same faults, for a scenario file

The bench takes faults when its scenario says `inject: allowed`, or it was started with `hilsat run --inject`.

Exit codes: 0 done; 1 the fault ended and had changed nothing (--wait); 2 refused, or not to be repeated exactly (export);
3 no bench runs, it ended, or it does not answer.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bus.errors import HilsatError, PeerLostError, UsageError
from tools.inject.bench_finder import find_plant, list_benches
from tools.inject.request_words import ACTIONS, make_request, spell_out

ANSWER_S = 5.0  # that a bench may take to answer
TITLES = {
    "set": "break a unit: hilsat inject UNIT KIND KEY=VALUE ..., the word set may be left out",
    "list": "what acts, waits and is over",
    "catalogue": "what can be broken: units, kinds, keys with unit and range",
    "status": "which bench runs and how far it is",
    "clear": "heal: one fault by its id, a unit, or all",
    "export": "a log's faults, commanded ones too, as a list for a scenario file",
    "completion": "a completion script for the shell",
}


def expand(words: list[str]) -> list[str]:
    """Return the words behind the verb with the action named."""
    return spell_out(words)


def add_parser(subparsers: Any) -> None:
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        "inject",
        help="break a running bench",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    made = {
        name: actions.add_parser(name, help=TITLES[name], description=_capitalise(TITLES[name]), allow_abbrev=False)
        for name in ACTIONS
    }
    _add_set(made["set"])
    made["catalogue"].add_argument("unit", nargs="?", metavar="UNIT", help="wheel.1, gyro.x, star_tracker, ...")
    made["clear"].add_argument(
        "what", nargs="?", metavar="ID|UNIT", help="id of a fault, or a unit for all of its faults"
    )
    made["clear"].add_argument("--all", action="store_true", help="every fault")
    made["export"].add_argument("log", type=Path, metavar="LOG", help="MCAP file of a run")
    made["export"].add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write it (default: stdout)")
    made["export"].add_argument("--extends", metavar="SCENARIO", help="make it a scenario that changes this one")
    made["export"].add_argument("--force", action="store_true", help="replace a file of that name")
    made["completion"].add_argument("shell", choices=["bash"])
    for name in ("set", "list", "catalogue", "status", "clear"):
        made[name].add_argument("--run", type=Path, metavar="DIR", help="which bench: the directory of its log")
        made[name].add_argument("--json", action="store_true", help="print one JSON object on stdout")
        if name != "set":
            made[name].add_argument(
                "--timeout", type=_read_span, default=ANSWER_S, metavar="S", help="to wait for an answer"
            )
    for name, act in ACTS.items():
        made[name].set_defaults(func=run, act=act, json=False)


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("unit", metavar="UNIT", help="wheel.1, gyro.x, star_tracker, ...")
    parser.add_argument("kind", metavar="KIND", help="see hilsat inject catalogue UNIT")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="keys as of a fault in a scenario file")
    parser.add_argument("--at-tick", type=int, metavar="N", help="when it begins (default: at once)")
    parser.add_argument("--at", type=_read_time, dest="at_s", metavar="S", help="the same in simulated time [s]")
    parser.add_argument("--for", type=_read_time, dest="for_s", metavar="S", help="how long it acts [s]")
    parser.add_argument(
        "--until", type=_read_time, dest="until_s", metavar="S", help="when it ends, simulated time [s]"
    )
    parser.add_argument("--id", help="name in the log and for clear")
    parser.add_argument("--profile", help="how it comes on: step, ramp, intermittent, ...")
    parser.add_argument("--wait", action="store_true", help="end when it has changed something")
    parser.add_argument(
        "--timeout", type=_read_span, metavar="S",
        help=f"to wait for an answer (default: {ANSWER_S:g}), with --wait also for the effect (default: as long as it runs)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Do it; return the exit code."""
    try:
        return int(args.act(args))
    except HilsatError as error:
        if args.json:
            reasons = getattr(error, "reasons", None) or str(error).splitlines()
            state = "refused" if isinstance(error, UsageError) else "failed"
            print(json.dumps({"state": state, "reasons": reasons, "exit_code": error.exit_code}))
        print(f"hilsat inject: {error}", file=sys.stderr)
        return error.exit_code


def _show(args: argparse.Namespace, what: dict[str, Any], format_it: Callable[[dict[str, Any]], str]) -> int:
    print(json.dumps(what, allow_nan=False) if args.json else format_it(what))
    return 0


# -- what needs a bench ------------------------------------------------------------------------------------------------


def _ask(args: argparse.Namespace, what: dict[str, Any]) -> dict[str, Any]:
    from tools.inject.client import PlantClient

    bench = find_plant(args.run)
    with PlantClient(Path(bench.about.plant or "")) as client:
        return client.ask_once(what, args.timeout)


def _set(args: argparse.Namespace) -> int:
    from tools.inject.client import PlantClient

    what = make_request(args.unit, args.kind, args.settings, vars(args))
    bench = find_plant(args.run)
    accepted: dict[str, Any] = {}
    last: dict[str, Any] = {}
    with PlantClient(Path(bench.about.plant or "")) as client:
        try:
            for last in client.ask(what, args.timeout or ANSWER_S, args.timeout):
                if not accepted:
                    accepted = last
                if not args.json:
                    print(_format_step(last), flush=True)
        except PeerLostError as error:
            if not accepted:
                raise
            begins = f"it begins at tick {accepted.get('tick')} and stays set"
            raise PeerLostError(
                f"{accepted.get('id')} was accepted; {begins}, and no effect is known: {error}"
            ) from None
    if args.json:
        print(json.dumps(last if last is accepted else last | {"accepted": accepted}, allow_nan=False))
    if not args.wait or last.get("state") == "bit":
        return 0
    print(f"hilsat inject: {last.get('id', accepted.get('id'))}: {_say_end(str(last.get('state')))}", file=sys.stderr)
    return 3 if last.get("state") == "closing" else 1


def _say_end(state: str) -> str:
    if state == "closing":
        return "the bench ended before the fault had changed anything"
    return f"{state} before it had changed anything"


def _format_step(reply: dict[str, Any]) -> str:
    words = {"accepted": "acts from", "bit": "first changed something at", "closing": "the bench closes at"}
    state = str(reply.get("state"))
    text = f": {reply['text']}" if reply.get("text") else ""
    return (
        f"{reply.get('id', '')}  {words.get(state, state + ' at')} tick {reply.get('tick')}{_format_time(reply)}{text}"
    )


def _format_time(reply: dict[str, Any]) -> str:
    return f" ({reply['t_s']:g} s)" if isinstance(reply.get("t_s"), int | float) else ""


def _list(args: argparse.Namespace) -> int:
    return _show(args, _ask(args, {"do": "list"}), _format_list)


def _format_list(reply: dict[str, Any]) -> str:
    lines = [f"tick {reply.get('tick')}{_format_time(reply)}"]
    for fault in reply.get("faults", []):
        effect = "" if fault.get("had_effect") else ", no effect so far"
        keys = {k: v for k, v in fault.get("definition", {}).items() if k not in ("id", "unit", "kind")}
        words = " ".join(f"{key}={json.dumps(value)}" for key, value in keys.items())
        lines.append(f"  {fault['id']:<16} {fault['state'] + effect:<26} {fault['unit']} {fault['kind']} {words}")
    return "\n".join(lines if len(lines) > 1 else [*lines, "  no faults"])


def _status(args: argparse.Namespace) -> int:
    return _show(args, _ask(args, {"do": "status"}), _format_status)


def _format_status(reply: dict[str, Any]) -> str:
    return f"{reply.get('name')}: tick {reply.get('tick')} of {reply.get('ticks')}{_format_time(reply)}"


def _clear(args: argparse.Namespace) -> int:
    from plant_server.faults.units import UNITS

    if args.all == (args.what is not None):
        raise UsageError("clear takes the id of a fault or a unit, or --all; see hilsat inject list")
    which = {} if args.all else {"unit" if args.what in UNITS else "id": args.what}
    return _show(args, _ask(args, {"do": "clear", **which}), _format_cleared)


def _format_cleared(reply: dict[str, Any]) -> str:
    return (
        f"cleared at tick {reply.get('tick')}: {', '.join(map(str, reply.get('ids', []))) or 'nothing acts or waits'}"
    )


# -- what does not -----------------------------------------------------------------------------------------------------


def _catalogue(args: argparse.Namespace) -> int:
    """What the running plant takes; what any plant takes where none runs."""
    from plant_server.ground.catalogue import list_kinds
    from tools.inject.catalogue import format_kinds

    if args.run is None and not any(bench.about.plant for bench in list_benches()):
        kinds = list_kinds(None, args.unit)
        if isinstance(kinds, str):
            raise UsageError(kinds)
        print("hilsat inject: no bench runs; this is what any plant may take", file=sys.stderr)
        reply: dict[str, Any] = {"state": "done", "kinds": kinds}
    else:
        reply = _ask(args, {"do": "catalogue"} | ({} if args.unit is None else {"unit": args.unit}))
    return _show(args, reply, lambda what: format_kinds(what.get("kinds", [])))


def _export(args: argparse.Namespace) -> int:
    from tools.inject.export import export_faults, format_export
    from tools.log.outputs import create

    exported = export_faults(args.log)
    text = format_export(exported, args.log, args.extends)
    if args.output is None:
        print(text, end="")
    else:
        with create(args.output, args.log, args.force) as part:
            part.write_text(text, encoding="utf-8")
    for note in exported.notes:
        print(f"hilsat inject export: {note}", file=sys.stderr)
    for problem in exported.inexact:
        print(f"hilsat inject export: cannot be repeated exactly: {problem}", file=sys.stderr)
    return 2 if exported.inexact else 0


def _completion(args: argparse.Namespace) -> int:
    from tools.cli import VERBS
    from tools.inject.completion import write_completion

    print(write_completion(tuple(VERBS)), end="")
    return 0


def _read_time(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is no time of a run; give seconds, 0 or more")
    return value


def _read_span(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text} s is no time to wait; give more than 0")
    return value


def _capitalise(text: str) -> str:
    return text[0].upper() + text[1:]


ACTS: dict[str, Callable[[argparse.Namespace], int]] = {
    "set": _set, "list": _list, "catalogue": _catalogue, "status": _status, "clear": _clear, "export": _export,
    "completion": _completion,
}  # fmt: skip
