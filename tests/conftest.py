"""What tests of several folders share: settings of the property tests, and CAN interfaces of the kernel.

The same examples on every CI run, fresh ones on a developer's machine, and a quarter as many unless HILSAT_THOROUGH=1.
Tests on real AF_CAN are skipped where there is none, and fail where HILSAT_REQUIRE_VCAN=1 says that the run was started
for them.
"""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from bus.build import CURRENT
from bus.wire.can_link import find_link, kernel_has_can

# A loaded machine is no reason to fail, so no example has a deadline.
EXAMPLES = 100 if os.environ.get("HILSAT_THOROUGH") == "1" else 25
settings.register_profile("fresh", deadline=None, max_examples=EXAMPLES)
settings.register_profile("same", deadline=None, max_examples=EXAMPLES, derandomize=True)
settings.load_profile("same" if os.environ.get("CI") else "fresh")


def pytest_configure() -> None:
    """Not one test against a compiled build that is stale."""
    if CURRENT.trouble:
        pytest.exit(f"hilsat: {CURRENT.trouble}", returncode=2)


def pytest_report_header() -> str:
    """Which build the tests are about."""
    return f"hilsat: {CURRENT.words}"


# A shell starts what it puts in the background with SIGINT ignored, nohup with SIGHUP, and children inherit that: they would
# not hear what tests send them.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def leave_out(reason: str) -> None:
    """End this test for want of CAN."""
    if os.environ.get("HILSAT_REQUIRE_VCAN") == "1":
        pytest.fail(f"HILSAT_REQUIRE_VCAN=1, and {reason}")
    pytest.skip(reason)


@pytest.fixture
def short_tmpdir(tmp_path: Path) -> Iterator[str]:
    """A directory of a short name for TMPDIR, and `t` in the test's own as a way into it.

    The names of sockets in it must fit 107 bytes, which pytest's directories may not leave room for.
    """
    with tempfile.TemporaryDirectory(prefix="hil-", dir="/tmp", ignore_cleanup_errors=True) as name:
        (tmp_path / "t").symlink_to(name)
        yield name


@pytest.fixture(scope="session")
def kernel_can() -> None:
    """A kernel that opens raw CAN sockets."""
    if not kernel_has_can():
        leave_out("this kernel has no CAN; run `make test-vcan`")


@pytest.fixture(scope="session")
def vcan(kernel_can: None) -> None:
    """The interfaces vcan0 and vcan1, up."""
    for name in ("vcan0", "vcan1"):
        link = find_link(name)
        if link is None or not link.is_up:
            leave_out(f"there is no {name} that is up; run `make test-vcan`")
