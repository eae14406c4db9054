"""The words of a command line before they are parsed: options between paths, forms that people try, and hints.

The options of a verb are read off its ``Command`` dataclass, so that a word that follows one is known to be its value:
``thin a.ply --keep 25% b.ply``, ``--rotate -90,0,0``. Paths are put first, where the parser wants them.
"""

import dataclasses
import difflib
import math
import operator
import re
import types
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, reduce
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from splatree.cli.console import UsageError

__all__ = ["Option", "options_of", "placeholder", "sorted_words"]

ALIASES = {"--fov": "--fov-y-deg", "--spz-version": "--format-version"}
"""Other names of options."""

HINTS = {
    **dict.fromkeys(("--overwrite", "--replace", "-y", "-w", "-f", "--yes", "-overwrite"), "--force"),
    **dict.fromkeys(("--out", "--outfile", "--output-file", "--output-dir"), "--output"),
    **dict.fromkeys(("--ratio", "--fraction", "--percent", "--decimate"), "--keep"),
    **dict.fromkeys(("--num", "--number", "--max-splats"), "--count"),
    **dict.fromkeys(("--camera", "--cams", "--poses"), "--cameras"),
    **dict.fromkeys(("--images", "--photos", "--source"), "--data"),
    "-h": "--help",
    "-V": "--version",
    "--debug": "--verbose",
}
"""What other programs call options that are here under another name."""


@dataclasses.dataclass(frozen=True)
class Option:
    """An option of a verb, or its paths."""

    name: str
    """As it is written: --keep, -o; the bare name of paths."""
    aliases: tuple[str, ...]
    """Other ways to write it."""
    kind: Any
    """Type of the field, without None."""
    default: Any
    """Value if it is not named; `dataclasses.MISSING` if it must be."""
    owner: type
    """The dataclass that has the field."""
    field: str
    """Name of the field."""

    @property
    def is_positional(self) -> bool:
        """Whether it has no dashes."""
        return not self.name.startswith("-")

    @property
    def num_words(self) -> int | None:
        """Words that follow it; None for any number."""
        if self.kind is bool:
            return 0
        if get_origin(self.kind) is tuple:
            parts = get_args(self.kind)
            return None if parts[-1] is Ellipsis else len(parts)
        return 1

    @property
    def takes_shares(self) -> bool:
        """Whether its values are numbers that may be written as 25%."""
        kinds = get_args(self.kind) if get_origin(self.kind) is tuple else _alternatives(self.kind)
        return float in kinds


def options_of(command: Any) -> list[Option]:
    """The options of a verb, in the order of its fields."""
    return list(_walk(command, dataclasses.MISSING))


def _walk(command: Any, default: Any) -> Iterator[Option]:
    struct, bound = get_origin(command) or command, dict[Any, Any]()
    if get_origin(command) is not None:
        bound = dict(zip(_parameters(struct), get_args(command), strict=False))
    hints = _hints(struct)
    for field in dataclasses.fields(struct):
        hint = hints[field.name]
        marks = getattr(hint, "__metadata__", ())
        kind = bound.get(_bare(hint), _bare(hint))
        value = getattr(default, field.name, _default_of(field))
        settings = next((mark for mark in marks if hasattr(mark, "aliases")), None)
        if dataclasses.is_dataclass(get_origin(kind) or kind):
            yield from _walk(kind, value)
            continue
        kinds = [k for k in _alternatives(kind) if k is not type(None)]
        kind = reduce(operator.or_, kinds)
        dashed = field.name.replace("_", "-")
        positional = any("ositional" in repr(mark) for mark in marks)
        name = dashed if positional else f"--no-{dashed}" if kind is bool and value is True else f"--{dashed}"
        aliases = tuple(getattr(settings, "aliases", None) or ())
        yield Option(name, aliases, kind, value, struct, field.name)


@cache
def _hints(struct: type) -> Mapping[str, Any]:
    return get_type_hints(struct, include_extras=True)


def _parameters(struct: Any) -> tuple[TypeVar, ...]:
    return getattr(struct, "__parameters__", ())


