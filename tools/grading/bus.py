"""What a run must show of its bus whatever its scenario asks for: that no id has two senders."""

from __future__ import annotations

import numpy as np

from bus.errors import RecordError
from tools.grading.verdict import Verdict, decide
from tools.log.mcap_reader import Run

COUNTERS = (("/fsw/executive", "flight software"), ("/plant/channel", "plant"))  # each with a field `rivals`


def judge_senders(run: Run) -> Verdict:
    """Fails when either side met frames that show a second sender of an id; not executed where neither says anything."""
    name, bound = "no id has two senders", "0 frames of a second sender"
    total, words, said = 0, [], False
    for topic, side in COUNTERS:
        try:
            counts = run.signals(topic)["rivals"] if run.has(topic) else np.empty(0)
        except (RecordError, KeyError):
            counts = np.empty(0)
        if not counts.size:
            continue
        said = True
        total += int(counts[-1])
        if counts[-1]:
            words.append(f"{int(counts[-1])} met by the {side}")
    if not said:
        detail = f"the log has none of {', '.join(f'{topic}.rivals' for topic, _ in COUNTERS)}"
        return Verdict(name, "not executed", None, bound, None, "frames", detail)
    return Verdict(name, decide(total == 0), total, bound, -total, "frames", ", ".join(words))
