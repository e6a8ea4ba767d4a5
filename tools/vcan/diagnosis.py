"""What exactly this kernel lacks for CAN, and the line that would mend it."""

from __future__ import annotations

import gzip
import os
import re
from pathlib import Path

MODULES = ("can", "can-raw", "vcan")
OPTIONS = {"can": "CONFIG_CAN", "can-raw": "CONFIG_CAN_RAW", "vcan": "CONFIG_CAN_VCAN"}
NET_ADMIN_BIT = 12
EXEC_HINT = "without touching the kernel: hilsat vcan exec -- COMMAND"


def advise(reason: str) -> list[str]:
    """Return what to do about a missing part of CAN, best first."""
    if "forbidden" in reason:
        return ["a container needs a profile that allows AF_CAN sockets (--security-opt seccomp=unconfined)", EXEC_HINT]
    release = os.uname().release
    files = find_module_files(release)
    sudo = "" if os.geteuid() == 0 else "sudo "
    where = "on the host of this container: " if in_container() else ""
    lines = []
    options = read_kernel_options(release)
    lacking = [OPTIONS[name] for name in MODULES if options and options.get(OPTIONS[name], "n") == "n"]
    if lacking:
        lines.append(
            f"this kernel ({release}) was built without {', '.join(lacking)}: another kernel is the only native way"
        )
    elif all(name in files for name in MODULES):
        lines.append(f"the modules are on disk but not loaded: {where}{sudo}modprobe -a {' '.join(MODULES)}")
    elif "microsoft" in release.lower():
        lines.append("WSL's kernel has no CAN unless you build one with CONFIG_CAN=m and set it in .wslconfig")
    else:
        absent = [name for name in MODULES if name not in files]
        text = f"no module {', '.join(absent)} below /lib/modules/{release}"
        if options:  # the kernel can have them: they are in a package that is not installed
            install = f"{sudo}apt-get install linux-modules-extra-{release}"
            text += f": {where}{install} (Ubuntu), then modprobe -a {' '.join(MODULES)}"
        lines.append(text)
    return [*lines, EXEC_HINT]


def find_module_files(release: str) -> dict[str, str]:
    """Return the CAN modules on disk for a kernel release by name, compressed or not."""
    found = {}
    for path in Path("/lib/modules", release, "kernel").rglob("*can*.ko*"):
        found[path.name.split(".ko")[0]] = str(path)
    return found


def read_kernel_options(release: str) -> dict[str, str]:
    """Return the running kernel's configuration as far as it can be read; empty when it cannot."""
    text = ""
    try:
        text = gzip.decompress(Path("/proc/config.gz").read_bytes()).decode()
    except OSError:
        for path in (Path("/boot", f"config-{release}"), Path("/lib/modules", release, "config")):
            if path.is_file() and os.access(path, os.R_OK):
                text = path.read_text()
                break
    return dict(re.findall(r"^(CONFIG_\w+)=(.*)$", text, re.MULTILINE))


def in_container() -> bool:
    """Return whether this looks like a container, whose modules are its host's to load."""
    if Path("/.dockerenv").exists() or Path("/run/.containerenv").exists():
        return True
    try:
        return b"container=" in Path("/proc/1/environ").read_bytes()
    except OSError:
        return False


def has_net_admin() -> bool:
    """Return whether this process may change network interfaces (CAP_NET_ADMIN in its effective set)."""
    try:
        found = re.search(r"^CapEff:\s*([0-9a-f]+)", Path("/proc/self/status").read_text(), re.MULTILINE)
    except OSError:
        return False
    return found is not None and bool(int(found[1], 16) >> NET_ADMIN_BIT & 1)
