"""The cpio archive that a kernel unpacks as its first root.

Format "newc": kernel documentation, driver-api/early-userspace/buffer-format.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

TRAILER = "TRAILER!!!"


def pack_initramfs(files: Mapping[str, tuple[int, bytes]]) -> bytes:
    """Return the archive of the files, given as path: (mode with file type bits, content), parents before children."""
    entries: list[tuple[str, int, bytes]] = [(name, mode, data) for name, (mode, data) in files.items()]
    return b"".join(pack_entries([*entries, (TRAILER, 0, b"")]))


def pack_entries(entries: Iterable[tuple[str, int, bytes]]) -> Iterable[bytes]:
    for number, (name, mode, data) in enumerate(entries, start=1):
        path = name.encode() + b"\0"
        # inode, mode, uid, gid, links, mtime, size, device x 2, special device x 2, name length, checksum (unused)
        fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(path), 0)
        header = b"070701" + b"".join(b"%08X" % field for field in fields)
        yield pad(header + path)
        yield pad(data)


def pad(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
