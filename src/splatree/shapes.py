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


@cache
def _axes_from_field(struct: type) -> dict[str, tuple[Axes, bool]]:
    """Type and axes of each array field, and whether it may be None."""
    hints = get_type_hints(struct, include_extras=True)
    found: dict[str, tuple[Axes, bool]] = {}
    for field in dataclasses.fields(struct):
        hint = hints[field.name]
        for candidate in (hint, *get_args(hint)):  # also inside "| None"
            metadata = getattr(candidate, "__metadata__", ())
            axes = next((m for m in metadata if isinstance(m, Axes)), None)
            if axes is not None:
                found[field.name] = axes, NoneType in get_args(hint)
    return found


def check_fields(struct: Any, **sizes: int) -> dict[str, int]:
    """Check dtype, shape and layout of each annotated array field; return the size bound to each axis name.

    ``sizes`` are bindings known beforehand. Fields that may hold None and do are skipped.

    Raises:
        ShapeError: a field is not an array, or not of the annotated dtype and shape, or not C-contiguous.
    """
    bound = dict(sizes)
    owner = type(struct).__name__
    struct_type: Any = type(struct)
    for name, (axes, may_be_none) in _axes_from_field(struct_type).items():
        value = getattr(struct, name)
        if value is None and may_be_none:
            continue
        if not isinstance(value, np.ndarray):
            raise ShapeError(f"{owner}.{name}: found {type(value).__name__}, wanted a NumPy array")
        if value.dtype != np.dtype(axes.dtype):
            found = (
                value.dtype.name if value.dtype.isnative else f"{value.dtype.name} in the byte order of another machine"
            )
            raise ShapeError(
                f"{owner}.{name}: found dtype {found}, wanted {axes.dtype}; convert it with .astype(np.{axes.dtype})"
            )
        wanted = " ".join(axes.names)
        if value.ndim != len(axes.names):
            raise ShapeError(f"{owner}.{name}: found shape {value.shape}, wanted ({wanted})")
        for size, axis in zip(value.shape, axes.names, strict=True):
            letter, _, extra = axis.partition("+")
            expected = int(letter) if letter.isdigit() else bound.setdefault(letter, size - int(extra or 0))
            if size != expected + int(extra or 0) or expected < 0:
                raise ShapeError(
                    f"{owner}.{name}: found shape {value.shape}, wanted ({wanted}) with {axis} = "
                    f"{expected + int(extra or 0)}"
                )
        if not value.flags.c_contiguous:
            raise ShapeError(f"{owner}.{name}: found a strided array, wanted C-contiguous; use np.ascontiguousarray")
    return bound


def in_short(struct: Any) -> str:
    """The `repr` of a struct of arrays: type and shape of each array in the place of its values."""
    values = {field.name: getattr(struct, field.name) for field in dataclasses.fields(struct) if field.repr}
    shown = (
        f"{name}={value.dtype.name}{value.shape}" if isinstance(value, np.ndarray) else f"{name}={value!r}"
        for name, value in values.items()
    )
    return f"{type(struct).__name__}({', '.join(shown)})"
