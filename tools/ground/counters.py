"""What a gateway leaves behind: per link what came and what became of it, and the words for what was refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

COUNTERS_FILE: Final = "gateway.json"
REFUSED: Final = {
    "garbage": "datagrams that are no MAVLink",
    "bad_checksum": "packets with a wrong checksum",
    "unknown": "packets of unknown messages",
    "foreign": "messages for or from nobody here",
    "bad_signature": "packets without a right signature",
    "dropped": "messages more than could be taken",
}


def describe_counters(private: Path) -> list[str]:
    """Return a line for each link of a gateway that has ended and refused something."""
    try:
        links = json.loads((private / COUNTERS_FILE).read_bytes())
        return [line for address, counters in links.items() if (line := _describe(address, counters))]
    except (OSError, ValueError, AttributeError):
        return []


def _describe(address: str, counters: dict[str, Any]) -> str:
    refused = [f"{counters[key]} {what}" for key, what in REFUSED.items() if counters.get(key)]
    return f"gateway, {address}: refused {', '.join(refused)}" if refused else ""
