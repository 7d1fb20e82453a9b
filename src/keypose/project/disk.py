"""The few operations on files that projects are kept safe with, so that tests can stop them at any point."""

from __future__ import annotations

import contextlib
import glob
import os
import secrets
import time
from pathlib import Path


class Disk:
    """Files of this machine. Errors are `OSError`."""

    def read(self, path: Path) -> bytes:
        """All of a file."""
        return path.read_bytes()

    def create(self, path: Path, mode: int) -> int:
        """A new file to write to; it must not exist."""
        return os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0), mode)

    def reopen(self, path: Path, size: int) -> int:
        """A file to go on writing to, cut to ``size`` bytes."""
        handle = os.open(path, os.O_WRONLY | getattr(os, "O_BINARY", 0))
        try:
            os.ftruncate(handle, size)
            os.lseek(handle, 0, os.SEEK_END)
        except OSError:
            os.close(handle)
            raise
        return handle

    def write(self, handle: int, data: bytes) -> None:
        """Write all of it."""
        view = memoryview(data)
        while view:
            view = view[os.write(handle, view) :]

    def sync(self, handle: int) -> None:
        """Return when what was written survives a loss of power."""
        os.fsync(handle)

    def close(self, handle: int) -> None:
        """Close a file."""
        os.close(handle)

    def replace(self, source: Path, target: Path) -> None:
        """Let one file take the place of another, at once."""
        os.replace(source, target)

    def remove(self, path: Path) -> None:
        """Remove a file, if it is there."""
        with contextlib.suppress(FileNotFoundError):
            path.unlink()

    def sync_folder(self, folder: Path) -> None:
        """Return when new names in a folder survive a loss of power (where the system can say so)."""
        if os.name == "nt":
            return
        handle = os.open(folder, os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):  # some network file systems refuse
                os.fsync(handle)
        finally:
            os.close(handle)


def write_whole(disk: Disk, path: Path, data: bytes, mode: int = 0o666) -> None:
    """Put a file in place that is there whole, or not at all and the old one still is; it survives a loss of power.

    A symbolic link keeps pointing where it does; the permissions of a file that is replaced stay.
    """
    target = Path(os.path.realpath(path))
    with contextlib.suppress(OSError):
        mode = target.stat().st_mode & 0o777
    temporary = target.with_name(f"{_part_stem(target)}{secrets.token_hex(4)}.part")
    handle = disk.create(temporary, mode)
    try:
        try:
            disk.write(handle, data)
            disk.sync(handle)
        finally:
            disk.close(handle)
        disk.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            disk.remove(temporary)
        raise
    disk.sync_folder(target.parent)


def remove_parts(disk: Disk, path: Path, *, older_than_s: float = 0.0) -> None:
    """Remove what writers of this file left when they ended in the middle of it; nobody may be writing it now."""
    target = Path(os.path.realpath(path))
    with contextlib.suppress(OSError):
        for part in target.parent.glob(f"{glob.escape(_part_stem(target))}????????.part"):
            if time.time() - part.stat().st_mtime >= older_than_s:
                disk.remove(part)


def _part_stem(target: Path) -> str:
    return f".{target.name[:80]}-"
