"""The key that signs a link: 32 bytes or a passphrase, in a file that nobody else can read."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path
from typing import Final

from bus.errors import UsageError

KEY_SIZE: Final = 32
LARGEST: Final = 4096  # bytes of a key file


def read_key(path: Path) -> bytes:
    """Return the key of a file: 32 bytes as they are, or the SHA-256 of a text, as MAVProxy makes it of a passphrase.

    The line's end is no part of a passphrase. Raises UsageError for a file that others can read, and for no key.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with open(fd, "rb") as file:
            about = os.fstat(fd)
            if not stat.S_ISREG(about.st_mode):
                raise UsageError(f"{path}: is not a file; the key is 32 bytes or a passphrase in a file of its own")
            if about.st_mode & 0o177:
                mode = stat.S_IMODE(about.st_mode)
                raise UsageError(f"{path}: mode {mode:04o}: others may read this key; do: chmod 0600 {path}")
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise UsageError(f"{path}: cannot read the key: {error.strerror or error}") from None
    return make_key(data, str(path))


def make_key(data: bytes, name: str) -> bytes:
    """Return the key that the content of a file stands for. Raises UsageError for none."""
    text = data.rstrip(b"\r\n")
    try:
        is_text = text.decode("utf-8").isprintable()
    except UnicodeDecodeError:
        is_text = False
    if len(data) == KEY_SIZE and not is_text:
        return data
    if not is_text or not text or len(data) > LARGEST:
        raise UsageError(
            f"{name}: {len(data)} bytes are no key; give {KEY_SIZE} random bytes (head -c 32 /dev/urandom > FILE) or a line "
            "of text"
        )
    return hashlib.sha256(text).digest()
