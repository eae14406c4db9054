"""Whole files or none: write beside the target, flush to the disk, rename.

An object of a store is written as a file of this machine, and sent when it is whole.

Without ``force`` the name is taken by a hard link, which fails if it is taken already: of several writers one wins. With it the
new file keeps the mode of the old one. What killed writers left is removed by the next writer in the folder.
"""

import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType

from splatree.errors import OutputError, SplatreeError
from splatree.io.objects import ObjectPath, located
from splatree.progress import renamed, task

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

ON_WINDOWS = os.name == "nt"

_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{8}\.splatree\.tmp")


@contextmanager
def replacing(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Yield the path of a new, empty file beside ``path`` which takes its place when the block ends without an exception.

    Until then, and after any exception, the old file is as it was and nothing is left beside it. Progress and errors name
    ``path``.

    Raises:
        OutputError: the file exists and ``force`` is not set, it is not a plain file, its folder is missing, or the disk is
            full or otherwise fails.
    """
    target = check_free(path, force=force)
    if isinstance(target, ObjectPath):
        with _sent_to(target) as local:
            yield local
        return
    remove_abandoned(target.parent)
    temporary: Path | None = None
    held: int | None = None
    try:
        while held is None:
            temporary = target.parent / f".{target.name[:100]}.{os.urandom(4).hex()}.splatree.tmp"
            held = _lock_of_new(temporary)
        assert temporary is not None
        with renamed(temporary.name, Path(path).name):
            yield temporary
        flush(temporary, os.O_RDWR)
        if force and target.exists():
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
        if force:
            temporary.replace(target)
        elif not _moved_to_free_name(temporary, target):
            raise OutputError(_exists(path))
        if not ON_WINDOWS:  # which opens no folders; its file systems write the new name down themselves
            flush(target.parent, os.O_RDONLY)
    except SplatreeError as error:
        error.args = tuple(name_in(str(part), temporary, path) for part in error.args)
        raise
    except OSError as error:
        is_open = ON_WINDOWS and isinstance(error, PermissionError) and target.exists()
        advice = (
            "; Windows replaces no file that is open or mapped: close the scene that was read from it"
            if is_open
            else ""
        )
        raise OutputError(
            f"{path}: could not be written ({error.strerror or error}); the old file, if any, is whole{advice}"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if held is not None:
            os.close(held)


@contextmanager
def _sent_to(target: ObjectPath) -> Iterator[Path]:
    """A file of this machine, which is put into a store when it is whole; what was written beside it goes before it."""
    with tempfile.TemporaryDirectory(prefix="splatree-") as folder:
        local = Path(folder) / target.name
        local.touch()
        try:
            yield local
        except SplatreeError as error:
            error.args = tuple(str(part).replace(str(local), str(target)) for part in error.args)
            raise
        except OSError as error:
            raise OutputError(f"{target}: could not be written ({error.strerror or error})") from error
        others = [path for path in local.parent.iterdir() if path != local]
        _send_all([(path, target.parent / path.name) for path in sorted(others)] + [(local, target)])


def _send_all(files: Sequence[tuple[Path, ObjectPath]]) -> None:
    """Put files into a store; if one cannot be sent, those that were sent and not there before are removed."""
    sent = list[ObjectPath]()
    try:
        for local, target in files:
            is_new = not target.exists()
            send(local, target)
            sent += [target] * is_new
    except BaseException:
        for target in sent:
            with suppress(OutputError):  # the store refuses that, too
                target.unlink()
        raise


def send(local: Path, target: ObjectPath) -> None:
    """Put a file into a store.

    Raises:
        OutputError: the store refuses.
    """
    with task(f"send {target.name}", float(local.stat().st_size)) as advance:
        target.put(local)
        advance(float(local.stat().st_size))


def name_in(text: str, temporary: Path | None, path: str | os.PathLike[str]) -> str:
    """What a writer said, who knows the file by its temporary name alone."""
    if temporary is None:
        return text
    return text.replace(str(temporary), str(path)).replace(temporary.name, Path(path).name)


def remove_abandoned(folder: Path) -> None:
    """Remove temporary files in a folder whose writer has ended without taking them away, killed or cut off from power.

    A writer holds a lock on its file, which ends with the process. On Windows what is in use cannot be removed either.
    """
    try:
        abandoned = [entry for entry in folder.iterdir() if _TEMPORARY.fullmatch(entry.name)]
    except OSError:
        return  # a folder that may be written but not listed: nothing can be told of its files
    for entry in abandoned:
        with suppress(OSError):  # in use, or another writer was faster
            descriptor = os.open(entry, os.O_RDWR)
            try:
                if lock(descriptor) is not False:
                    entry.unlink()
            finally:
                os.close(descriptor)


def _lock_of_new(temporary: Path) -> int | None:
    """Make an empty file and lock it; None if another writer took it for an abandoned one between both."""
    descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    if lock(descriptor) is not False and temporary.exists():
        return descriptor
    os.close(descriptor)
    temporary.unlink(missing_ok=True)
    return None


def lock(descriptor: int) -> bool | None:
    """Lock an open file for this process: whether nobody else has; None where files cannot be locked."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS):
            return None  # a file system without locks
        raise
    return True


def _moved_to_free_name(temporary: Path, target: Path) -> bool:
    """Give the file its name if nobody else has taken it; of several writers one wins."""
    if ON_WINDOWS:
        try:
            temporary.rename(target)  # which replaces nothing there
        except FileExistsError:
            return False
        return True
    try:
        target.hardlink_to(temporary)
    except FileExistsError:
        return False
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.EMLINK, errno.ENOSYS, errno.EXDEV):
            raise
        # A file system without hard links: an empty file takes the name first.
        try:
            os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        except FileExistsError:
            return False
        temporary.replace(target)
    return True


