"""splat-transform (PlayCanvas) moves a scene as we do, harmonics included. Needs its command on the PATH:
``npm install --global @playcanvas/splat-transform``."""

import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest

import splatree
from splatree import EditOptions, Scene, edit

TOOL = shutil.which("splat-transform")

pytestmark = pytest.mark.skipif(TOOL is None, reason="splat-transform is not installed")


@pytest.mark.parametrize(
    ("words", "edits"),
    [
        # The peer's axes are those of its engine, half a turn about z from those of the file: x and y change their sign.
        (("-r", "10,20,30"), EditOptions(rotate=(-10.0, -20.0, 30.0))),
        (("-s", "2.5", "-t", "1,2,3"), EditOptions(scale=2.5, translate=(-1.0, -2.0, 3.0))),
        (("-s", "0.3", "-r", "100,-70,5"), EditOptions(scale=0.3, rotate=(-100.0, 70.0, 5.0))),
        (("-H", "1"), EditOptions(sh_degree=1)),
    ],
)
def test_the_peer_moves_a_scene_to_the_same_place(tmp_path, words, edits):
    g = splatree.read(str(files("splatree") / "data" / "semarang_5_9.sog")).gaussians
    few = Scene.flat(g.take(np.arange(0, len(g), 997)))
    splatree.write(few, tmp_path / "a.ply")
    subprocess.run([str(TOOL), "-q", tmp_path / "a.ply", *words, tmp_path / "b.ply"], check=True, capture_output=True)
    theirs, ours = splatree.read(tmp_path / "b.ply").gaussians, edit(few, edits).gaussians
    # Means of up to 2000, some roundings of float32; the peer computes in float32 as well.
    np.testing.assert_allclose(ours.means, theirs.means, atol=1e-3)
    np.testing.assert_allclose(ours.log_scales, theirs.log_scales, atol=2e-6)
    np.testing.assert_allclose(ours.sh, theirs.sh, atol=5e-6)
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (ours.quats, theirs.quats))
    np.testing.assert_allclose(np.abs((a * b).sum(axis=1)), 1, atol=1e-6)
