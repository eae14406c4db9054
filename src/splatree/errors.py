"""What splatree raises.

::

    SplatreeError
    ├── InputError            the user's data or arguments cannot be used as they are
    │   ├── FormatError       a file does not hold what its format promises
    │   └── ShapeError        an array has the wrong shape or type
    ├── OutputError           a result could not be written; the target is as it was
    ├── MissingExtraError     an optional dependency is not installed
    └── DeviceError           the GPU, its driver or its compiler is missing, too old, or failed

A message says what, found, wanted, and then what to do; it names the file, the field, the row.
"""


class SplatreeError(Exception):
    """Base of all errors that splatree raises on purpose."""


class InputError(SplatreeError, ValueError):
    """The user's data or arguments cannot be used as they are."""


class FormatError(InputError):
    """A file does not hold what its format promises."""


class ShapeError(InputError):
    """An array has the wrong shape or type."""


class OutputError(SplatreeError, OSError):
    """A result could not be written; the target is as it was before."""


class MissingExtraError(SplatreeError, ImportError):
    """An optional dependency is not installed."""

    def __init__(self, module: str, extra: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs the package {module!r}: pip install 'splatree[{extra}]'")


class DeviceError(SplatreeError, RuntimeError):
    """The GPU, its driver or its compiler is missing, too old, or failed; ``splatree doctor`` says what was found."""
