"""Options as they were given, or the defaults; what is of another kind is named."""

from typing import Final, TypeVar

from splatree.errors import InputError

__all__ = ["check_threads", "given"]

T = TypeVar("T")

MOST_THREADS: Final = 4096
"""No machine has more processors."""


def given(options: T | None, kind: type[T], where: str) -> T:
    """``options``, or those that ``kind`` has without arguments.

    Raises:
        InputError: they are of another kind.
    """
    if options is None:
        return kind()
    if not isinstance(options, kind):
        raise InputError(f"{where}: found {type(options).__name__}, wanted {kind.__name__}")
    return options


def check_threads(threads: object) -> None:
    """Refuse what is no number of threads.

    Raises:
        InputError: it is below 0, or more than any machine has processors.
    """
    if isinstance(threads, bool) or not isinstance(threads, int) or not 0 <= threads <= MOST_THREADS:
        raise InputError(f"threads: found {threads!r}, wanted 1 to {MOST_THREADS}, or 0 for all")
