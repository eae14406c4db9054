"""A file and a folder of parts with many pages, which tests of this folder share."""

from itertools import product
from pathlib import Path
from unittest import mock

import pytest

import splatree as st
from splatree.io.pages import table as pages

from ..laws.hard_scenes import hard_scene


@pytest.fixture(scope="session")
def ply(tmp_path_factory):
    """A scene of a few hundred rows in a file."""
    path = tmp_path_factory.mktemp("inputs") / "scene.ply"
    st.write(st.Scene.flat(hard_scene(700, "surface", 3, degree=1)), path)
    return path


def small_pages(rows):
    """Pages of so many rows, or a few more, as long as the context lasts."""
    return mock.patch.object(pages, "PAGE_BYTES", rows * 100)  # a row of degree 0 has about as much


def check_is_drawn_as_the_whole_tree(path: Path):
    """Pictures of a folder that is drawn from disk are those of its tree in memory, bit for bit."""
    tree = st.read(path)
    views = st.orbit(tree, st.PathOptions(views=2, width=64, height=48))
    with st.open_store(path) as store, st.open_session(store) as session:
        for view, pixel_error in product(views, (1.0, 8.0)):
            select = st.SelectOptions(pixel_error=pixel_error)
            found, wanted = session.draw(view, select=select), st.render(tree, view, select=select)
            assert found.image.tobytes() == wanted.image.tobytes()


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A folder of many parts and pages; tests that change it copy it."""
    path = tmp_path_factory.mktemp("store") / "in.ply"
    st.write(st.Scene.flat(hard_scene(3000, "surface", 3, degree=2)), path)
    options = st.BuildOptions(radius=0.1, max_roots=4)
    with small_pages(60):
        return st.build_folder(path, path.with_name("city.splatree"), options, st.FolderOptions(part_rows=500)).path


@pytest.fixture(scope="session")
def scene(folder):
    """What the folder holds, in memory."""
    return st.read(folder)
