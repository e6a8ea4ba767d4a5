"""`hilsat replay LOG --to BUS`: play the frames of a log onto a bus."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
from typing import Any

from bus.errors import UsageError
from bus.process import raise_signals
from bus.wire.address import open_transport
from tools.log.mcap_reader import read_run
from tools.replay.play import Played, Selection, choose_channel, play

FLYING = ("set", "fsw", "process", "plot")  # options that have no meaning here
PLAYING = ("speed", "loop", "from_s", "until_s", "only", "channel", "host")  # and those that have none elsewhere


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of playing."""
    group = parser.add_argument_group("playing the frames of a log onto a bus")
    group.add_argument(
        "--to",
        metavar="BUS",
        help="hub:DIR, socketcan:vcan0 or python-can's INTERFACE:CHANNEL, as in `hilsat run --bus`",
    )
    group.add_argument(
        "--speed", type=_read_speed, metavar="FACTOR", help="times as fast as it was; max: as fast as the bus takes it"
    )
    group.add_argument(
        "--loop", type=_read_count, nargs="?", const=0, metavar="N", help="N times, without N until it is stopped"
    )
    group.add_argument("--from", dest="from_s", type=_read_time, metavar="S", help="begin so many seconds into the log")
    group.add_argument("--until", dest="until_s", type=_read_time, metavar="S", help="and end before this second of it")
    group.add_argument("--only", choices=("plant", "fsw"), help="the frames of one side alone")
    group.add_argument("--channel", metavar="NAME", help="which bus of the log, where it has several")
    group.add_argument("--host", action="store_true", default=None, help="carry the hub: where nobody else does")


def is_asked(args: argparse.Namespace) -> bool:
    """Whether frames are to be played. Raises UsageError where the options do not go together."""
    if args.to is None:
        for name in PLAYING:
            if getattr(args, name) is not None:
                raise UsageError(f"--{name.removesuffix('_s')} belongs to --to BUS: nothing is played without it")
        return False
    for name in FLYING:
        if getattr(args, name):
            raise UsageError(f"--{name} and --to do not go together: what is played is not flown")
    if len(args.logs) != 1:
        raise UsageError(f"one log is played at a time, and there are {len(args.logs)}")
    return True


def run(args: argparse.Namespace) -> int:
    """Play, and say how many frames were sent, also when it was interrupted."""
    selection = Selection(
        speed=1.0 if args.speed is None else args.speed,
        passes=1 if args.loop is None else args.loop,
        from_s=args.from_s or 0.0,
        until_s=args.until_s,
        only=args.only,
        channel=args.channel,
    )
    if selection.until_s is not None and selection.until_s <= selection.from_s:
        raise UsageError(
            f"--until {selection.until_s:g} is not behind --from {selection.from_s:g}: nothing is left to play"
        )
    if args.to.startswith("memory:"):
        raise UsageError(
            f"--to {args.to}: nobody else can listen to a bus inside this process; hub:DIR is one for many"
        )
    log = read_run(args.logs[0])
    choose_channel(log, selection.channel)  # before the bus is opened
    played = Played(address=args.to)
    with raise_signals():
        bus = open_transport(args.to, node=f"replay-{os.getpid()}", host=bool(args.host), filters=[])
        with contextlib.closing(bus):
            try:
                play(log, bus, selection, played)
            finally:
                words: dict[str, Any] = {"log": str(args.logs[0]), **played.as_dict()}
                print(json.dumps(words) if args.json else f"{args.logs[0]}: {played.describe()}")
    return 0


def _read_speed(text: str) -> float:
    if text == "max":
        return 0.0
    speed = float(text)
    if not 0.0 <= speed <= 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a factor from 0 to 1e6 (0 or max: as fast as possible)")
    return speed


def _read_count(text: str) -> int:
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a number of times; leave it out to go on until stopped")
    return count


def _read_time(text: str) -> float:
    seconds = float(text)
    if not (math.isfinite(seconds) and seconds >= 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a time in seconds from the beginning of the log")
    return seconds