def _default_of(field: "dataclasses.Field[Any]") -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _alternatives(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def sorted_words(words: Sequence[str], options: Sequence[Option]) -> list[str]:
    """Paths first, then the options, each with its values one by one.

    Raises:
        UsageError: a word is no option of the verb, an option lacks values, or what the verb needs is not there.
    """
    named = {name: option for option in options if not option.is_positional for name in (option.name, *option.aliases)}
    paths: list[str] = []
    rest: list[str] = []
    left = list(words)
    while left:
        word = left.pop(0)
        if word == "--":
            paths += left
            break
        if not _is_option(word):
            paths.append(word)
            continue
        name, has_value, value = word.partition("=")
        name = ALIASES.get(name, name)
        if name not in named and "_" in name and name.replace("_", "-") in named:
            name = name.replace("_", "-")
        if name in ("--help", "-h"):
            return ["--help"]
        if name not in named:
            raise UsageError(_unknown(name, named))
        option = named[name]
        if has_value:
            left.insert(0, value)
        rest += [name, *_values(name, option, left)]
    _check_needed(paths, rest, options)
    return [*paths, *rest]


def _check_needed(paths: Sequence[str], rest: Sequence[str], options: Sequence[Option]) -> None:
    """Refuse paths that the verb does not take, and a command line without what it needs."""
    if "" in paths:
        raise UsageError("found an empty path; is a variable of the shell unset? '.' is this folder")
    places = [option for option in options if option.is_positional]
    most = sum(math.inf if option.num_words is None else 1 for option in places)
    if len(paths) > most:
        wanted = " and ".join(option.name for option in places) if places else "options only; --help lists them"
        raise UsageError(f"found {paths[int(most)]!r}, wanted {f'{wanted} and nothing else' if places else wanted}")
    for option in options:
        if option.default is not dataclasses.MISSING or option.num_words is None:
            continue
        missing = not paths if option.is_positional else not {option.name, *option.aliases} & set(rest)
        if missing:
            name = f"no path, wanted the {option.name}" if option.is_positional else f"no {option.name}, wanted it"
            raise UsageError(f"found {name}; --help says more")


def _values(name: str, option: Option, left: list[str]) -> list[str]:
    """Take the values of an option from the words that are left."""
    count = option.num_words
    if count is None:
        values = []
        while left and not _is_option(left[0]):
            values.append(left.pop(0))
        _check(name, values, get_args(option.kind)[:1] * len(values))
        return values
    if count > 1 and left and left[0].count(",") == count - 1:
        left[0:1] = left[0].split(",")
    values = left[:count]
    if len(values) < count or any(value.startswith("--") for value in values):
        wanted = "a value" if count == 1 else f"{count} numbers" if option.takes_shares else f"{count} values"
        found = "nothing" if not values else repr(" ".join(values))
        raise UsageError(f"{name}: found {found} after it, wanted {wanted}{_example(name, count)}")
    del left[:count]
    if option.takes_shares:
        values = [f"{float(value[:-1]) / 100:.12g}" if _SHARE.fullmatch(value) else value for value in values]
    _check(name, values, get_args(option.kind) if get_origin(option.kind) is tuple else (option.kind,) * count)
    return values


def _check(name: str, values: Sequence[str], kinds: Sequence[Any]) -> None:
    """Refuse values that are not of their kinds, in a line."""
    for value, kind in zip(values, kinds, strict=True):
        wanted = " or ".join(map(_in_words, _alternatives(kind)))
        if not value.strip():
            raise UsageError(f"{name}: found {value!r}, wanted {wanted}; is a variable of the shell unset?")
        if not any(_is_one(value, one) for one in _alternatives(kind)):
            raise UsageError(f"{name}: found {value!r}, wanted {wanted}")


def _is_one(value: str, kind: Any) -> bool:
    """Whether the parser will make a value of this kind of a word; it takes the word None for an option that may be left out."""
    if get_origin(kind) is Literal:
        return value in ("None", *map(str, get_args(kind)))
    if kind in (int, float):
        try:
            kind(value)
        except ValueError:
            return value == "None"
    return True


def _in_words(kind: Any) -> str:
    """What is wanted of this kind."""
    if get_origin(kind) is Literal:
        *others, last = map(str, get_args(kind))
        return f"{', '.join(others)} or {last}" if others else last
    return {int: "a whole number", float: "a number", Path: "a path"}.get(kind, "a word")


_SHARE = re.compile(r"[+-]?\d+(\.\d*)?%")


def _example(name: str, count: int) -> str:
    return f", such as {name} {' '.join('012345'[:count])}" if count > 1 else ""


def _is_option(word: str) -> bool:
    """Whether a word is an option: a number below 0 and a lone - are not."""
    return len(word) > 1 and word[0] == "-" and not re.match(r"-\.?\d", word)


def _unknown(name: str, named: Mapping[str, Option]) -> str:
    if HINTS.get(name) in named:
        return f"found {name}, wanted {HINTS[name]}"
    near = difflib.get_close_matches(name, named, n=1, cutoff=0.7)
    meant = f"; did you mean {near[0]}?" if near else ""
    return f"found {name}, which is no option of this verb{meant or '; --help lists them'}"


def placeholder(kind: Any) -> str:
    """What stands for a value in the help: X, N, PATH, or the words to choose from."""
    if get_origin(kind) is tuple:
        parts = get_args(kind)
        return (
            f"{placeholder(parts[0])} ..." if parts[-1] is Ellipsis else " ".join(placeholder(part) for part in parts)
        )
    if get_origin(kind) is Literal:
        return "|".join(str(value) for value in get_args(kind))
    if get_origin(kind) in (Union, types.UnionType):
        return "|".join(placeholder(part) for part in get_args(kind))
    return {bool: "", int: "N", float: "X", Path: "PATH", str: "TEXT"}.get(kind, "VALUE")
