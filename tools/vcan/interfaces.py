"""`vcan up` and `vcan down`: CAN interfaces of this very kernel."""

from __future__ import annotations

import errno
import re
from collections.abc import Sequence

from bus.errors import UsageError
from bus.wire import rtnetlink
from tools.vcan import native
from tools.vcan.diagnosis import advise
from tools.vcan.errors import VcanError

NAME = re.compile(r"[A-Za-z0-9_.-]{1,15}")
ADD_RIGHT = "it takes CAP_NET_ADMIN: run it with sudo, or use `hilsat vcan exec`, which needs no rights"


def parse_names(text: str) -> list[str]:
    """Return the interface names of a comma-separated list. Raises UsageError if empty or if Linux refuses a name."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UsageError(f'"{text}" names no interface; for example: vcan0,vcan1')
    check_names(names)
    return names


def check_names(names: Sequence[str]) -> None:
    """Raise UsageError for a name that Linux refuses, or that comes twice."""
    for name in names:
        if not NAME.fullmatch(name) or name in (".", "..", "lo"):
            raise UsageError(
                f'"{name}" is no interface name: 1 to 15 letters, digits, "_", "-" or ".", and not lo; e.g. vcan0'
            )
        if names.count(name) > 1:
            raise UsageError(f'interface "{name}" is named twice')


def bring_up(names: Sequence[str]) -> list[str]:
    """Make the vcan interfaces that are not there, switch all of them on, and return what was done, a line each.

    Raises VcanError with what is missing (CAN in the kernel, module, privilege), UsageError for names that are taken by
    something else than CAN.
    """
    check_names(names)
    if reason := native.socket_obstacle():
        raise VcanError("\n".join([f"{', '.join(names)}: {reason}", *advise(reason)]))
    there = {link.name: link for link in rtnetlink.list_links()}
    return [bring_up_one(name, there.get(name)) for name in names]


def bring_up_one(name: str, link: rtnetlink.Link | None) -> str:
    if link is not None and not link.is_can:
        raise UsageError(f"{name} is there and is not a CAN interface; choose another name")
    if link is not None and link.is_up:
        return f"{name}: is up already ({link.kind or 'CAN'})"
    if link is not None and link.kind != "vcan":
        raise VcanError(
            f"{name} is a {link.kind or 'CAN'} adapter and is down; its bit rate is yours to choose: "
            f"sudo ip link set {name} up type can bitrate 500000"
        )
    try:
        if link is None:
            rtnetlink.add_vcan(name)
        else:
            rtnetlink.switch_link(name, up=True)
    except OSError as error:
        raise explain(name, error) from error
    return f"{name}: {'made and switched on' if link is None else 'switched on'}"


def take_down(names: Sequence[str]) -> list[str]:
    """Remove the vcan interfaces and return what was done, a line each. Raises VcanError; UsageError for adapters."""
    check_names(names)
    there = {link.name: link for link in rtnetlink.list_links()}
    return [take_down_one(name, there.get(name)) for name in names]


def take_down_one(name: str, link: rtnetlink.Link | None) -> str:
    if link is None:
        return f"{name}: is not there"
    if link.kind != "vcan":
        raise UsageError(
            f"{name} is not a vcan interface ({link.kind or 'no virtual one'}); sudo ip link set {name} down"
        )
    try:
        rtnetlink.delete_link(name)
    except OSError as error:
        raise explain(name, error) from error
    return f"{name}: removed"


def explain(name: str, error: OSError) -> VcanError:
    """Return the error that says what a refusal of the kernel means."""
    if error.errno in (errno.EPERM, errno.EACCES):
        return VcanError(f"{name}: not permitted; {ADD_RIGHT}")
    if error.errno == errno.EOPNOTSUPP:
        return VcanError("\n".join([f"{name}: this kernel's vcan driver is not loaded", *advise("module vcan")]))
    return VcanError(f"{name}: {error.strerror}")
