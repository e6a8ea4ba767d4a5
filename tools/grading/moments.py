"""When something happened in a run: from when the times of an expectation with `after` count."""

from __future__ import annotations

from tools.log.mcap_reader import Run


def find_moment(run: Run, after: str | None) -> tuple[float, str]:
    """Time [s] of the first effect of a fault, or of the first event with these words, and an empty text.

    after : as in tools/config/expect.py; None: the start of the run
    Where it did not happen the text says so.
    """
    if after is None:
        return 0.0, ""
    word, _, name = after.partition(" ")
    name = name.strip()
    if word == "fault":
        times = [
            record["t_ns"] for record in run.faults
            if record["phase"] == "effect" and name in (record.get("id"), record["unit"], record["fault"])
        ]  # fmt: skip
        missing = f"no fault {name} had an effect"
    else:
        times = [event["t_ns"] for event in run.events if name in event["message"]]
        missing = f"no event says {name!r}"
    return (min(times) / 1e9, "") if times else (0.0, f"{missing}, so that nothing is known of what follows it")
