"""Locks between programs: held by the operating system for the process, so that they end with it, however it ends."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from pathlib import Path

from keypose.errors import KeyposeError


class Locked(KeyposeError):
    """Another program has it open."""


class Lock:
    """A lock file. It says who holds it; what counts is the system's own lock on it, which dies with its process."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._handle: int | None = None

    def acquire(self, what: str) -> None:
        """Take it, or raise `Locked` saying who has ``what``.

        Raises:
            Locked: where another program, or another studio of this one, holds it.
            OSError: where there can be no lock file.
        """
        while self._handle is None:
            handle = os.open(self.path, os.O_CREAT | os.O_RDWR | getattr(os, "O_BINARY", 0), 0o600)
            try:
                if not _try_lock(handle):
                    who = os.pread(handle, 200, 1).decode("utf-8", "replace") if hasattr(os, "pread") else ""
                    raise Locked(f"{what} is open in another studio{f' ({who})' if who else ''}")
                # whoever held it before may have removed the file between our opening and locking it
                if os.name == "nt" or self._is(handle):
                    os.ftruncate(handle, 0)
                    os.write(handle, f"\nprocess {os.getpid()} on {socket.gethostname()}".encode())
                    self._handle = handle
                    return
            except BaseException:
                os.close(handle)
                raise
            os.close(handle)

    def release(self) -> None:
        """Give it back."""
        if self._handle is None:
            return
        if os.name != "nt":  # there an open file cannot be removed
            with contextlib.suppress(OSError):
                self.path.unlink()
        os.close(self._handle)
        self._handle = None
        if os.name == "nt":
            with contextlib.suppress(OSError):
                self.path.unlink()

    def _is(self, handle: int) -> bool:
        try:
            named = os.stat(self.path)
        except FileNotFoundError:
            return False
        mine = os.fstat(handle)
        return (named.st_dev, named.st_ino) == (mine.st_dev, mine.st_ino)


if sys.platform == "win32":
    import msvcrt

    def _try_lock(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _try_lock(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
