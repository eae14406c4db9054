"""Docstrings of public names have one form, and their examples run.

A function: summary, Args with each parameter, Returns or Yields, Raises if it checks its input, Source if it follows a paper,
Example.
A class: summary, Example, and a docstring under each field, public property and method.
"""

import ast
import doctest
import inspect
import re
from dataclasses import is_dataclass

import numpy as np
import pytest

import splatree as st

NAMES = list(st.__all__)
FUNCTIONS = [name for name in NAMES if inspect.isfunction(getattr(st, name))]
CLASSES = [name for name in NAMES if inspect.isclass(getattr(st, name))]
SECTIONS = ("Args", "Returns", "Yields", "Raises", "Source", "Example")

FOLLOWS_A_PAPER = {
    "baseline", "build_clusters", "calibrate", "contribution_histogram", "cull", "merge", "select", "simulate", "ssim",
    "thin", "tile_contributions",
}  # fmt: skip
"""Functions whose method is published."""


def sections(name):
    """The summary under the empty name, and the text of each section."""
    doc = inspect.getdoc(getattr(st, name)) or ""
    parts = re.split(rf"^({'|'.join(SECTIONS)}):\n", doc, flags=re.MULTILINE)
    return {"": parts[0]} | dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_says_all_that_a_caller_needs(name):
    found = sections(name)
    signature = inspect.signature(inspect.unwrap(getattr(st, name)))
    assert re.match(r"[A-Z].*[.:]", found[""].splitlines()[0]), "the summary is one line, a sentence"
    assert re.findall(r"^    (\w+): ", found["Args"], flags=re.MULTILINE) == list(signature.parameters)
    assert "Returns" in found or "Yields" in found or signature.return_annotation in (None, "None")
    assert list(found) == ["", *(section for section in SECTIONS if section in found)], "sections in their order"
    assert "Source" in found or name not in FOLLOWS_A_PAPER


def test_functions_that_check_their_input_say_what_they_raise():
    silent = {name for name in FUNCTIONS if "Raises" not in sections(name)}
    assert silent <= {"calibrated", "frame_counters", "tile_contributions", "turn"}, "these check nothing"


@pytest.mark.parametrize("name", CLASSES)
def test_class_says_what_each_field_is(name):
    kind = getattr(st, name)
    assert re.match(r"[A-Z].*[.:]", sections(name)[""].splitlines()[0]), "the summary is one line, a sentence"
    body = ast.parse(inspect.getsource(kind).lstrip()).body[0].body
    silent = []
    for i, statement in enumerate(body):
        if isinstance(statement, ast.FunctionDef) and not statement.name.startswith("_"):
            if any(ast.unparse(decorator).endswith(".setter") for decorator in statement.decorator_list):
                continue  # its property says what it is
            silent += [statement.name] if ast.get_docstring(statement) is None else []
        if is_dataclass(kind) and isinstance(statement, ast.AnnAssign) and not statement.target.id.startswith("_"):
            after = body[i + 1] if i + 1 < len(body) else None
            documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            silent += [] if documented else [statement.target.id]
    assert silent == []


@pytest.mark.parametrize("name", NAMES)
def test_example_runs(name, shown_folder):
    example = sections(name)["Example"]
    cameras = st.read_cameras("cameras.json")
    given = {"st": st, "np": np, "scene": st.read("city.splatree"), "cameras": cameras, "camera": cameras[0]}
    test = doctest.DocTestParser().get_doctest(inspect.cleandoc(example), given, name, None, 0)
    assert test.examples
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
    report = []
    doctest.DocTestRunner(optionflags=options, verbose=False).run(test, out=report.append)
    assert report == [], "".join(report)
