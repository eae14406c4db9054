"""Whole files or none: write beside the target, flush to the disk, rename."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatree.errors import OutputError, SplatreeError
from splatree.progress import renamed

ON_WINDOWS = os.name == "nt"


@contextmanager
def replacing(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Yield the path of a new, empty file beside ``path`` which takes its place when the block ends without an exception.

    Until then, and after any exception, the old file is as it was and nothing is left beside it. Progress and errors name
    ``path``.

    Raises:
        OutputError: the file exists and ``force`` is not set, it is not a plain file, its folder is missing, or the disk is
            full or otherwise fails.
    """
    target = Path(path).resolve()  # through a link, so that what it points to is replaced
    check_target(path)
    if target.exists() and not force:
        raise OutputError(f"{path}: exists already; choose another name or replace it with force")
    temporary = target.parent / f".{target.name[:100]}.{os.urandom(4).hex()}.tmp"
    try:
        temporary.touch(exist_ok=False)
        with renamed(temporary.name, Path(path).name):
            yield temporary
        _flush(temporary, os.O_RDWR)
        temporary.replace(target)
        if not ON_WINDOWS:  # which opens no folders; its file systems write the new name down themselves
            _flush(target.parent, os.O_RDONLY)
    except SplatreeError as error:
        # A writer knows the file by its temporary name alone.
        error.args = tuple(str(part).replace(str(temporary), str(path)) for part in error.args)
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
        temporary.unlink(missing_ok=True)


def check_target(path: str | os.PathLike[str]) -> None:
    """Refuse what no file can be written to, before any work is done for it.

    Raises:
        OutputError: it is there and not a plain file, or its folder is missing or may not be
            looked into, or no file can have its name.
    """
    target = Path(path).resolve()
    try:
        is_other = target.exists() and not target.is_file()
        has_folder = target.parent.is_dir()
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    if is_other:
        raise OutputError(f"{path}: cannot be written, it is not a plain file")
    if not has_folder:
        raise OutputError(f"{path}: cannot be written, there is no folder {target.parent}")


def _flush(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
