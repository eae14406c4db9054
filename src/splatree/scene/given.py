"""Options as they were given, or the defaults; what is of another kind is named."""

from typing import TypeVar

from splatree.errors import InputError

__all__ = ["given"]

T = TypeVar("T")


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
