"""A lock that one process at a time holds, and that ends with it, however it ends."""

import contextlib
import fcntl
import os
import socket
from pathlib import Path

from gmdx.errors import GmdxError


class LockedError(GmdxError):
    """Another process holds the lock; the text says which, in brackets, where that is known."""


class NoLocksError(GmdxError):
    """The file system has no locks; the text is what it said."""


class FileLock:
    """Holds the lock of a file, which is made for it, from the start until `release`."""

    def __init__(self, path: Path) -> None:
        """Take the lock at once, or not at all.

        Args:
            path: The file. Its folder is made if it is missing; the one above must be there.

        Raises:
            LockedError: Another process holds it.
            NoLocksError: Nobody can.
            OSError: The file cannot be made.
        """
        self._path = path
        while True:
            with contextlib.suppress(FileExistsError):
                path.parent.mkdir()
            try:
                # For writing, as network file systems ask of who locks a file for himself.
                self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            except FileNotFoundError:  # the holder before has just removed the folder
                continue
            try:
                self._take()
                if self._is_in_place():
                    break
            except BaseException:
                os.close(self._descriptor)
                raise
            os.close(self._descriptor)

    def release(self) -> None:
        """Remove the file and let others in."""
        with contextlib.suppress(OSError):
            self._path.unlink()
        os.close(self._descriptor)

    def _take(self) -> None:
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError) as error:
            holder = os.read(self._descriptor, 1000).decode(errors="replace")
            raise LockedError(holder) from error
        except OSError as error:
            raise NoLocksError(error.strerror) from error
        holder = f" (process {os.getpid()} on {socket.gethostname()})"
        with contextlib.suppress(OSError):  # a full disk is found out by who needs it
            os.ftruncate(self._descriptor, 0)
            os.write(self._descriptor, holder.encode())

    def _is_in_place(self) -> bool:
        """Whether this is still the file of that name: the holder before removes his at the end."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), self._path.stat())
        except FileNotFoundError:
            return False
