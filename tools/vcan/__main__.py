"""`python -P -m tools.vcan ...` is `hilsat vcan ...`."""

from __future__ import annotations

import sys

from tools.vcan.cli import main

sys.exit(main())
