"""``splatree <verb>``: finds the verb, parses its options, shows its result or its error.

A verb is a module of this package with three names: ``Command``, a dataclass whose fields are the arguments and options (their
docstrings are the help), ``run(command)``, which returns a result struct, and ``show(result)``, which says it in words. With
``--json`` the struct itself is printed. Results go to stdout, everything else to stderr.

A struct within a ``Command`` is marked ``arg(name="", help="")``: its fields are options like the others, without a prefix, and
without a heading, for which tyro would read the sources at every start.

A verb with several commands, such as ``splatree bench table1``, is listed in GROUPS and has ``COMMANDS``, dataclasses by name, in
the place of ``Command``.

Exit codes: 0 done, 1 an error while working, 2 a wrong command line, 130 interrupted.
"""

import dataclasses
import difflib
import gc
import importlib
import inspect
import io
import json
import math
import os
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

from splatree.cli.plain import holds_all, printable, tolerant
from splatree.errors import InputError, OutputError, SplatreeError

VERBS = {
    "demo": "build, draw and judge a bundled piece of a real city",
    "info": "say what a scene holds",
    "check": "say whether files are whole: digests, values, levels",
    "train": "train a scene from photographs whose cameras are known",
    "convert": "write a scene in another format",
    "clean": "drop floaters and outliers",
    "thin": "merge Gaussians that are close, to a radius, a share or a count",
    "build": "build the levels of detail of a scene",
    "refine": "let the merged nodes of a tree learn from pictures of its leaves",
    "calibrate": "choose the opacity at which splats end, by a loss of quality that is allowed",
    "render": "draw pictures or a video",
    "view": "look at a scene in a browser",
    "stream": "write what viewers on the web load piece by piece",
    "serve": "serve streams to viewers on the web",
    "eval": "compare the levels of detail with all leaves, or with photographs",
    "simulate": "simulate an accelerator on the frames of a scene, cycle by cycle",
    "rtl": "write circuits of the accelerator as Verilog",
    "bench": "run a table or a figure of a paper again",
    "formats": "list the formats that are read and written",
    "doctor": "say what this machine can draw with: processor, GPU, driver, compiler",
}

GROUPS = ("bench",)
"""Verbs whose next word names one of several commands."""

USAGE = """usage: splatree <verb> [options]

{verbs}

splatree <verb> --help says more; every verb takes --json, --verbose and --quiet."""

GROUP_USAGE = """usage: splatree {verb} <command> [options]

{commands}

splatree {verb} <command> --help says more; every command takes --json, --verbose and --quiet."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code. Without ``argv`` it is the program itself that runs, once."""
    if argv is None:
        gc.disable()  # looking for garbage among what is being loaded takes a tenth of the start
        # NumPy's linear algebra would start a thread for each processor, which spin for a fifth of the start before they sleep;
        # no verb has work for them, the kernels have threads of their own.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    tolerant()
    try:
        return _main(list(sys.argv[1:] if argv is None else argv))
    except KeyboardInterrupt:
        _complain("splatree: interrupted")
        return 130
    except BrokenPipeError:  # the reader of our output has left, as `head` does
        _drop_output()
        return 0
    except OutputError as error:  # of the output itself
        _drop_output()
        _complain(f"splatree: error: {error}")
        return 1


def _main(words: list[str]) -> int:
    usage = USAGE.format(verbs="\n".join(f"  {verb:11}{purpose}" for verb, purpose in VERBS.items()))
    if words[:1] == ["help"] and len(words) > 1 and words[1] != "help":  # splatree help render
        words = [*words[1:], "--help"]
    if not words or words[0] in ("-h", "--help", "help"):
        _say(usage)
        return 0
    if words[0] in ("-V", "--version", "version"):
        from splatree.version import program_version

        _say(f"splatree {program_version()}")
        return 0
    if words[0] not in VERBS and Path(words[0]).exists():
        _complain(f"splatree: error: found the path {words[0]!r}, wanted a verb before it: splatree info {words[0]}")
        return 2
    if words[0] not in VERBS:
        _complain(f"splatree: error: found {words[0]!r}, wanted one of {', '.join(VERBS)}{_meant(words[0], VERBS)}")
        return 2
    module = importlib.import_module(f"splatree.cli.{words[0]}")
    if words[0] in GROUPS:
        return _run_one_of(words[0], words[1:], module)
    return _run(words[0], words[1:], module, module.Command, None)


def _run_one_of(verb: str, words: list[str], module: Any) -> int:
    """The command of a group that the next word names."""
    purposes = {name: _purpose_of(command) for name, command in module.COMMANDS.items()}
    room = max(map(len, purposes)) + 1
    lines = "\n".join(f"  {name:{room}}{purpose.splitlines()[0]}" for name, purpose in purposes.items())
    usage = GROUP_USAGE.format(verb=verb, commands=lines)
    if not words or words[0] in ("-h", "--help", "help"):
        _say(usage)
        return 0
    if words[0] not in purposes:
        _complain(
            f"splatree {verb}: error: found {words[0]!r}, wanted one of {', '.join(purposes)}{_meant(words[0], purposes)}"
        )
        return 2
    return _run(f"{verb} {words[0]}", words[1:], module, module.COMMANDS[words[0]], purposes[words[0]])


