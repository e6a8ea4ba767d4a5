"""The last resort: Debian's stock kernel under QEMU, on the host's files over 9p. Slow unless KVM works."""

from __future__ import annotations

import os
import platform
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

from tools.vcan import packages, plan
from tools.vcan.cache import cache_dir, say
from tools.vcan.errors import PackageError, VcanError
from tools.vcan.initramfs import pack_initramfs
from tools.vcan.machine import Machine, Request, in_process_namespace, write_job
from tools.vcan.modules import find_modules, order_modules

QEMU = "qemu-system-x86_64"
META_PACKAGE = "linux-image-amd64"
BUSYBOX_PACKAGE = "busybox-static"
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay")
CAN_MODULES = ("can", "can-raw", "can-bcm", "can-gw", "can-isotp", "can-dev", "vcan", "vxcan")
NINE_P = "trans=virtio,version=9p2000.L,msize=262144"
BOOT_LIMIT_S = 240.0


def find_obstacle() -> str | None:
    """Return why QEMU cannot run a guest on this host and what to do, None when nothing speaks against it."""
    if platform.machine() != "x86_64":
        return f"the guest is an x86-64 kernel, this host is {platform.machine()}"
    if packages.find_program(QEMU) is None and (os.geteuid() != 0 or shutil.which("apt-get") is None):
        return f"{QEMU} is not on this host; on Debian: sudo apt-get install -y --no-install-recommends qemu-system-x86"
    if find_image() is None or packages.find_unpacked(BUSYBOX_PACKAGE) is None:
        try:
            packages.require_debian_like()
        except PackageError as error:
            return str(error)
    return None


def has_kvm() -> bool:
    """Return whether KVM can be used. The processor must say so too: /dev/kvm alone may be a paravirtualised one."""
    try:
        flags = Path("/proc/cpuinfo").read_text()
    except OSError:
        return False
    return (
        os.access("/dev/kvm", os.R_OK | os.W_OK)
        and re.search(r"^flags\b.*\b(vmx|svm)\b", flags, re.MULTILINE) is not None
    )


def prepare(job: Path, request: Request) -> Machine:
    """Return the virtual machine as a process to start; fetches what is missing. Raises VcanError."""
    if request.virtual_time:
        raise VcanError("--virtual-time needs user-mode Linux, not QEMU")
    if reason := find_obstacle():
        raise VcanError(f"qemu: {reason}")
    kvm = has_kvm()
    if not kvm:
        say("warning: QEMU without KVM: Python runs 15 to 35 times slower and a CAN round trip takes 250 us")
    packages.install_tools({QEMU: "qemu-system-x86"})
    image = find_image()
    if image is None:
        (image,) = packages.unpack(packages.depend_on(META_PACKAGE, r"linux-image-\d\S+"))
    (busybox,) = packages.unpack(BUSYBOX_PACKAGE)
    modules = order_modules(find_modules(image), (*MODULES, *CAN_MODULES))
    todo: dict[str, Any] = {
        "modules": [],
        "host_root": f"{job}/{plan.MOUNT_POINT}/host",
        "host_mount": {"source": "host", "kind": "9p", "options": f"{NINE_P},cache=mmap"},
        "control": "/dev/ttyS1",
        "power_off": "b",
    }
    write_job(job, request, todo, "guest")
    initramfs = job / "initramfs"
    initramfs.write_bytes(pack_initramfs(start_files(job, busybox, modules)))
    kernel = next(image.glob("boot/vmlinuz-*"))
    argv = [
        *in_process_namespace(),
        *machine_arguments(job, request, kvm),
        "-kernel",
        str(kernel),
        "-initrd",
        str(initramfs),
    ]
    return Machine("QEMU", argv, dict(os.environ), boot_limit_s=BOOT_LIMIT_S)


def find_image() -> Path | None:
    """Return the newest Debian kernel package that is unpacked in the cache, or None."""
    found = sorted((cache_dir() / "packages").glob(f"linux-image-[0-9]*/{packages.RECORD}"))
    return found[-1].parent if found else None


def machine_arguments(job: Path, request: Request, kvm: bool) -> list[str]:
    """Return QEMU's command line up to the kernel: console in a file, control line on stdin, three 9p shares."""
    speed = ["-accel", "kvm", "-cpu", "host"] if kvm else ["-accel", "tcg", "-cpu", "Nehalem"]
    # one processor: without KVM a second one costs more than it brings
    size = ["-smp", str(os.cpu_count() or 1) if kvm else "1", "-m", f"{request.memory_mb}M"]
    console = ["-chardev", f"file,id=console,path={job}/{plan.CONSOLE_LOG},append=on", "-serial", "chardev:console"]
    control = ["-chardev", "stdio,id=control,signal=off", "-serial", "chardev:control"]
    shares = [*share("root", "/", ",readonly=on"), *share("host", "/"), *share("job", str(job))]
    words = "console=ttyS0 quiet panic=-1 mitigations=off nokaslr no_timer_check tsc=reliable audit=0"
    fixed = ["-M", "q35", "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-append", words]
    return [packages.find_program(QEMU) or QEMU, *fixed, *speed, *size, *console, *control, *shares]


def share(tag: str, path: str, more: str = "") -> list[str]:
    return ["-virtfs", f"local,path={path},mount_tag={tag},security_model=none,multidevs=remap{more}"]


def start_files(job: Path, busybox: Path, modules: list[str]) -> dict[str, tuple[int, bytes]]:
    """Return the initramfs by path: mode, content. It loads the modules, mounts the shares, hands over to the job."""
    names = [Path(path).name for path in modules]
    script = f"""#!/bin/busybox sh
/bin/busybox mount -t proc proc /proc
for m in {shlex.join(names)}; do /bin/busybox insmod /modules/$m; done
/bin/busybox mount -t 9p -o ro,{NINE_P},cache=loose root /root
/bin/busybox mount -t 9p -o {NINE_P},cache=none job /root{shlex.quote(str(job))}
exec /bin/busybox switch_root /root {shlex.quote(str(job))}/init
"""
    files = dict.fromkeys(("bin", "modules", "root", "proc", "dev"), (0o040755, b""))
    files["bin/busybox"] = (0o100755, next(busybox.glob("**/bin/busybox")).read_bytes())
    files["init"] = (0o100755, script.encode())
    for path, name in zip(modules, names, strict=True):
        files[f"modules/{name}"] = (0o100644, Path(path).read_bytes())
    return files
