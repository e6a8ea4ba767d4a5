"""Settings of the property tests: the same examples on every CI run, fresh ones on a developer's machine."""

from __future__ import annotations

import os

from hypothesis import settings

# A loaded machine is no reason to fail, so no example has a deadline.
settings.register_profile("fresh", deadline=None)
settings.register_profile("same", deadline=None, derandomize=True)
settings.load_profile("same" if os.environ.get("CI") else "fresh")
