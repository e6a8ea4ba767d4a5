"""What was not foreseen, told in one line: the traceback goes where it can be looked at, not over the terminal."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import traceback

PLACE = "HILSAT_TRACES"  # environment: a directory for tracebacks, or "-" for stderr; unset: the temporary directory


def describe_unforeseen(name: str, error: BaseException) -> str:
    """One line: what happened, and where its traceback is, which is kept here. `name`: of the process."""
    what = f"{type(error).__name__}: {error}".replace("\n", " ")
    return f"unforeseen {what}; {_keep(name, error)}; please report it"


def _keep(name: str, error: BaseException) -> str:
    text = "".join(traceback.format_exception(error))
    place = os.environ.get(PLACE)
    if place == "-":
        print(text, end="", file=sys.stderr)
        return "the traceback is above"
    with contextlib.suppress(OSError):
        # Made new in any case: nothing that is there is written over.
        fd, path = tempfile.mkstemp(prefix=f"{name}-traceback-", suffix=".txt", dir=place)
        with open(fd, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
        return f"the traceback is in {path}"
    return "start it with `hilsat --debug` to see the traceback"
