"""User-mode Linux: a kernel that runs as an ordinary process on the host's files. No KVM, no root, no disk image."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from tools.vcan import packages
from tools.vcan.cache import cache_dir, locked, make_cache_dir, say
from tools.vcan.errors import PackageError, VcanError
from tools.vcan.kernel import find_kernel
from tools.vcan.machine import Machine, Request, in_process_namespace, write_job
from tools.vcan.modules import find_modules, order_modules

PACKAGE = "user-mode-linux"
MODULES = ("overlay", "can", "can-raw", "can-bcm", "can-gw", "can-dev", "vcan", "vxcan")
EPOCH_NS = 1_767_225_600 * 10**9  # virtual time begins at 2026-01-01T00:00:00Z
SHIM_SOURCE = Path(__file__).with_name("xsave_shim.c")


def find_obstacle() -> str | None:
    """Return why user-mode Linux cannot run on this host and what to do, None when nothing speaks against it."""
    if platform.machine() != "x86_64":
        return f"user-mode Linux needs an x86-64 host, this is {platform.machine()}"
    if reason := ptrace_obstacle():
        return reason
    if find_kernel() is None and packages.find_unpacked(PACKAGE) is None:
        try:
            packages.require_debian_like()
        except PackageError as error:
            return str(error)
    if needs_shim() and not shim_path().is_file() and packages.find_program("gcc") is None and os.geteuid() != 0:
        return "this processor has AMX, which needs a small shim to be compiled: sudo apt-get install gcc libc6-dev"
    return None


def ptrace_obstacle() -> str | None:
    """Return why a process may not trace its children here, None when it may."""
    try:
        scope = int(Path("/proc/sys/kernel/yama/ptrace_scope").read_text())
    except (OSError, ValueError):
        scope = 0
    if scope >= 3 or (scope == 2 and os.geteuid() != 0):
        return (
            f"ptrace is switched off here (kernel.yama.ptrace_scope = {scope}); sudo sysctl kernel.yama.ptrace_scope=1"
        )
    return None


def prepare(job: Path, request: Request) -> Machine:
    """Return the guest as a process to start; fetches the kernel if it is not cached. Raises VcanError."""
    if reason := find_obstacle():
        raise VcanError(reason)
    kernel, modules = choose_kernel(request.virtual_time)
    todo: dict[str, Any] = {
        "modules": modules,
        "host_root": "",
        "host_mount": None,
        "control": "/dev/ttyS0",
        "power_off": "o",
    }
    write_job(job, request, todo, "guest")
    env = {**os.environ, "TMPDIR": str(memory_dir(request.memory_mb))}
    if shim := find_shim():
        env["LD_PRELOAD"] = str(shim)
    argv = [*in_process_namespace(), str(kernel), *kernel_arguments(job, request)]
    return Machine("user-mode Linux", argv, env, one_cpu=True)


def kernel_arguments(job: Path, request: Request) -> list[str]:
    """Return the guest kernel's command line."""
    time = ["time-travel=inf-cpu", f"time-travel-start={EPOCH_NS}", "norandmaps"] if request.virtual_time else []
    root = ["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "rw", f"init={job}/init"]
    lines = ["con=null", "con0=null,fd:1", "ssl=null", "ssl0=fd:0,null", "quiet", "loglevel=3"]
    return [*time, f"mem={request.memory_mb}M", *root, *lines, f"uml_dir={job}/", "umid=guest", "panic=-1"]


def choose_kernel(virtual_time: bool) -> tuple[Path, list[str]]:
    """Return the kernel and its modules in loading order: the time-travel kernel once built, or Debian's."""
    built = find_kernel()
    if built is not None:
        return built, []
    if virtual_time:
        raise VcanError(
            "--virtual-time needs the time-travel kernel, which is not built: run `hilsat vcan kernel build` once"
        )
    (root,) = packages.unpack(PACKAGE)
    kernel = root / "usr/bin/linux.uml"
    if not kernel.is_file():
        raise VcanError(
            f"the package {PACKAGE} in {root} has no usr/bin/linux.uml; delete that directory and try again"
        )
    return kernel, order_modules(find_modules(root), MODULES)


def needs_shim() -> bool:
    """Return whether the host's XSAVE area is larger than user-mode Linux keeps: it is on processors with AMX."""
    try:
        return re.search(r"^flags\b.*\bamx_tile\b", Path("/proc/cpuinfo").read_text(), re.MULTILINE) is not None
    except OSError:
        return False


def shim_path() -> Path:
    return cache_dir() / "xsave_shim.so"


def find_shim() -> Path | None:
    """Return the compiled shim; None where there is no compiler and no need. Raises VcanError where there is a need."""
    target = shim_path()
    if target.is_file() and target.stat().st_mtime >= SHIM_SOURCE.stat().st_mtime:
        return target
    if packages.find_program("gcc") is None and not needs_shim():
        return None
    packages.install_tools({"gcc": "gcc libc6-dev"})
    make_cache_dir()
    with locked("shim"):
        part = target.with_suffix(f".{os.getpid()}")
        command = ["gcc", "-O2", "-shared", "-fPIC", "-o", str(part), str(SHIM_SOURCE), "-ldl"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode == 0:
            part.rename(target)
            return target
    problem = f"{' '.join(command)} failed: {packages.last_line(result.stderr)}"
    if needs_shim():
        raise VcanError(f"{problem}; this processor needs it (AMX); sudo apt-get install gcc libc6-dev")
    say(f"going on without the optional shim: {problem}")
    return None


def memory_dir(memory_mb: int) -> Path:
    """Return a directory for the guest's memory, a sparse file that must be mappable as code. Raises VcanError."""
    refused = []
    for path in (Path("/dev/shm"), Path(tempfile.gettempdir()), Path("/var/tmp")):
        try:
            status = os.statvfs(path)
        except OSError:
            continue
        free_mb = status.f_bavail * status.f_frsize >> 20
        if free_mb < memory_mb:
            refused.append(f"{path} has {free_mb} MB free")
        elif status.f_flag & os.ST_NOEXEC:
            refused.append(f"{path} is mounted noexec")
        elif os.access(path, os.W_OK):
            return path
        else:
            refused.append(f"{path} is not writable")
    raise VcanError(
        f"no place for the guest's {memory_mb} MB of memory: {'; '.join(refused)}. Ask for less with --mem, or set "
        "TMPDIR (containers: --shm-size=3g)"
    )
