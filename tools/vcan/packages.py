"""Debian packages fetched and unpacked in the cache, without installing anything and without root.

apt does the checking: it downloads only what its signed package lists name, and compares sizes and hashes.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tools.vcan.cache import cache_dir, locked, make_cache_dir, say
from tools.vcan.errors import PackageError

RECORD = ".hilsat-package.json"
URI_LINE = re.compile(r"^'(?P<url>[^']+)' (?P<file>\S+) (?P<bytes>\d+) (?P<digest>\S*)$", re.MULTILINE)
APT_QUIET = ("-qq", "-o", "APT::Sandbox::User=root", "-o", "Acquire::Retries=3")


@dataclass(frozen=True, slots=True)
class PackageFile:
    """One .deb as apt's signed lists describe it."""

    package: str
    file: str
    url: str
    size_bytes: int
    digest: str


def require_debian_like() -> None:
    """Raise PackageError, with what to do instead, on a host without apt-get and dpkg-deb."""
    missing = [tool for tool in ("apt-get", "dpkg-deb") if shutil.which(tool) is None]
    if missing:
        raise PackageError(
            f"Debian packages are needed, and this host ({host_name()}) has no {' or '.join(missing)}: it is not "
            "Debian-like. Use a host whose kernel has CAN (`hilsat vcan status` says what is missing), run inside a "
            f"Debian 12 container, or copy a filled cache from a Debian machine to {cache_dir()}"
        )


def host_name() -> str:
    """Return the distribution's own name for itself."""
    try:
        text = Path("/etc/os-release").read_text()
    except OSError:
        return "unknown distribution"
    found = re.search(r'^PRETTY_NAME="?([^"\n]+)', text, re.MULTILINE)
    return found[1] if found else "unknown distribution"


def find_unpacked(package: str) -> Path | None:
    """Return the directory where the package is unpacked already, or None."""
    path = cache_dir() / "packages" / package
    return path if (path / RECORD).is_file() else None


def unpack(*packages: str) -> list[Path]:
    """Return the directories that hold the packages' files, fetched and unpacked if need be. Raises PackageError."""
    if any(find_unpacked(name) is None for name in packages):
        require_debian_like()
        with locked("packages"):
            fetch([name for name in packages if find_unpacked(name) is None])
    return [cache_dir() / "packages" / name for name in packages]


def fetch(packages: Sequence[str]) -> None:
    """Name the packages with their sizes, download and unpack them. Raises PackageError."""
    if not packages:
        return
    lists = ListsOption()
    files = describe(packages, lists)
    for file in files:
        say(
            f"fetching {file.package}: {file.size_bytes / 1e6:.1f} MB from {file.url} "
            f"into {cache_dir()} (nothing is installed)"
        )
    make_cache_dir("packages")
    with tempfile.TemporaryDirectory(dir=make_cache_dir("tmp")) as work:
        result = run_apt(["download", *packages], lists, cwd=work)
        if result.returncode and not lists.private:
            lists.refresh()
            files = describe(packages, lists)
            result = run_apt(["download", *packages], lists, cwd=work)
        if result.returncode:
            raise PackageError(f"apt-get download {' '.join(packages)} failed: {last_line(result.stderr)}")
        for file in files:
            unpack_file(Path(work), file)


def unpack_file(work: Path, file: PackageFile) -> None:
    """Unpack one downloaded .deb beside the cache's packages and move it into its place."""
    archive = work / file.file
    if not archive.is_file() or archive.stat().st_size != file.size_bytes:
        raise PackageError(f"{file.package}: {archive.name} is not the {file.size_bytes} bytes that apt announced")
    place = work / file.package
    result = subprocess.run(["dpkg-deb", "-x", archive, place], capture_output=True, text=True, check=False)
    if result.returncode:
        raise PackageError(f"{file.package}: dpkg-deb cannot unpack {archive.name}: {last_line(result.stderr)}")
    (place / RECORD).write_text(json.dumps(asdict(file), indent=1) + "\n")
    target = cache_dir() / "packages" / file.package
    shutil.rmtree(target, ignore_errors=True)
    place.rename(target)
    archive.unlink()


