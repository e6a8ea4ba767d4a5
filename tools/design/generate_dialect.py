"""Writes bus/mavlink/dialect.py from hilsat.xml beside it, by pymavlink: `python -P -m tools.design.generate_dialect`."""

from __future__ import annotations

import contextlib
import io
import shutil
import tempfile
from pathlib import Path

from pymavlink.generator import mavgen

ROOM = Path(__file__).parents[2] / "bus" / "mavlink"
XML, MODULE = ROOM / "hilsat.xml", ROOM / "dialect.py"


def generate(xml: Path = XML) -> str:
    """Return the text of the module that speaks the dialect in this file."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        shutil.copy(xml, place / xml.name)
        options = mavgen.Opts(str(place / "dialect"), wire_protocol="2.0", language="Python3", validate=False)
        with contextlib.redirect_stdout(io.StringIO()):
            if not mavgen.mavgen(options, [str(place / xml.name)]):
                raise ValueError(f"{xml}: the generator refuses it")
        text = (place / "dialect.py").read_text(encoding="utf-8")
    return text.replace(str(place), "").replace('DIALECT = "dialect"', 'DIALECT = "hilsat"')


if __name__ == "__main__":
    MODULE.write_text(generate(), encoding="utf-8")
    print(MODULE)
