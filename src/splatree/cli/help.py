"""What ``splatree <verb> --help`` prints: what the verb does, two examples, its basic options, and those for experts.

The texts are the docstrings of the ``Command`` dataclasses and of their fields, read from the sources.
"""

import ast
import dataclasses
import inspect
import shutil
import textwrap
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from splatree.cli.examples import BASIC, EXAMPLES
from splatree.cli.words import Option, options_of, placeholder

__all__ = ["examples_of", "help_of"]

WIDTH_MAX = 110
"""Longer lines are hard to read."""

INDENT = 26
"""Column at which the texts of the options begin."""


def help_of(verb: str, command: Any, description: str | None = None) -> str:
    """The help of a verb."""
    width = min(WIDTH_MAX, shutil.get_terminal_size((WIDTH_MAX, 24)).columns)
    options = options_of(command)
    paths = [option for option in options if option.is_positional]
    named = [option for option in options if not option.is_positional]
    basic = [option for option in named if _is_basic(verb, option, command)]
    expert = [option for option in named if option not in basic]
    usage = " ".join(["usage: splatree", verb, *(option.name.upper() for option in paths), "[options]"])
    said = description or inspect.cleandoc(command.__doc__ or "")
    text = [usage, *_paragraphs("\n".join(line for line in said.splitlines() if not _is_example(line)), width)]
    text += ["examples:", *(f"  {example}" for example in examples_of(verb, command)), ""]
    for title, group in (("arguments:", paths), ("basic options:", basic), ("expert options:", expert)):
        if group:
            text += [title, *(line for option in group for line in _lines(option, width)), ""]
    return "\n".join(text).rstrip()


def examples_of(verb: str, command: Any) -> list[str]:
    """Examples of a verb: those listed for it, else the lines of its docstring that are command lines."""
    written = [line.strip() for line in (command.__doc__ or "").splitlines() if _is_example(line)]
    return list(EXAMPLES.get(verb, written))


def _is_example(line: str) -> bool:
    return line.strip().startswith("splatree ")


def _paragraphs(text: str, width: int) -> list[str]:
    lines = [""]
    for paragraph in text.strip().split("\n\n"):
        lines += [*textwrap.wrap(" ".join(paragraph.split()), width), ""]
    return lines


def _is_basic(verb: str, option: Option, command: Any) -> bool:
    chosen = BASIC.get(verb)
    if chosen is None:
        return True
    return option.name.removeprefix("--") in chosen or option.name in ("--force", "--json", "--verbose", "--quiet")


def _lines(option: Option, width: int) -> Iterable[str]:
    names = ", ".join((*sorted(option.aliases), option.name.upper() if option.is_positional else option.name))
    values = "" if option.is_positional else placeholder(option.kind)
    head = f"  {names} {values}".rstrip()
    turns_off = "Turn off: " if option.kind is bool and option.default is True else ""
    text = " ".join((turns_off + _texts(option.owner).get(option.field, "") + _default(option)).split())
    text = text.replace("; None: ", "; without it: ").replace("None: ", "Without it: ")
    wrapped = textwrap.wrap(text, width - INDENT) or [""]
    if len(head) >= INDENT - 1:
        yield from textwrap.wrap(head.strip(), width, initial_indent="  ", subsequent_indent=" " * 6)
    else:
        yield f"{head.ljust(INDENT)}{wrapped.pop(0)}"
    yield from (f"{'':{INDENT}}{line}" for line in wrapped)


def _default(option: Option) -> str:
    """The default in words; nothing where it is nothing."""
    value = option.default
    if value is dataclasses.MISSING or value is None or isinstance(value, bool) or value == ():
        return ""
    shown = " ".join(map(_shown, value)) if isinstance(value, tuple) else _shown(value)
    return f" (default: {shown})"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


@cache
def _texts(struct: type) -> dict[str, str]:
    """Docstrings of the fields, from the sources of the class and of those that it is made from."""
    found: dict[str, str] = {}
    for base in reversed(struct.__mro__):
        if not dataclasses.is_dataclass(base):
            continue
        file = inspect.getsourcefile(base)
        if file is None:
            continue
        for node in _classes(Path(file)).get(base.__name__, []):
            for field, text in zip(node.body, node.body[1:], strict=False):
                if (
                    isinstance(field, ast.AnnAssign)
                    and isinstance(field.target, ast.Name)
                    and isinstance(text, ast.Expr)
                    and isinstance(text.value, ast.Constant)
                    and isinstance(text.value.value, str)
                ):
                    found[field.target.id] = inspect.cleandoc(text.value.value)
    return found


@cache
def _classes(file: Path) -> dict[str, list[ast.ClassDef]]:
    found: dict[str, list[ast.ClassDef]] = {}
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef):
            found.setdefault(node.name, []).append(node)
    return found
