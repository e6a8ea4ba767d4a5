"""A process that flies one run after the other, as it is told through a socket: `python -m tools.campaign.worker FD`.

It is warm: everything is imported before the first run, and what can be kept from run to run is kept. It ends when the
socket is closed.
"""

from __future__ import annotations

import gc
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from bus.process import guard_process

READY: Final = "ready"


def main() -> int:
    """Serve until the other end is closed; return the exit code."""
    return guard_process("campaign worker", lambda: serve(Connection(int(sys.argv[1]))), prepare=_ignore_keyboard)


def _ignore_keyboard() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started us sees to it


def serve(connection: Connection) -> None:
    """Take the job and the directory, then one order after the other; answer each with a Flown."""
    # Here, and not before it is known that this build can be run.
    from tools.campaign.fly import Interruption, fly
    from tools.campaign.job import Job
    from tools.campaign.results import LOG_DIR

    gc.collect()
    gc.freeze()  # what was imported stays for good, and need not be looked through again and again
    try:
        job: Job
        directory: Path
        job, directory = connection.recv()
        connection.send(READY)
        while True:
            order = connection.recv()
            path = directory / LOG_DIR / order.log if order.log else None
            connection.send(fly(job, order.plan, path, f"{LOG_DIR}/{order.log}" if order.log else ""))
    except (EOFError, BrokenPipeError, ConnectionResetError, Interruption):
        return


if __name__ == "__main__":
    sys.exit(main())