def _meant(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def commands_of(group: str) -> list[str]:
    """Names of the commands of a group."""
    return list(importlib.import_module(f"splatree.cli.{group}").COMMANDS)


def _purpose_of(command: Any) -> str:
    """The docstring of the options that a command of a group is made of."""
    (options,) = get_args(command)
    return inspect.cleandoc(options.__doc__)


def _run(verb: str, words: list[str], module: Any, command_type: Any, description: str | None) -> int:
    from splatree.cli.console import UsageError, progress_shown

    command = _parsed(verb, words, command_type, description)
    if isinstance(command, int):
        return command
    console = command.console
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    try:
        with progress_shown(console):
            result = module.run(command)
        text = _text_of(result, module, console)
    except UsageError as error:
        _complain(f"splatree {verb}: error: {error}")
        return 2
    except Exception as error:
        if console.verbose and sys.stderr is not None:
            traceback.print_exc()
        _complain(f"splatree {verb}: error: {_message(error)}")
        return 1
    if text:
        _say(text)
    return 0


def _parsed(verb: str, words: list[str], command_type: Any, description: str | None) -> Any:
    """The command that the words ask for; or an exit code, if the help was asked for or a word is wrong."""
    import tyro

    from splatree.cli.console import UsageError
    from splatree.cli.words import options_of, sorted_words

    try:
        words = sorted_words(words, options_of(command_type))
    except UsageError as error:
        _complain(f"splatree {verb}: error: {error}")
        return 2
    if words == ["--help"]:
        from splatree.cli.help import help_of

        _say(help_of(verb, command_type, description))
        return 0
    said = io.StringIO()
    try:
        with _defaults_trusted(), redirect_stderr(said):
            return tyro.cli(
                command_type,
                prog=f"splatree {verb}",
                description=description,
                args=words,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
            )
    except SystemExit as stop:  # tyro has said what is wrong
        refused = _refused_in(stop)
        _complain(said.getvalue().rstrip() if refused is None else f"splatree {verb}: error: {refused}")
        return int(stop.code or 0)
    except InputError as error:  # a value that its option refuses
        _complain(f"splatree {verb}: error: {error}")
        return 2


def _refused_in(stop: BaseException) -> InputError | None:
    """The error of a struct within another one, which tyro puts into a box and ends with."""
    cause = stop.__context__
    while cause is not None and not isinstance(cause, InputError):
        cause = cause.__context__
    return cause


def _text_of(result: Any, module: Any, console: Any) -> str:
    """What is printed of a result: JSON, or words, or nothing."""
    if console.json:
        text = json.dumps(_plain(result), indent=2, ensure_ascii=False, allow_nan=False)
        if sys.stdout is None or holds_all(sys.stdout, text):
            return text
        return json.dumps(_plain(result), indent=2, allow_nan=False)  # JSON has a spelling for all characters
    if console.quiet:
        return ""
    says_more = console.verbose and "verbose" in inspect.signature(module.show).parameters
    return str(module.show(result, verbose=True) if says_more else module.show(result))


@contextmanager
def _defaults_trusted() -> Iterator[None]:
    """Let tyro take the defaults of tuples as they are.

    tyro would load typeguard, which takes a fifth of the start, to check the defaults against their types. The type checker has
    done so. tyro has no option to leave the check out, so a stand-in under the name of the module is the only way.
    """
    if "typeguard" in sys.modules:
        yield
        return
    stand_in: Any = ModuleType("typeguard")
    stand_in.check_type, stand_in.TypeCheckError = lambda value, expected_type: value, TypeError
    sys.modules["typeguard"] = stand_in
    try:
        yield
    finally:
        del sys.modules["typeguard"]


def _say(text: str) -> None:
    """Print on stdout, if there is one."""
    if sys.stdout is None:
        return
    try:
        print(printable(text, sys.stdout), flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise _unwritable(error) from error


def _complain(text: str) -> None:
    """Print on stderr, if there is one."""
    if sys.stderr is not None:  # None would print on stdout
        with suppress(OSError):  # it may be full, or its reader gone: then there is nobody to tell
            print(printable(text, sys.stderr), file=sys.stderr, flush=True)


def _unwritable(error: OSError) -> OutputError:
    return OutputError(f"standard output: could not be written ({error.strerror})")


def _drop_output() -> None:
    """Let what is left in the buffer of stdout go nowhere when the interpreter flushes it at its end."""
    if sys.stdout is not None:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _message(error: Exception) -> str:
    if isinstance(error, SplatreeError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
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