class ListsOption:
    """apt's package lists: the system's, or once refreshed private ones in the cache (no root, the host untouched)."""

    def __init__(self) -> None:
        self.private = False
        self.options: list[str] = []

    def refresh(self) -> None:
        """Download the package lists that the host's sources name, into the cache. Raises PackageError."""
        base = make_cache_dir("apt")
        (base / "lists" / "partial").mkdir(parents=True, exist_ok=True)
        (base / "cache" / "archives" / "partial").mkdir(parents=True, exist_ok=True)
        self.private = True
        self.options = ["-o", f"Dir::State::Lists={base}/lists", "-o", f"Dir::Cache={base}/cache"]
        say(f"fetching the package lists of this host's apt sources (about 10 MB, into {base})")
        result = run_apt(["update"], self)
        if result.returncode:
            raise PackageError(f"apt-get update failed: {last_line(result.stderr)}; is this machine on line?")


def describe(packages: Sequence[str], lists: ListsOption) -> list[PackageFile]:
    """Return what apt would download, in the order asked for. Raises PackageError when a package is not known."""
    found = parse_uris(run_apt(["download", "--print-uris", *packages], lists).stdout)
    if len(found) < len(set(packages)) and not lists.private:
        lists.refresh()
        found = parse_uris(run_apt(["download", "--print-uris", *packages], lists).stdout)
    unknown = [name for name in packages if name not in found]
    if unknown:
        raise PackageError(
            f"the apt sources of this host ({host_name()}) have no {', '.join(unknown)}; Debian 12 (bookworm) has: "
            "run in a debian:12 container, or add that release to the sources"
        )
    return [found[name] for name in packages]


def parse_uris(text: str) -> dict[str, PackageFile]:
    """Return apt's `--print-uris` lines by package name."""
    files = {}
    for line in URI_LINE.finditer(text):
        package = line["file"].split("_", 1)[0]
        files[package] = PackageFile(package, line["file"], line["url"], int(line["bytes"]), line["digest"])
    return files


def depend_on(package: str, pattern: str) -> str:
    """Return the first dependency of a package that matches the pattern. Raises PackageError."""
    lists = ListsOption()
    for attempt in range(2):
        result = run_tool(["apt-cache", *lists.options, "depends", package])
        if found := re.search(rf"Depends: ({pattern})\s", result.stdout):
            return found[1]
        if attempt == 0:
            lists.refresh()
    raise PackageError(f"the apt sources of this host ({host_name()}) know no {package} that depends on {pattern}")


def install_tools(tools: dict[str, str]) -> None:
    """See to it that the programs are there; `tools` maps each to its Debian packages.

    As root on a Debian-like host they are installed, after saying so; otherwise PackageError has the line to run.
    """
    missing = {tool: names for tool, names in tools.items() if find_program(tool) is None}
    if not missing:
        return
    names = sorted({name for text in missing.values() for name in text.split()})
    line = f"apt-get install -y --no-install-recommends {' '.join(names)}"
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        prefix = "" if os.geteuid() == 0 else "sudo "
        raise PackageError(f"{', '.join(sorted(missing))}: not on this host; on Debian: {prefix}{line}")
    say(f"{', '.join(sorted(missing))}: not on this host; as root now running: {line}")
    run_tool(["apt-get", "-qq", "update"])
    result = run_tool(["apt-get", "-qq", *line.split()[1:]], DEBIAN_FRONTEND="noninteractive")
    if result.returncode:
        raise PackageError(f"{line} failed: {last_line(result.stderr)}")


def find_program(name: str) -> str | None:
    """Return the path of a program, also when it is an administrator's and the user's PATH leaves it out."""
    return shutil.which(
        name, path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/local/sbin", "/usr/sbin", "/sbin"])
    )


def run_apt(arguments: Sequence[str], lists: ListsOption, cwd: str | None = None) -> subprocess.CompletedProcess[str]:
    return run_tool(["apt-get", *APT_QUIET, *lists.options, *arguments], cwd=cwd)


def run_tool(command: Sequence[str], cwd: str | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "LC_ALL": "C", **environment}
    return subprocess.run(
        command,
        cwd=cwd,
        env=env,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )


def last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("W:")]
    return lines[-1].strip() if lines else "no message"
