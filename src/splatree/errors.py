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
    """Base of all errors that splatree raises on purpose.

    Example:
        >>> try:
        ...     st.read("missing.ply")
        ... except st.SplatreeError as error:
        ...     print(error)
        missing.ply: not found; wanted a scene file or folder
    """


class InputError(SplatreeError, ValueError):
    """The data or the arguments of the caller cannot be used as they are.

    Example:
        >>> st.SelectOptions(pixel_error=-1)
        Traceback (most recent call last):
        splatree.errors.InputError: pixel_error: found -1, wanted 0 px or more, at most 1e+30 or inf
    """


class FormatError(InputError):
    """A file does not hold what its format promises.

    Example:
        >>> with open("broken.ply", "w") as file:
        ...     _ = file.write("ply")
        >>> st.read("broken.ply")
        Traceback (most recent call last):
        splatree.errors.FormatError: broken.ply: ...
    """


class ShapeError(InputError):
    """An array has the wrong shape or type.

    Example:
        >>> st.write_image(np.zeros(3, np.float32), "line.png")
        Traceback (most recent call last):
        splatree.errors.ShapeError: write_image: found shape (3,), wanted (h w 3) or (h w) with at least one pixel
    """


class OutputError(SplatreeError, OSError):
    """A result could not be written. The target is as it was before.

    Example:
        >>> st.write(scene, "city.ply")
        Traceback (most recent call last):
        splatree.errors.OutputError: city.ply: ...
    """


class MissingExtraError(SplatreeError, ImportError):
    """An optional dependency is not installed.

    Example:
        >>> raise st.MissingExtraError("torch", "lpips", "LPIPS")
        Traceback (most recent call last):
        splatree.errors.MissingExtraError: LPIPS needs the package 'torch': pip install 'splatree[lpips]'
    """

    def __init__(self, module: str, extra: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs the package {module!r}: pip install 'splatree[{extra}]'")


class DeviceError(SplatreeError, RuntimeError):
    """The GPU, its driver or its compiler is missing, is too old, or failed; ``splatree doctor`` says what was found.

    Example:
        >>> issubclass(st.DeviceError, st.SplatreeError)
        True
    """
