"""The time-travel kernel: a small user-mode Linux with CAN built in, made once from Debian's kernel source."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tools.vcan import packages
from tools.vcan.cache import cache_dir, locked, make_cache_dir, say
from tools.vcan.errors import VcanError

SOURCE_PACKAGE = "linux-source-6.1"
CONFIG = Path(__file__).with_name("time_travel.config")
UNPACKED_TOOLS = {"flex": "flex", "bison": "bison", "m4": "m4", "bc": "bc", "xz": "xz-utils"}
INSTALLED_TOOLS = {"gcc": "gcc libc6-dev", "make": "make", "ld": "binutils", "tar": "tar"}
SCRATCH_GB = 2.0
COST = "139 MB of kernel source to download, 2 GB of scratch space, about 5 minutes of processor time; once"


def kernel_path() -> Path:
    return cache_dir() / "kernel" / f"linux-time-travel-{config_digest()}"


def config_digest() -> str:
    """Return what tells kernels of different configurations apart."""
    return hashlib.sha256(CONFIG.read_bytes()).hexdigest()[:12]


def find_kernel() -> Path | None:
    """Return the built time-travel kernel of this version of the configuration, or None."""
    path = kernel_path()
    return path if os.access(path, os.X_OK) else None


def describe_kernel() -> dict[str, object]:
    """Return the state of the time-travel kernel as plain values: built, path, and what it was built from."""
    path = find_kernel()
    record: dict[str, object] = {"built": path is not None, "path": str(kernel_path()), "cost": COST}
    if path is not None:
        record["size_mb"] = round(path.stat().st_size / 1e6, 1)
        note = path.with_suffix(".json")
        if note.is_file():
            record.update(json.loads(note.read_text()))
    return record


def build_kernel(jobs: int = 0, keep_log: Path | None = None) -> Path:
    """Return the kernel, built if it is not there. One builder at a time; others wait and find it. Raises VcanError."""
    make_cache_dir("kernel")
    with locked("kernel-build"):
        if (path := find_kernel()) is not None:
            say(f"the time-travel kernel is there: {path}")
            return path
        say(f"building the time-travel kernel: {COST}")
        packages.require_debian_like()
        packages.install_tools(INSTALLED_TOOLS)
        free_gb = shutil.disk_usage(make_cache_dir("tmp")).free / 1e9
        if free_gb < SCRATCH_GB:
            raise VcanError(
                f"{cache_dir()} has {free_gb:.1f} GB free, the build needs {SCRATCH_GB} GB; set HILSAT_CACHE"
            )
        start = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="kernel-", dir=make_cache_dir("tmp")) as work:
            log = keep_log or Path(work) / "build.log"
            version = compile_kernel(Path(work), log, jobs or os.cpu_count() or 1, kernel_path())
        note = {"source": version, "config": config_digest(), "build_s": round(time.monotonic() - start)}
        kernel_path().with_suffix(".json").write_text(json.dumps(note) + "\n")
        say(f"built {kernel_path()} in {note['build_s']} s from {version}")
        return kernel_path()


def compile_kernel(work: Path, log: Path, jobs: int, target: Path) -> str:
    """Configure and compile in `work`, put the stripped kernel at `target`, return the source's file name."""
    env = build_environment()
    source_tree = packages.unpack(SOURCE_PACKAGE)[0]
    version: str = json.loads((source_tree / packages.RECORD).read_text())["file"]
    archive = next(source_tree.glob("usr/src/linux-source-*.tar.xz"))

    def step(what: str, command: Sequence[str], cwd: Path) -> None:
        say(what)
        with log.open("ab") as sink:
            result = subprocess.run(
                command, cwd=cwd, env=env, stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, check=False
            )
        if result.returncode:
            tail = "\n".join(log.read_text(errors="replace").splitlines()[-15:])
            raise VcanError(
                f"kernel build: {' '.join(command)} ended with {result.returncode}; the last lines were:\n{tail}"
            )

    step("unpacking the source", ["tar", "--extract", "--xz", "--file", str(archive)], work)
    tree = next(work.glob("linux-source-*/"))
    configure(tree, step)
    step(f"compiling with {jobs} jobs", ["make", "-s", "ARCH=um", f"-j{jobs}", "linux"], tree)
    part = target.with_name(target.name + ".part")
    step("stripping", ["strip", "-o", str(part), "linux"], tree)
    part.rename(target)
    shutil.rmtree(source_tree)  # 140 MB that only another build would need
    return version


def configure(tree: Path, step: Callable[[str, Sequence[str], Path], None]) -> None:
    """Write .config in the source tree. Raises VcanError when an option of ours does not survive the kernel's rules."""
    step("configuring", ["make", "-s", "ARCH=um", "tinyconfig"], tree)
    step("merging our options", ["sh", "scripts/kconfig/merge_config.sh", "-m", ".config", str(CONFIG)], tree)
    step("resolving options", ["make", "-s", "ARCH=um", "olddefconfig"], tree)
    lost = read_options(CONFIG.read_text()) - read_options((tree / ".config").read_text())
    if lost:
        raise VcanError(f"kernel build: these options of {CONFIG.name} did not take effect: {', '.join(sorted(lost))}")


def read_options(text: str) -> set[str]:
    """Return the CONFIG_X=value lines of a kernel configuration."""
    return {line.strip() for line in text.splitlines() if line.startswith("CONFIG_")}


def build_environment() -> dict[str, str]:
    """Return an environment in which the build's programs are found, fetched if the host lacks them."""
    missing = {tool: package for tool, package in UNPACKED_TOOLS.items() if packages.find_program(tool) is None}
    env = {
        key: value for key, value in os.environ.items() if key not in ("ARCH", "CROSS_COMPILE", "MAKEFLAGS", "CFLAGS")
    }
    env["LC_ALL"] = "C"
    if not missing:
        return env
    wanted = list(dict.fromkeys(missing.values()))
    roots = dict(zip(wanted, packages.unpack(*wanted), strict=True))
    directories = [str(root / "usr/bin") for root in roots.values()]
    env["PATH"] = os.pathsep.join([*directories, env.get("PATH", os.defpath)])
    if "bison" in roots:
        env["BISON_PKGDATADIR"] = str(roots["bison"] / "usr/share/bison")
    if "m4" in roots:
        env["M4"] = str(roots["m4"] / "usr/bin/m4")
    return env
