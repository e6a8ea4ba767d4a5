"""What crosses from the host into a guest: kernel messages, modules, the first root, the plan, the start script."""

from __future__ import annotations

import os
import socket
import stat
import struct
import subprocess
from pathlib import Path

import pytest

from bus.wire import rtnetlink
from tools.vcan import initramfs, machine, modules, plan, qemu, uml
from tools.vcan.errors import VcanError


def test_links_agree_with_sysfs() -> None:
    """The kernel's own other view of the same interfaces: /sys/class/net and if_nameindex()."""
    links = rtnetlink.list_links()
    assert [(link.index, link.name) for link in links] == sorted(socket.if_nameindex())
    for link in links:
        base = Path("/sys/class/net", link.name)
        if not base.is_dir():  # sysfs of another network namespace
            continue
        assert link.mtu == int((base / "mtu").read_text())
        assert link.is_up == bool(int((base / "flags").read_text(), 16) & 1)
        assert link.is_can == ((base / "type").read_text().strip() == "280")


def test_the_kernel_refuses_what_it_should_and_says_why() -> None:
    """An error answer becomes an OSError with the kernel's number; here for a name too long for any interface."""
    with pytest.raises(OSError, match=r".+") as caught:
        rtnetlink.add_vcan("a-name-that-is-too-long")
    assert caught.value.errno in (1, 22, 34)  # EPERM without rights, EINVAL or ERANGE with them


def test_attributes_have_the_layout_of_rtnetlink() -> None:
    """rtnetlink(7): u16 length with header, u16 type, value, padding to four bytes that the length leaves out."""
    packed = rtnetlink.pack_attribute(3, b"vcan0\0")
    assert packed == struct.pack("=HH", 10, 3) + b"vcan0\0" + b"\0\0"
    assert list(rtnetlink.split_attributes(packed + rtnetlink.pack_attribute(0x8012, b"x"))) == [
        (3, b"vcan0\0"),
        (18, b"x"),
    ]


def write_module(path: Path, depends: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"\x7fELF....license=GPL\0depends=" + depends.encode() + b"\0name=" + path.stem.encode() + b"\0")


def test_modules_load_after_what_they_need(tmp_path: Path) -> None:
    """Dependencies of dependencies first, each once; `-` and `_` are one; built-in ones are left out."""
    write_module(tmp_path / "net/can-raw.ko", "can")
    write_module(tmp_path / "net/can.ko", "")
    write_module(tmp_path / "net/can-gw.ko", "can")
    write_module(tmp_path / "fs/9p.ko", "9pnet,netfs")
    write_module(tmp_path / "fs/9pnet.ko", "")
    write_module(tmp_path / "fs/9pnet_virtio.ko", "9pnet,virtio_ring")
    found = modules.find_modules(tmp_path)
    order = [
        Path(path).stem for path in modules.order_modules(found, ["can_raw", "can-gw", "9p", "9pnet_virtio", "vcan"])
    ]
    assert order == ["can", "can-raw", "can-gw", "9pnet", "9p", "9pnet_virtio"]


def test_the_first_root_is_a_newc_archive(tmp_path: Path) -> None:
    """Read back field by field as the kernel's buffer-format document lays it down."""
    files = {"bin": (0o040755, b""), "bin/sh": (0o100755, b"#!abc"), "init": (0o100755, b"12345678")}
    data = initramfs.pack_initramfs(files)
    entries = []
    while data:
        assert data[:6] == b"070701"
        field = [int(data[6 + 8 * i : 14 + 8 * i], 16) for i in range(13)]
        mode, size, name_size = field[1], field[6], field[11]
        name = data[110 : 110 + name_size - 1].decode()
        start = (110 + name_size + 3) & ~3
        entries.append((name, mode, data[start : start + size]))
        data = data[(start + size + 3) & ~3 :]
    assert entries == [*((name, mode, body) for name, (mode, body) in files.items()), ("TRAILER!!!", 0, b"")]


def test_a_plan_survives_bytes_that_are_no_text(tmp_path: Path) -> None:
    """Environment and file names are bytes on Linux; nothing may be lost or refused on the way in."""
    odd = os.fsdecode(b"\xff\xfe/caf\xc3\xa9 \n'\"$")
    plan.write(tmp_path, {"env": {"ODD": odd}, "argv": [odd]})
    assert plan.read(tmp_path) == {"env": {"ODD": odd}, "argv": [odd]}


def test_a_result_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    """The host polls for the exit code; it must never see a half-written one."""
    assert plan.read_result(tmp_path, plan.EXIT_CODE) is None
    descriptor = os.open(tmp_path, os.O_RDONLY)
    plan.write_result(descriptor, plan.EXIT_CODE, "42")
    os.close(descriptor)
    assert plan.read_result(tmp_path, plan.EXIT_CODE) == "42"
    assert [path.name for path in tmp_path.iterdir()] == [plan.EXIT_CODE]


