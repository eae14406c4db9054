import ast
import dataclasses
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import splatree


def test_public_names_are_sorted_and_can_be_loaded():
    assert splatree.__all__ == sorted(splatree.__all__)
    assert dir(splatree) == splatree.__all__
    for name in splatree.__all__:
        assert not inspect.ismodule(getattr(splatree, name))
        assert getattr(splatree, name).__name__ == name


def test_public_structs_are_frozen():
    """Shapes are checked once, when a struct is made; they hold because nothing is replaced in it afterwards."""
    structs = [value for name in splatree.__all__ if dataclasses.is_dataclass(value := getattr(splatree, name))]
    assert len(structs) > 20
    assert [struct.__name__ for struct in structs if not struct.__dataclass_params__.frozen] == []


def test_type_checkers_see_the_names_that_are_loaded():
    tree = ast.parse(Path(splatree.__file__).with_suffix(".pyi").read_text())
    imports = [statement for statement in tree.body if isinstance(statement, ast.ImportFrom)]
    seen = {alias.asname: statement.module for statement in imports for alias in statement.names}
    assert seen == splatree._HOME, "run scripts/names"


def test_a_name_is_listed_once():
    listed = [name for names in splatree._NAMES.values() for name in names]
    assert sorted(listed) == splatree.__all__
    assert list(splatree._NAMES) == sorted(splatree._NAMES)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'renderer'"):
        splatree.renderer  # noqa: B018


@pytest.mark.parametrize("first", ["splatree.render.paths", "splatree.render", "splatree.cli.demo"])
def test_render_is_the_function_whatever_is_imported_first(first):
    code = f"import {first}, splatree; print(splatree.render.__name__, callable(splatree.render))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["render", "True"]


def test_public_names_say_what_they_are():
    silent = [name for name in splatree.__all__ if not inspect.getdoc(getattr(splatree, name))]
    assert silent == []


def test_import_loads_nothing_heavy():
    heavy = ("numpy", "PIL", "rich", "safetensors", "torch", "tyro", "imageio_ffmpeg", "splatree.cli")
    code = f"import sys, splatree; print(*(name for name in {heavy} if name in sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
