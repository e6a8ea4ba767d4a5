"""`vcan status`: what this host can do for CAN, as one record, in words and as JSON."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from bus.wire import rtnetlink
from tools.vcan import diagnosis, kernel, native, packages, qemu, uml
from tools.vcan.cache import cache_dir


@dataclass(frozen=True, slots=True)
class Backend:
    """One way of `vcan exec`: whether it would work, and if not, why."""

    name: str
    usable: bool
    reason: str
    note: str


@dataclass(frozen=True, slots=True)
class Status:
    """Everything `vcan status` says. `missing` is empty when this kernel has CAN and this user may make interfaces."""

    kernel_release: str
    host: str
    has_can: bool
    may_make_interfaces: bool
    missing: list[str]
    interfaces: list[rtnetlink.Link]
    backends: list[Backend]
    exec_backend: str
    time_travel_kernel: dict[str, object]
    cache: str


@dataclass(frozen=True, slots=True)
class Probes:
    """The questions put to the host, each replaceable."""

    can_obstacle: Callable[[], str | None] = native.socket_obstacle
    advise: Callable[[str], list[str]] = diagnosis.advise
    net_admin: Callable[[], bool] = diagnosis.has_net_admin
    links: Callable[[], list[rtnetlink.Link]] = rtnetlink.list_links
    kernel: Callable[[], Mapping[str, object]] = kernel.describe_kernel
    obstacles: tuple[tuple[str, Callable[[], str | None]], ...] = (
        ("native", native.find_obstacle),
        ("uml", uml.find_obstacle),
        ("qemu", qemu.find_obstacle),
    )
    notes: Callable[[str], str] = lambda name: describe_backend(name)


def collect_status(probes: Probes | None = None) -> Status:
    """Return the state of this host. Changes nothing, fetches nothing."""
    ask = probes or Probes()
    obstacle = ask.can_obstacle()
    missing = [] if obstacle is None else [obstacle, *ask.advise(obstacle)]
    admin = ask.net_admin()
    if obstacle is None and not admin:
        missing.append(
            "privilege to make interfaces (CAP_NET_ADMIN): sudo hilsat vcan up vcan0, or hilsat vcan exec -- COMMAND"
        )
    backends = []
    for name, find in ask.obstacles:
        reason = find()
        backends.append(Backend(name, reason is None, reason or "", ask.notes(name) if reason is None else ""))
    return Status(
        kernel_release=os.uname().release,
        host=packages.host_name(),
        has_can=obstacle is None,
        may_make_interfaces=obstacle is None and admin,
        missing=missing,
        interfaces=[link for link in ask.links() if link.is_can],
        backends=backends,
        exec_backend=next((backend.name for backend in backends if backend.usable), ""),
        time_travel_kernel=dict(ask.kernel()),
        cache=str(cache_dir()),
    )


def describe_backend(name: str) -> str:
    """Return what a usable backend will be like: what it runs, and what it fetches first."""
    if name == "native":
        return "private network namespace of this kernel"
    if name == "uml":
        if kernel.find_kernel() is not None:
            return "user-mode Linux, time-travel kernel, about 0.5 s"
        if packages.find_unpacked(uml.PACKAGE) is not None:
            return "user-mode Linux, Debian's kernel, about 2 s"
        return "user-mode Linux, about 2 s; first fetches Debian's package (41 MB)"
    speed = "with KVM" if qemu.has_kvm() else "without KVM: 15 to 35 times slower"
    cached = qemu.find_image() is not None and packages.find_program(qemu.QEMU) is not None
    return f"QEMU {speed}{'' if cached else '; first fetches about 90 MB'}"


def as_record(status: Status) -> dict[str, object]:
    """Return the status as plain values for JSON."""
    return asdict(status)


def as_text(status: Status) -> str:
    """Return the status in words."""
    lines = [f"kernel      {status.kernel_release} ({status.host}): {'has CAN' if status.has_can else 'no CAN'}"]
    lines += [f"missing     {line}" for line in status.missing]
    for link in status.interfaces:
        lines.append(
            f"interface   {link.name} ({link.kind or 'CAN'}): {'up' if link.is_up else 'down'}, MTU {link.mtu}"
        )
    if not status.interfaces:
        lines.append("interface   none")
    for backend in status.backends:
        chosen = " (exec takes this one)" if backend.name == status.exec_backend else ""
        text = f"works{chosen}: {backend.note}" if backend.usable else f"no: {backend.reason}"
        lines.append(f"{backend.name:<11} {text}")
    built = status.time_travel_kernel
    text = f"built: {built['path']}" if built["built"] else f"not built; `hilsat vcan kernel build` ({built['cost']})"
    lines += [f"time travel {text}", f"cache       {status.cache}"]
    return "\n".join(lines)
