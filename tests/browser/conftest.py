from importlib.resources import as_file, files

import pytest

from splatree.io.reading import read
from splatree.lod.build import build_lod


@pytest.fixture(scope="session")
def city_tree():
    """The bundled scene with levels of detail."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        return build_lod(read(path))