def _exists(path: str | os.PathLike[str]) -> str:
    return f"{path}: exists already; choose another name or replace it with force (--force)"


def check_target(path: str | os.PathLike[str]) -> Path:
    """Refuse what no file can be written to, before any work is done for it; return the path through all links.

    Raises:
        OutputError: it is there and not a plain file, its folder is missing or may not be looked into, no file can have its name,
            links lead in a circle, or the working folder is gone.
    """
    target = located(path)
    if isinstance(target, ObjectPath) and str(target).startswith("http"):
        raise OutputError(f"{target}: cannot be written, https is only read; name a file, or a store such as s3://")
    try:
        target = target.resolve()  # so that what a link points to is replaced
        is_other = target.exists() and not target.is_file()
        has_folder = isinstance(target, ObjectPath) or target.parent.is_dir()
    except FileNotFoundError as error:
        raise OutputError(
            f"{path}: cannot be written, the working folder was deleted; change to another one"
        ) from error
    except (OSError, RuntimeError) as error:  # a circle of links is the one or the other
        what = error.strerror if isinstance(error, OSError) else "its links lead in a circle"
        raise OutputError(f"{path}: cannot be written ({what or error})") from error
    if is_other:
        raise OutputError(f"{path}: cannot be written, it is not a plain file")
    if not has_folder:
        raise OutputError(f"{path}: cannot be written, there is no folder {target.parent}")
    return target


def check_free(path: str | os.PathLike[str], *, force: bool) -> Path:
    """As `check_target`; refuse a file that exists, too, unless ``force`` replaces it.

    Raises:
        OutputError: no file can be written there, or one exists.
    """
    target = check_target(path)
    if target.exists() and not force:
        raise OutputError(_exists(path))
    return target


def check_free_in(folder: Path, names: Sequence[str], *, force: bool) -> None:
    """As `check_free`, of files in a folder that need not be there yet: before any work is done for them; nothing is made.

    Raises:
        OutputError: a file is in its place, nothing may be written there, or a name is taken and ``force`` is not set.
    """
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise OutputError(f"{folder}: cannot be made a folder, {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise OutputError(f"{folder}: cannot be written, nothing may be written into {there}")
    for name in names:
        if folder.exists():
            check_target(folder / name)
        if (folder / name).exists() and not force:
            raise OutputError(f"{folder / name}: exists already; choose another folder or replace it with --force")


def flush(path: Path, flags: int) -> None:
    """Wait until what was written to a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
