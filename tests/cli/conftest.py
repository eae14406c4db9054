import signal
from importlib.resources import as_file, files

import numpy as np
import pytest

from splatree.cli.main import main
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.render.build import build_lod
from splatree.scene.scene import Scene


@pytest.fixture(scope="session")
def small_scene():
    """The bundled scene, less all but each 80th Gaussian: 3,161 real ones."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        scene = read(path)
    return Scene.flat(scene.gaussians.take(np.arange(0, len(scene), 80)))


@pytest.fixture(scope="session")
def small_ply(small_scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.ply"
    write(small_scene, path)
    return path


@pytest.fixture(scope="session")
def small_tree(small_scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.splatree"
    write(build_lod(small_scene), path)
    return path


@pytest.fixture
def splatree(capsys):
    """Run a command line in this process: exit code, stdout, stderr."""

    def run(*words):
        capsys.readouterr()
        code = main([str(word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def listen_to_interruptions():
    """What a shell starts in the background ignores interruptions, and so do its children; the suite may be such a one."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
