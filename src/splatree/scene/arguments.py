"""Check the arguments of a public function against their annotations, before anything is done with them.

``st.render(scene, camera, select=0)`` means nothing, and `checked` says so: "render: select: found 0, wanted SelectOptions, …".
Without it, what is of a wrong kind is met somewhere inside, as an attribute that is missing, or passes for what was not given.

Kinds are checked: numbers, flags, names of ``Literal``, texts, paths, structs, functions, and what sequences hold. Values are
left to the function, and so are arrays, but for what is no array of numbers. A call costs microseconds more.
"""

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence, Set, Sized
from functools import cache, wraps
from inspect import unwrap
from types import UnionType
from typing import Annotated, Any, Literal, ParamSpec, Protocol, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from splatree.errors import InputError
from splatree.scene.cameras import Camera, check_is_camera, several
from splatree.scene.given import check_threads
from splatree.scene.literals import in_words, is_among, is_of, shown
from splatree.scene.scene import Scene, check_is_scene

__all__ = ["checked"]

Given = ParamSpec("Given")
Result = TypeVar("Result")


def checked(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """A function that refuses arguments of other kinds than its annotations name.

    Raises:
        InputError: an argument is of another kind.
    """
    name = function.__name__

    @wraps(function)
    def call(*args: Given.args, **kwargs: Given.kwargs) -> Result:
        hints = _hints_of(function)
        for (argument, (plain, hint)), value in zip(hints.items(), args, strict=False):
            if type(value) not in plain and not _is_one(value, hint):
                _refuse(name, argument, value, hint)
        for argument, value in kwargs.items():
            plain, hint = hints.get(argument, (frozenset(), Any))
            if type(value) not in plain and not _is_one(value, hint):
                _refuse(name, argument, value, hint)
        return function(*args, **kwargs)

    return call


@cache
def _hints_of(function: Callable[..., Any]) -> dict[str, tuple[frozenset[type], Any]]:
    """Of the arguments that have a name, in their order: types whose values are right without a closer look, and annotations."""
    code = unwrap(function).__code__
    hints = get_type_hints(function, include_extras=True)
    named = {name: hints.get(name, Any) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]}
    return {name: (_plain_of(hint), Any if _are_inputs(hint) else hint) for name, hint in named.items()}


def _are_inputs(hint: Any) -> bool:
    """Whether an annotation is one path or several: who opens them says more of what is none (io/local.py)."""
    return {os.PathLike, Sequence} <= {get_origin(kind) for kind in get_args(hint)}


def _plain_of(hint: Any) -> frozenset[type]:
    """Types that an annotation names; whole numbers may be too large."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return frozenset(kind for kind in kinds if isinstance(kind, type) and kind is not int)


def _is_one(value: Any, hint: Any) -> bool:
    """Whether a value is what an annotation names."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_is_one(value, part) for part in parts)
    if hint is Any or isinstance(hint, TypeVar):
        return True
    if origin is Literal:
        return is_among(value, parts)
    if origin is Annotated:
        return _are_numbers(value)
    if origin is tuple or hint in (float, int, bool, str, type(None)):
        return is_of(value, hint)
    if origin is Callable:
        return callable(value)
    if Protocol in getattr(hint, "__mro__", ()):  # a module may have its functions
        asked = [name for name in vars(hint) if name == "__call__" or not name.startswith("_")]
        return all(hasattr(value, name) for name in asked)
    if origin is None or origin is os.PathLike:
        return isinstance(value, origin or hint)
    if isinstance(value, str | bytes):  # are sequences of themselves
        return False
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return False
    if origin is Sequence:  # `Cameras` is one, too
        holds = isinstance(value, Iterable) and isinstance(value, Sized) and not isinstance(value, Mapping | Set)
    else:
        holds = isinstance(value, origin)
    if isinstance(value, Mapping) or not isinstance(value, Collection):
        return holds
    return holds and all(_is_one(part, parts[0]) for part in value)


def _are_numbers(value: Any) -> bool:
    """Whether an array can be made of numbers; of what does not lie in the memory of this machine, no array is made."""
    try:
        return getattr(value, "dtype", None) is not None or np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError):  # rows of several lengths, or what lies on another device
        return False


def _refuse(function: str, argument: str, value: object, hint: Any) -> None:
    """Say what was found and what is wanted; of scenes and cameras, how to come by them."""
    if argument == "threads":
        check_threads(value)
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if Scene in kinds:
        check_is_scene(value, function)
    if Camera in kinds:
        check_is_camera(value)
    takes_cameras = any(get_origin(kind) in (Sequence, Iterable) and Camera in get_args(kind) for kind in kinds)
    is_iterator = isinstance(value, Iterable) and not isinstance(value, Camera | Sized)  # which may have no end
    if takes_cameras and not is_iterator:
        several(value)  # type: ignore[arg-type]
    raise InputError(f"{function}: {argument}: found {_found(value)}, wanted {_wanted(hint)}")


def _found(value: object) -> str:
    """A value that says itself, or the kind of a larger one."""
    return shown(value) if isinstance(value, int | float | str | bytes | type(None)) else type(value).__name__


def _wanted(hint: Any) -> str:
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        words = list(dict.fromkeys(_wanted(part) for part in parts))
        return f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else words[0]
    if origin is Literal:
        return ", ".join(map(repr, parts))
    if origin is Annotated:
        return "an array of numbers"
    if origin is os.PathLike or hint is str:
        return "a path" if origin else "a text"
    if origin is Callable:
        return "a function"
    if origin is None or origin is tuple:
        return in_words(hint)
    return f"several of: {_wanted(parts[-1])}" if parts else str(origin.__name__)
