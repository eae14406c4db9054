"""Check the fields of a struct that are annotated with a ``Literal``.

``mode: Mode`` with ``Mode = Literal["classic", "antialiased"]`` is a promise that only type checkers hold. `check_literals` holds
the struct to it when it is built. An annotation may also offer None or another type: ``Literal["auto"] | float | None``.
"""

import dataclasses
import difflib
import numbers
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from splatree.errors import InputError

__all__ = ["check_literals"]

_ABSTRACT_FROM_TYPE: dict[type, type] = {float: numbers.Real, int: numbers.Integral}
"""NumPy's numbers count as numbers too."""
_WORDS_FROM_TYPE: dict[type, str] = {float: "a number", int: "a whole number", bool: "True or False", NoneType: "None"}


@dataclasses.dataclass(frozen=True)
class _Choices:
    """What the annotation of one field allows."""

    values: tuple[Any, ...]
    """Values named by ``Literal``."""
    types: tuple[type, ...]
    """Other types, any value of which is allowed."""

    def allows(self, value: object) -> bool:
        if any(type(value) is type(allowed) and value == allowed for allowed in self.values):
            return True
        return isinstance(value, tuple(_ABSTRACT_FROM_TYPE.get(kind, kind) for kind in self.types))

    def __str__(self) -> str:
        *others, last = [*map(repr, self.values), *(_WORDS_FROM_TYPE.get(kind, kind.__name__) for kind in self.types)]
        return f"{', '.join(others)} or {last}" if others else last


def check_literals(struct: Any) -> None:
    """Check each field of a dataclass that is annotated with a ``Literal``; call it in ``__post_init__``.

    Raises:
        InputError: a field holds a value that its annotation does not allow.
    """
    struct_type: Any = type(struct)
    for name, choices in _choices_from_field(struct_type).items():
        value = getattr(struct, name)
        if not choices.allows(value):
            hint = _did_you_mean(value, choices.values)
            raise InputError(f"{struct_type.__name__}.{name}: found {value!r}, wanted {choices}{hint}")


@cache
def _choices_from_field(struct: Any) -> dict[str, _Choices]:
    hints = get_type_hints(struct)
    found: dict[str, _Choices] = {}
    for field in dataclasses.fields(struct):
        hint = hints[field.name]
        options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        literals = [option for option in options if get_origin(option) is Literal]
        if literals:
            values = tuple(value for literal in literals for value in get_args(literal))
            types = tuple(get_origin(option) or option for option in options if option not in literals)
            found[field.name] = _Choices(values, types)
    return found


def _did_you_mean(value: object, values: tuple[Any, ...]) -> str:
    if not isinstance(value, str):
        return ""
    near = difflib.get_close_matches(value, [name for name in values if isinstance(name, str)], n=1)
    return f"; did you mean {near[0]!r}?" if near else ""
