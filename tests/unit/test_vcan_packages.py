"""Debian packages: what apt says is read right, and a host that cannot have them is told so."""

from __future__ import annotations

import fcntl
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tools.vcan import cache, kernel, packages
from tools.vcan.errors import PackageError, VcanError

APT_OUTPUT = """\
Reading package lists...
'http://deb.debian.org/debian/pool/main/b/bison/bison_3.8.2%2bdfsg-1_amd64.deb' bison_2%3a3.8.2+dfsg-1_amd64.deb 1174528 SHA256:a414
'http://deb.debian.org/debian/pool/main/u/user-mode-linux/user-mode-linux_6.1um4_amd64.deb' user-mode-linux_6.1um4_amd64.deb 41388548 SHA256:0ce7
"""  # noqa: E501


def test_apt_uris_are_read_with_name_size_and_digest() -> None:
    """Lines as apt 2.6 prints them, an epoch and an escaped plus in the file name included."""
    files = packages.parse_uris(APT_OUTPUT)
    assert set(files) == {"bison", "user-mode-linux"}
    assert files["bison"].file == "bison_2%3a3.8.2+dfsg-1_amd64.deb"
    assert files["user-mode-linux"].size_bytes == 41_388_548
    assert files["user-mode-linux"].digest == "SHA256:0ce7"


def test_a_host_that_is_not_debian_like_is_told_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No apt-get, no dpkg-deb: the message names them, the host, and the ways out; nothing is fetched."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("HILSAT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(packages, "host_name", lambda: "Fedora Linux 43")
    with pytest.raises(PackageError) as caught:
        packages.unpack("user-mode-linux")
    for words in (
        "apt-get",
        "dpkg-deb",
        "Fedora Linux 43",
        "not Debian-like",
        "hilsat vcan status",
        "Debian 12 container",
    ):
        assert words in str(caught.value)
    assert not (tmp_path / "cache").exists()


def test_missing_programs_are_named_with_the_line_to_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without root nothing is installed; the user gets one line to copy."""
    monkeypatch.setattr(packages.os, "geteuid", lambda: 1000)
    with pytest.raises(PackageError) as caught:
        packages.install_tools({"sh": "dash", "no-such-program": "its-package other-package"})
    line = "sudo apt-get install -y --no-install-recommends its-package other-package"
    assert line in str(caught.value)
    assert "no-such-program" in str(caught.value)
    assert "dash" not in str(caught.value)


def test_a_truncated_download_is_refused(tmp_path: Path) -> None:
    """The size that apt announced is checked again before unpacking."""
    (tmp_path / "x_1_all.deb").write_bytes(b"short")
    with pytest.raises(PackageError, match="not the 6 bytes"):
        packages.unpack_file(tmp_path, packages.PackageFile("x", "x_1_all.deb", "http://h/x", 6, ""))


def test_a_real_package_is_unpacked_into_the_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """dpkg-deb builds the package, so the test does not lean on our own idea of the format."""
    if packages.find_program("dpkg-deb") is None:
        pytest.skip("this host has no dpkg-deb")
    monkeypatch.setenv("HILSAT_CACHE", str(tmp_path / "cache"))
    tree = tmp_path / "tree"
    (tree / "DEBIAN").mkdir(parents=True)
    (tree / "usr/share").mkdir(parents=True)
    (tree / "usr/share/hello").write_text("hello\n")
    (tree / "DEBIAN/control").write_text(
        "Package: hello-hilsat\nVersion: 1\nArchitecture: all\nMaintainer: A <a@example.org>\nDescription: test\n"
    )
    work = tmp_path / "cache/tmp/work"
    work.mkdir(parents=True)
    (tmp_path / "cache/packages").mkdir()
    archive = work / "hello-hilsat_1_all.deb"
    subprocess.run(["dpkg-deb", "--build", tree, archive], check=True, capture_output=True)
    file = packages.PackageFile("hello-hilsat", archive.name, "file:x", archive.stat().st_size, "")
    assert packages.find_unpacked("hello-hilsat") is None
    packages.unpack_file(work, file)
    place = packages.find_unpacked("hello-hilsat")
    assert place is not None
    assert (place / "usr/share/hello").read_text() == "hello\n"
    assert packages.unpack("hello-hilsat") == [place]


def test_the_cache_is_where_the_user_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """HILSAT_CACHE, then XDG_CACHE_HOME (absolute only, as its specification demands), then ~/.cache."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("HILSAT_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache.cache_dir() == tmp_path / ".cache/hilsat"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache.cache_dir() == tmp_path / "xdg/hilsat"
    monkeypatch.setenv("HILSAT_CACHE", str(tmp_path / "own"))
    assert cache.cache_dir() == tmp_path / "own"


def test_an_unwritable_cache_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A file where the directory should be fails for root too."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HILSAT_CACHE", str(tmp_path / "file"))
    with pytest.raises(VcanError, match="HILSAT_CACHE"):
        cache.make_cache_dir("packages")


def test_a_second_process_waits_for_the_lock(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two builders at once: the second one enters only after the first one has left."""
    monkeypatch.setenv("HILSAT_CACHE", str(tmp_path))
    code = "from tools.vcan.cache import locked\nwith locked('kernel-build'): print('in', flush=True)"
    root = str(Path(cache.__file__).resolve().parents[2])
    with cache.locked("kernel-build"):
        other = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={"PYTHONPATH": root, "HILSAT_CACHE": str(tmp_path)},
        )
        assert other.stderr is not None
        assert "kernel-build" in other.stderr.readline()  # it says whom it waits for
        time.sleep(0.1)
        assert other.poll() is None
    out, _ = other.communicate(timeout=20)
    assert out == "in\n"
    with (tmp_path / "locks/kernel-build").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # free again


def test_our_kernel_options_are_plain_and_unrepeated() -> None:
    """A doubled or misspelt line would be overridden in silence by the kernel's merge script."""
    lines = [line for line in kernel.CONFIG.read_text().splitlines() if line and not line.startswith("#")]
    assert all(line.startswith("CONFIG_") and line.endswith("=y") for line in lines)
    assert len(lines) == len(set(lines)) == len(kernel.read_options(kernel.CONFIG.read_text()))
    assert {"CONFIG_UML_TIME_TRAVEL_SUPPORT=y", "CONFIG_CAN_RAW=y", "CONFIG_CAN_VCAN=y"} <= set(lines)


def test_a_built_kernel_is_not_built_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The second builder finds the first one's kernel and needs neither apt nor compiler."""
    monkeypatch.setenv("HILSAT_CACHE", str(tmp_path))
    assert kernel.find_kernel() is None
    assert kernel.describe_kernel()["built"] is False
    kernel.kernel_path().parent.mkdir()
    kernel.kernel_path().write_bytes(b"\x7fELF")
    kernel.kernel_path().chmod(0o755)
    monkeypatch.setenv("PATH", "")
    assert kernel.build_kernel() == kernel.kernel_path()
