"""What the flight software can be told to point at, by the scenario's timeline or while it runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from bus.commands import Command
from bus.settings import build, plain
from fsw.families import Guide
from fsw.guidance.hold import Hold
from fsw.guidance.rate import Rate
from fsw.guidance.settings import HoldConfig, RateConfig, SlewConfig, TrackConfig
from fsw.guidance.slew import Slew
from fsw.guidance.track import Track
from fsw.records import Target

PREFIX: Final = "target."
RATE: Final = PREFIX + "rate"

# verb of the command, after PREFIX, and word `do` in the settings -> settings and course
GUIDES: dict[str, tuple[type, Callable[[Any, Target, float], Guide]]] = {
    "hold": (HoldConfig, Hold),
    "slew": (SlewConfig, Slew),
    "track": (TrackConfig, Track),
    "rate": (RateConfig, Rate),
}

if TYPE_CHECKING:
    TimelineEntry = HoldConfig | SlewConfig | TrackConfig | RateConfig
else:
    import functools
    import operator

    TimelineEntry = functools.reduce(operator.or_, [settings for settings, _ in GUIDES.values()])


def make_command(entry: TimelineEntry, tick_s: float) -> Command:
    """The command that a timeline entry stands for: at the first tick at or after its time."""
    tick = -int(-(entry.at_s / tick_s - 1e-6) // 1)
    return Command(max(0, tick), PREFIX + entry.do, plain(entry))


def make_guide(command: Command, start: Target, t_s: float) -> Guide:
    """The course that a command asks for, from where the target stands. Raises ConfigError when it is wrong."""
    word = command.verb.removeprefix(PREFIX)
    settings, make = GUIDES[word]
    entry: Any = build(settings, {"do": word, "at_s": t_s} | command.arguments, f"command {command.verb}")
    return make(entry, start, t_s)


def is_known(verb: str) -> bool:
    """True where the verb is one of guidance."""
    return verb.startswith(PREFIX) and verb.removeprefix(PREFIX) in GUIDES
