from importlib.resources import as_file, files

import pytest

from splatree.io.reading import read
from splatree.lod.options import BuildOptions
from splatree.render.build import build_lod
from splatree.view.options import ViewOptions
from splatree.view.viewer import Viewer

from .chromium import chromium


@pytest.fixture(scope="session")
def city_tree():
    """The bundled scene with levels of detail."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        return build_lod(read(path), BuildOptions("radius"))


@pytest.fixture(scope="module")
def viewer(city_tree):
    """The bundled scene on show."""
    with Viewer(city_tree, ViewOptions(budget=60_000)) as made:
        yield made


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """A browser that the tests of a module share."""
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def browser(program):
    """A browser without tabs; those that a test opens are closed at its end, however it ends."""
    yield program
    program.close_pages()
