"""Process 1 of a guest kernel: modules, file systems, interfaces, then the command. Standard library only (-I -S).

The guest's root is a copy-on-write view of the host's files (an overlay whose upper layer is in the guest's memory);
the directories of the plan are the host's own.
"""

from __future__ import annotations

import ctypes
import os
import platform
import sys
import termios
from pathlib import Path
from typing import Any

from tools.vcan import plan
from tools.vcan.namespaces import start_network
from tools.vcan.supervisor import Command, supervise

MS_BIND = 4096
MNT_DETACH = 2
FINIT_MODULE = {"x86_64": 313, "aarch64": 273}
PIVOT_ROOT = {"x86_64": 155, "aarch64": 41}
LIBC = ctypes.CDLL(None, use_errno=True)


def main(job_dir: str) -> None:
    """Carry out the plan in `job_dir` and switch the guest off. Whatever goes wrong is in the job's guest.log."""
    job = Path(job_dir)
    log = os.open(job / plan.GUEST_LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(log, 1)
    os.dup2(log, 2)
    todo = plan.read(job)
    try:
        run_plan(job, todo)
    except Exception as error:
        os.write(2, os.fsencode(f"guest: {type(error).__name__}: {error}\n"))
    os.sync()
    switch_off(todo["power_off"])


def run_plan(job: Path, todo: dict[str, Any]) -> None:
    mount("proc", "/proc", "proc")
    for module in todo["modules"]:
        load_module(module)
    root = build_root(job, todo)
    start_network(todo["can"])
    out, err = (os.open(job / name, os.O_WRONLY | os.O_APPEND) for name in plan.STREAMS)
    results = os.open(job, os.O_RDONLY | os.O_DIRECTORY)
    move_root(root)
    control = open_control(todo["control"])
    plan.write_result(results, plan.STARTED, "")
    os.umask(todo["umask"])
    code = supervise(Command(todo["argv"], todo["env"], todo["cwd"], out, err), control)
    os.umask(0o022)
    os.sync()  # what the command wrote through a shared mapping is still in the guest's page cache
    plan.write_result(results, plan.EXIT_CODE, str(code))


def mount(source: str, target: str, kind: str, options: str = "", flags: int = 0) -> None:
    """Mount, or raise OSError naming the target."""
    os.makedirs(target, exist_ok=True)
    arguments = (os.fsencode(text) for text in (source, target, kind))
    if LIBC.mount(*arguments, ctypes.c_ulong(flags), os.fsencode(options) if options else None):
        number = ctypes.get_errno()
        raise OSError(number, f"mount of {kind or 'bind'} {source}: {os.strerror(number)}", target)


def load_module(path: str) -> None:
    """Load a kernel module whose dependencies are loaded."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    if LIBC.syscall(FINIT_MODULE[platform.machine()], descriptor, b"", 0):
        number = ctypes.get_errno()
        raise OSError(number, f"insmod: {os.strerror(number)}", path)
    os.close(descriptor)


def build_root(job: Path, todo: dict[str, Any]) -> str:
    """Return the mount point of the copy-on-write root, furnished and with the host's own directories in place."""
    base = f"{job}/{plan.MOUNT_POINT}"
    host = todo["host_root"]
    mount("tmpfs", base, "tmpfs", "mode=755")
    for name in ("upper", "work", "root"):
        os.mkdir(f"{base}/{name}", 0o755)
    if todo["host_mount"]:
        mount(**todo["host_mount"], target=host)
    root = f"{base}/root"
    mount("root", root, "overlay", f"lowerdir=/,upperdir={base}/upper,workdir={base}/work")
    mount("proc", f"{root}/proc", "proc")
    mount("sysfs", f"{root}/sys", "sysfs")
    mount("devtmpfs", f"{root}/dev", "devtmpfs", "mode=755")
    mount("devpts", f"{root}/dev/pts", "devpts", "ptmxmode=666")
    mount("tmpfs", f"{root}/dev/shm", "tmpfs", "mode=1777")
    mount("tmpfs", f"{root}/run", "tmpfs", "mode=755")
    for name, target in (("fd", "/proc/self/fd"), ("stdin", "fd/0"), ("stdout", "fd/1"), ("stderr", "fd/2")):
        if not os.path.lexists(f"{root}/dev/{name}"):
            os.symlink(target, f"{root}/dev/{name}")
    for directory in todo["own_dirs"]:
        mount(host + directory, root + directory, "", flags=MS_BIND)
    return root


def move_root(root: str) -> None:
    """Make `root` the root of everything and drop the old one. Unlike chroot this leaves user namespaces possible."""
    os.chdir(root)
    if LIBC.syscall(PIVOT_ROOT[platform.machine()], b".", b".") or LIBC.umount2(b".", MNT_DETACH):
        number = ctypes.get_errno()
        raise OSError(number, f"pivot_root: {os.strerror(number)}", root)
    os.chdir("/")


def open_control(device: str) -> int:
    """Return the control line, without echo or line discipline."""
    control = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
    mode = termios.tcgetattr(control)
    mode[0], mode[1], mode[3] = 0, 0, 0
    mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
    termios.tcsetattr(control, termios.TCSANOW, mode)
    return control


def switch_off(key: str) -> None:
    """Halt by the magic SysRq key: `o` powers off, `b` restarts (which ends a virtual machine run with -no-reboot)."""
    try:
        with open("/proc/sysrq-trigger", "w") as trigger:
            trigger.write(key)
    finally:
        sys.exit(1)
