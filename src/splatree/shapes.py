"""Array annotations with axis names, checked once where a struct is built.

``Float32[Array, "n 3"]`` reads: float32, first axis ``n`` (bound by the first field that has it), second axis 3. To a
type checker it is ``Array``. `check_fields` binds the names over all fields of a dataclass, so two fields that both say
``n`` agree. Axis letters: n Gaussians, k SH coefficients, b blocks, c clusters, v selected rows, m pairs, t tiles,
h w image. An axis may be written ``n+1``.
"""

import dataclasses
from functools import cache
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from splatree.errors import ShapeError

__all__ = [
    "Array",
    "Axes",
    "Bool",
    "Float32",
    "Float64",
    "Int32",
    "Int64",
    "UInt8",
    "UInt16",
    "UInt32",
    "UInt64",
    "check_fields",
    "in_short",
]

Array = npt.NDArray[Any]


@dataclasses.dataclass(frozen=True)
class Axes:
    """The dtype and the axis names of an array annotation."""

    dtype: str
    names: tuple[str, ...]


if TYPE_CHECKING:
    from typing import Annotated as Bool
    from typing import Annotated as Float32
    from typing import Annotated as Float64
    from typing import Annotated as Int32
    from typing import Annotated as Int64
    from typing import Annotated as UInt8
    from typing import Annotated as UInt16
    from typing import Annotated as UInt32
    from typing import Annotated as UInt64
else:

    class _Annotation:
        def __init__(self, dtype: str) -> None:
            self.dtype = dtype

        def __getitem__(self, item: tuple[Any, str]) -> Any:
            base, axes = item
            return Annotated[base, Axes(self.dtype, tuple(axes.split()))]

    Bool = _Annotation("bool")
    Float32 = _Annotation("float32")
    Float64 = _Annotation("float64")
    Int32 = _Annotation("int32")
    Int64 = _Annotation("int64")
    UInt8 = _Annotation("uint8")
    UInt16 = _Annotation("uint16")
    UInt32 = _Annotation("uint32")
    UInt64 = _Annotation("uint64")


@dataclasses.dataclass(frozen=True)
class _Field:
    """What an array field of a struct has to be."""

    name: str
    dtype: "np.dtype[Any]"
    axes: tuple[tuple[str, int | None, int], ...]
    """Of each axis its letter, its size if it is a number, and what is added to it."""
    wanted: str
    """The axes as they are written."""
    may_be_none: bool


@cache
def _fields_of(struct: type) -> tuple[_Field, ...]:
    """The array fields of a struct."""
    hints = get_type_hints(struct, include_extras=True)
    found = []
    for field in dataclasses.fields(struct):
        hint = hints[field.name]
        for candidate in (hint, *get_args(hint)):  # also inside "| None"
            metadata = getattr(candidate, "__metadata__", ())
            if (axes := next((m for m in metadata if isinstance(m, Axes)), None)) is not None:
                parts = [axis.partition("+")[::2] for axis in axes.names]
                sizes = tuple(
                    (letter, int(letter) if letter.isdigit() else None, int(more or 0)) for letter, more in parts
                )
                dtype, may_be_none = np.dtype(axes.dtype), NoneType in get_args(hint)
                found.append(_Field(field.name, dtype, sizes, " ".join(axes.names), may_be_none))
    return tuple(found)


def check_fields(struct: Any, **sizes: int) -> dict[str, int]:
    """Check dtype, shape and layout of each annotated array field; return the size bound to each axis name.

    ``sizes`` are bindings known beforehand. Fields that may hold None and do are skipped.

    Raises:
        ShapeError: a field is not an array, or not of the annotated dtype and shape, or not C-contiguous.
    """
    bound = dict(sizes)
    struct_type: Any = type(struct)
    owner = struct_type.__name__
    for field in _fields_of(struct_type):
        value = getattr(struct, field.name)
        if value is None and field.may_be_none:
            continue
        if not isinstance(value, np.ndarray):
            raise ShapeError(f"{owner}.{field.name}: found {type(value).__name__}, wanted a NumPy array")
        if value.dtype != field.dtype:
            found = (
                value.dtype.name if value.dtype.isnative else f"{value.dtype.name} in the byte order of another machine"
            )
            raise ShapeError(
                f"{owner}.{field.name}: found dtype {found}, wanted {field.dtype.name}; convert it with "
                f".astype(np.{field.dtype.name})"
            )
        if value.ndim != len(field.axes):
            raise ShapeError(f"{owner}.{field.name}: found shape {value.shape}, wanted ({field.wanted})")
        for size, (letter, number, more) in zip(value.shape, field.axes, strict=True):
            expected = bound.setdefault(letter, size - more) if number is None else number
            if size != expected + more or expected < 0:
                raise ShapeError(
                    f"{owner}.{field.name}: found shape {value.shape}, wanted ({field.wanted}) with "
                    f"{letter + (f'+{more}' if more else '')} = {expected + more}"
                )
        if not value.flags.c_contiguous:
            raise ShapeError(
                f"{owner}.{field.name}: found a strided array, wanted C-contiguous; use np.ascontiguousarray"
            )
    return bound


def in_short(struct: Any) -> str:
    """The `repr` of a struct of arrays: type and shape of each array in the place of its values."""
    values = {field.name: getattr(struct, field.name) for field in dataclasses.fields(struct) if field.repr}
    shown = (
        f"{name}={value.dtype.name}{value.shape}" if isinstance(value, np.ndarray) else f"{name}={value!r}"
        for name, value in values.items()
    )
    return f"{type(struct).__name__}({', '.join(shown)})"
