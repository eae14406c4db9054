"""One process at a time in a folder of work.

The process that works in a folder has a file there, which names it, and holds the lock of the system on that file. Such a lock
ends with its process, however that ends. So a file without a lock is of a process that was killed, and the next takes it over.
Only a file that names another machine is not taken over: this machine may not see the locks of that one.

Workers do not ask: whoever holds the folder gives them their pieces.
"""

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from splatree.errors import OutputError
from splatree.io.replacing import lock

__all__ = ["LOCK", "alone_in"]

LOCK = "lock"
"""Name of the file."""


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Make a folder of work, unless it is there, and keep other processes out of it as long as the context is open.

    The folder is removed in the end if nothing else is in it.

    Raises:
        OutputError: another process works there, or may do so, or the folder cannot be made.
    """
    try:
        descriptor = _taken(folder)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{folder}: cannot be made a folder ({error.strerror or error})") from error
    try:
        yield
    finally:
        if _is_at(descriptor, folder / LOCK):
            (folder / LOCK).unlink(missing_ok=True)
        os.close(descriptor)
        with suppress(OSError):  # it holds what the next process goes on with
            folder.rmdir()


def _taken(folder: Path) -> int:
    """The open file of the folder, locked, with the name of this process in it."""
    path, here = folder / LOCK, socket.gethostname()
    while True:
        folder.mkdir(exist_ok=True)
        try:
            descriptor, is_new = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), True
        except FileExistsError:
            try:
                descriptor, is_new = os.open(path, os.O_RDWR), False
            except FileNotFoundError:  # it was removed meanwhile
                continue
        except FileNotFoundError:  # so was the folder
            continue
        try:
            is_locked = lock(descriptor)
            pid, host = _said_by(descriptor)
            if is_locked is False:
                where = "this machine" if host in ("", here) else host
                raise OutputError(
                    f"{folder}: found that process {pid or 'that has just begun'} of {where} works there, for the same output; "
                    "wait until it ends, or choose another output"
                )
            if host not in ("", here) or (is_locked is None and not is_new):
                raise OutputError(
                    f"{path}: found that process {pid} of {host or 'an unknown machine'} works there, and cannot see from here "
                    "whether it still does; if it has ended, delete this file and run the command again: it goes on where that "
                    "one stopped"
                )
            if _is_at(descriptor, path):  # else it was removed before it was locked
                os.ftruncate(descriptor, 0)
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, json.dumps({"pid": os.getpid(), "host": here}).encode())
                kept, descriptor = descriptor, -1
                return kept
        finally:
            if descriptor >= 0:
                os.close(descriptor)


def _said_by(descriptor: int) -> tuple[int, str]:
    """The process and the machine that a file names; zero and nothing if it was cut off before it did."""
    try:
        said = json.loads(os.read(descriptor, 1 << 12))
        return int(said["pid"]), str(said["host"])
    except (ValueError, KeyError, TypeError):
        return 0, ""


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether an open file is the one that has a name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
