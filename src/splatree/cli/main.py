"""``splatree <verb>``: finds the verb, parses its options, shows its result or its error.

A verb is a module of this package with three names: ``Command``, a dataclass whose fields are the arguments and options (their
docstrings are the help), ``run(command)``, which returns a result struct, and ``show(result)``, which says it in words. With
``--json`` the struct itself is printed. Results go to stdout, everything else to stderr.

Exit codes: 0 done, 1 an error while working, 2 a wrong command line, 130 interrupted.
"""

import dataclasses
import importlib
import json
import math
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splatree.errors import InputError, SplatreeError

VERBS = {
    "demo": "build, draw and judge a bundled piece of a real city",
    "info": "say what a scene holds",
    "convert": "write a scene in another format",
    "thin": "merge Gaussians that are close, to a radius, a share or a count",
    "build": "build the levels of detail of a scene",
    "render": "draw pictures or a video",
    "eval": "compare the levels of detail with all leaves, or with photographs",
    "formats": "list the formats that are read and written",
}

USAGE = """usage: splatree <verb> [options]

{verbs}

splatree <verb> --help says more; every verb takes --json, --verbose and --quiet."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    usage = USAGE.format(verbs="\n".join(f"  {verb:9}{purpose}" for verb, purpose in VERBS.items()))
    if words[:1] in (["-h"], ["--help"]):
        print(usage)
        return 0
    if words[:1] == ["--version"]:
        from splatree.cli.console import program_version

        print(f"splatree {program_version()}")
        return 0
    if not words or words[0] not in VERBS:
        found = f"found {words[0]!r}, wanted one of {', '.join(VERBS)}" if words else "wanted a verb"
        print(f"splatree: error: {found}\n\n{usage}", file=sys.stderr)
        return 2
    return _run(words[0], words[1:])


def _run(verb: str, words: list[str]) -> int:
    import tyro

    from splatree.cli.console import progress_shown

    module = importlib.import_module(f"splatree.cli.{verb}")
    try:
        command = tyro.cli(module.Command, prog=f"splatree {verb}", args=words, config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as stop:  # tyro has printed the help, or what is wrong
        return int(stop.code or 0)
    except InputError as error:  # a value that its option refuses
        print(f"splatree {verb}: error: {error}", file=sys.stderr)
        return 2
    console = command.console
    try:
        with progress_shown(console):
            result = module.run(command)
        if console.json:
            print(json.dumps(_plain(result), indent=2, ensure_ascii=False, allow_nan=False))
        elif not console.quiet:
            print(module.show(result))
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("splatree: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if console.verbose:
            traceback.print_exc()
        print(f"splatree {verb}: error: {_message(error)}", file=sys.stderr)
        return 1
    return 0


def _message(error: Exception) -> str:
    if isinstance(error, SplatreeError | OSError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"out of memory ({error})" if str(error) else "out of memory"
    return f"unexpected {type(error).__name__}: {error}; this is a bug, please report it with the output of --verbose"


def _plain(value: Any) -> Any:
    """A result struct as what JSON has; infinity and NaN, which it has not, become null."""
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # NumPy's arrays and scalars
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
