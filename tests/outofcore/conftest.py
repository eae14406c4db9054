"""What tests of builds through files share."""

import pytest

import splatree as st

from ..laws.hard_scenes import hard_scene


@pytest.fixture(scope="session")
def ply(tmp_path_factory):
    """A scene of a few hundred rows in a file."""
    path = tmp_path_factory.mktemp("inputs") / "scene.ply"
    st.write(st.Scene.flat(hard_scene(700, "surface", 3, degree=1)), path)
    return path