def test_the_command_gets_the_environment_and_is_told_that_can_is_required(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests inside must fail, not skip, without CAN; in virtual time hashes must not differ from run to run."""
    monkeypatch.setenv("SOME_VARIABLE", "kept")
    monkeypatch.delenv("PYTHONHASHSEED", raising=False)
    env = machine.command_environment(machine.Request(("true",)))
    assert env["SOME_VARIABLE"] == "kept"
    assert env["HILSAT_REQUIRE_VCAN"] == "1"
    assert "PYTHONHASHSEED" not in env
    virtual = machine.command_environment(machine.Request(("true",), virtual_time=True))
    assert virtual["PYTHONHASHSEED"] == "0"
    assert virtual["HILSAT_VIRTUAL_TIME"] == "1"
    monkeypatch.setenv("PYTHONHASHSEED", "7")
    assert machine.command_environment(machine.Request(("true",), virtual_time=True))["PYTHONHASHSEED"] == "7"


def test_own_directories_are_real_paths_outer_first_and_never_the_root(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A bind mount of an inner directory must come after that of the outer one; `/` stays copy-on-write."""
    inner = tmp_path / "a b" / "inner"
    inner.mkdir(parents=True)
    (tmp_path / "link").symlink_to(inner)
    monkeypatch.chdir(tmp_path)
    found = machine.own_directories(machine.Request(("true",), own_dirs=(str(tmp_path / "link"), str(tmp_path))))
    assert found == [str(tmp_path.resolve()), str(inner.resolve())]
    monkeypatch.chdir("/")
    assert machine.own_directories(machine.Request(("true",))) == []


def test_the_start_script_is_shell_and_private_to_its_job(tmp_path: Path) -> None:
    """A shell reads it without complaint; everything else about the command is in the plan, not on a command line."""
    request = machine.Request(("prog", "it's; rm -rf /"))
    machine.write_job(tmp_path, request, {"modules": []}, "guest")
    script = tmp_path / "init"
    assert subprocess.run(["sh", "-n", script]).returncode == 0
    assert script.stat().st_mode & stat.S_IXUSR
    assert "rm -rf" not in script.read_text()
    assert plan.read(tmp_path)["argv"] == ["prog", "it's; rm -rf /"]


def test_the_guest_kernel_is_told_of_virtual_time_only_when_asked(tmp_path: Path) -> None:
    """Real time must not run on a warped clock, and a repeatable run must not have random addresses."""
    plain = uml.kernel_arguments(tmp_path, machine.Request(("true",), memory_mb=512))
    virtual = uml.kernel_arguments(tmp_path, machine.Request(("true",), virtual_time=True))
    assert "mem=512M" in plain
    assert not any(word.startswith("time-travel") for word in plain)
    assert "time-travel=inf-cpu" in virtual
    assert "norandmaps" in virtual


def test_guest_memory_needs_room_that_may_be_mapped_as_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every place looked at is named with the reason against it (Docker's 64 MB /dev/shm is the usual one)."""
    tiny = os.statvfs_result((4096, 4096, 100, 100, 16384, 0, 0, 0, 0, 255))
    monkeypatch.setattr(uml.os, "statvfs", lambda path: tiny)
    with pytest.raises(VcanError, match=r"/dev/shm has 64 MB free.*--mem"):
        uml.memory_dir(2048)
    noexec = os.statvfs_result((4096, 4096, 1 << 30, 1 << 30, 1 << 30, 0, 0, 0, os.ST_NOEXEC, 255))
    monkeypatch.setattr(uml.os, "statvfs", lambda path: noexec)
    with pytest.raises(VcanError, match="/dev/shm is mounted noexec"):
        uml.memory_dir(2048)


def test_a_host_that_forbids_tracing_is_told_the_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    """yama's ptrace_scope 3 forbids it to everyone, 2 to all but root."""
    monkeypatch.setattr(uml.Path, "read_text", lambda self: "2\n")
    monkeypatch.setattr(uml.os, "geteuid", lambda: 1000)
    assert "kernel.yama.ptrace_scope = 2" in (uml.ptrace_obstacle() or "")
    monkeypatch.setattr(uml.os, "geteuid", lambda: 0)
    assert uml.ptrace_obstacle() is None


def test_qemu_without_kvm_runs_one_emulated_processor(tmp_path: Path) -> None:
    """/dev/kvm alone is no proof of KVM, and a second emulated processor makes things slower."""
    slow = qemu.machine_arguments(tmp_path, machine.Request(("true",), memory_mb=512), kvm=False)
    assert slow[slow.index("-accel") + 1] == "tcg"
    assert slow[slow.index("-smp") + 1] == "1"
    assert sum(word == "-virtfs" for word in slow) == 3
    assert "512M" in slow
