"""Check the fields of a struct against their annotations: names, numbers, flags, texts, paths, structs and tuples of numbers.

``mode: Mode`` with ``Mode = Literal["classic", "antialiased"]`` is a promise that only type checkers hold. `check_literals` holds
the struct to it when it is built. An annotation may also offer None or another type: ``Literal["auto"] | float | None``. Fields
of other kinds, such as arrays, are left to `splatree.shapes.check_fields`. A path may be given as a text. Numbers and texts of
NumPy become Python's own, so that options can be written down (JSON has no others) and mean the same wherever they came from.
"""

import dataclasses
import difflib
import numbers
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from splatree.errors import InputError

__all__ = ["as_python", "check_literals", "in_words", "is_among", "is_of", "shown"]

_ABSTRACT_FROM_TYPE: Final[dict[type, Any]] = {
    float: numbers.Real,
    int: numbers.Integral,
    bool: bool | np.bool_,
    str: str,
    Path: Path,
    NoneType: NoneType,
}
"""NumPy's numbers count as numbers too."""
_PLAIN: Final[dict[type, type]] = {Path: type(Path())}
_WORDS_FROM_TYPE: Final[dict[type, str]] = {
    float: "a number",
    int: "a whole number",
    bool: "True or False",
    str: "a text",
    Path: "a path",
    NoneType: "None",
}

_LARGEST: Final = 2**63 - 1
"""Of whole numbers: kernels and files have no room for more."""


@dataclasses.dataclass(frozen=True)
class _Choices:
    """What the annotation of one field allows."""

    values: tuple[Any, ...]
    """Values named by ``Literal``."""
    types: tuple[Any, ...]
    """Other types, any value of which is allowed."""
    plain: frozenset[type]
    """Python's own types among them: most values are of these, and views are made for each frame."""

    def allows(self, value: object) -> bool:
        return is_among(value, self.values) or any(is_of(value, kind) for kind in self.types)

    def __str__(self) -> str:
        *others, last = [*map(repr, self.values), *map(in_words, self.types)]
        return f"{', '.join(others)} or {last}" if others else last


def check_literals(struct: Any) -> None:
    """Check each field of a dataclass whose annotation can be checked; call it in ``__post_init__``.

    Raises:
        InputError: a field holds a value that its annotation does not allow.
    """
    struct_type: Any = type(struct)
    for name, choices in _choices_from_field(struct_type).items():
        value = getattr(struct, name)
        if type(value) in choices.plain:
            continue
        if isinstance(value, str) and Path in choices.types and str not in choices.types:
            value = Path(value)
        if not choices.allows(value):
            hint = _did_you_mean(value, choices.values)
            raise InputError(f"{struct_type.__name__}.{name}: found {shown(value)}, wanted {choices}{hint}")
        settled = as_python(value)
        if settled is not getattr(struct, name):
            object.__setattr__(struct, name, settled)


def as_python(value: Any) -> Any:
    """A number, flag or text as Python's own, also where several stand in a list, an array or a tuple, which becomes a tuple; any
    other value as it is."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, tuple | list | np.ndarray):
        settled = tuple(map(as_python, value))
        is_same = type(value) is tuple and all(a is b for a, b in zip(value, settled, strict=True))
        return value if is_same else settled
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value)
    return str.__str__(value) if isinstance(value, str) else value


def is_among(value: object, names: tuple[Any, ...]) -> bool:
    """Whether a value is one of the names or numbers of ``Literal``; NumPy's texts are names, too."""
    return any(is_of(value, type(name)) and value == name for name in names)


def is_of(value: object, kind: Any) -> bool:
    """Whether a value is of a kind that an annotation names: a type, or a tuple of numbers or texts."""
    if type(value) is int and kind is int:
        return abs(value) <= _LARGEST
    if get_origin(kind) is tuple:
        parts = get_args(kind)
        if not isinstance(value, tuple | list | np.ndarray) or (isinstance(value, np.ndarray) and value.ndim != 1):
            return False
        if parts[-1] is Ellipsis:
            return all(is_of(part, parts[0]) for part in value)
        return len(value) == len(parts) and all(type(part) is float or is_of(part, float) for part in value)
    if isinstance(value, bool | np.bool_) and kind is not bool:
        return False
    if kind is int and isinstance(value, numbers.Integral):
        return abs(int(value)) <= _LARGEST
    return isinstance(value, _ABSTRACT_FROM_TYPE.get(kind, kind))


def in_words(kind: Any) -> str:
    """What an annotation names, for a message."""
    if get_origin(kind) is tuple:
        parts = get_args(kind)
        return f"several of: {in_words(parts[0])}" if parts[-1] is Ellipsis else f"{len(parts)} numbers"
    return _WORDS_FROM_TYPE.get(kind) or str(kind.__name__)


def shown(value: object) -> str:
    """A value, cut short."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}..."


@cache
def _choices_from_field(struct: Any) -> dict[str, _Choices]:
    hints = get_type_hints(struct)
    found: dict[str, _Choices] = {}
    for field in dataclasses.fields(struct):
        hint = hints[field.name]
        options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        literals = [option for option in options if get_origin(option) is Literal]
        others = tuple(option for option in options if option not in literals)
        if all(map(_can_be_checked, others)):
            plain = frozenset(
                _PLAIN.get(kind, kind) for kind in others if kind is not int and get_origin(kind) is not tuple
            )
            values = tuple(value for literal in literals for value in get_args(literal))
            found[field.name] = _Choices(values, others, plain)
    return found


def _can_be_checked(kind: Any) -> bool:
    if get_origin(kind) is tuple:
        return set(get_args(kind)) in ({float}, {float, Ellipsis}, {str, Ellipsis})
    return kind in _ABSTRACT_FROM_TYPE or (isinstance(kind, type) and dataclasses.is_dataclass(kind))


def _did_you_mean(value: object, values: tuple[Any, ...]) -> str:
    if not isinstance(value, str):
        return ""
    near = difflib.get_close_matches(value, [name for name in values if isinstance(name, str)], n=1)
    return f"; did you mean {near[0]!r}?" if near else ""
