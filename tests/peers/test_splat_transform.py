"""splat-transform (PlayCanvas) reads what we write, and decodes SOG to the same bits. Needs its command on the PATH:
``npm install --global @playcanvas/splat-transform``."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import splatree
from splatree import Gaussians, Scene, WriteOptions

TOOL = shutil.which("splat-transform")
COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
BUNDLED = Path(splatree.__file__).parent / "data" / "semarang_5_9.sog"

pytestmark = pytest.mark.skipif(TOOL is None, reason="splat-transform is not installed")


def convert(source: Path, target: Path) -> Gaussians:
    subprocess.run([str(TOOL), "-q", str(source), str(target)], check=True, capture_output=True)
    return splatree.read(target).gaussians


def test_sog_decodes_to_the_same_bits(tmp_path):
    ours = splatree.read(BUNDLED).gaussians
    theirs = convert(BUNDLED, tmp_path / "a.ply")
    assert all(getattr(ours, c).tobytes() == getattr(theirs, c).tobytes() for c in COLUMNS)


def test_our_ply_and_splat_are_read(tmp_path):
    scene = splatree.read(BUNDLED)
    few = scene.gaussians.take(np.arange(0, len(scene), 97))
    splatree.write(Scene.flat(few), tmp_path / "a.ply")
    theirs = convert(tmp_path / "a.ply", tmp_path / "b.ply")
    assert all(getattr(few, c).tobytes() == getattr(theirs, c).tobytes() for c in COLUMNS)

    splatree.write(Scene.flat(few), tmp_path / "a.splat")
    ours = splatree.read(tmp_path / "a.splat").gaussians
    theirs = convert(tmp_path / "a.splat", tmp_path / "c.ply")
    np.testing.assert_array_equal(ours.means, theirs.means)
    np.testing.assert_allclose(ours.log_scales, theirs.log_scales, atol=1e-6)  # rounding of the logarithm
    np.testing.assert_allclose(ours.logit_opacities, theirs.logit_opacities, atol=1e-5)
    np.testing.assert_allclose(ours.sh, theirs.sh, atol=1e-6)
    # The peer takes a code u for (u − 127.5) / 127.5, the format's own viewer and we for (u − 128) / 128: half a code apart.
    unit = ours.quats / np.linalg.norm(ours.quats, axis=1, keepdims=True)
    np.testing.assert_allclose(unit, theirs.quats, atol=1 / 128)


def test_our_sog_decodes_to_the_same_bits(tmp_path):
    scene = splatree.read(BUNDLED)
    few = scene.gaussians.take(np.arange(0, len(scene), 97))
    splatree.write(Scene.flat(few), tmp_path / "a.sog", options=WriteOptions(sh_palette=300))
    ours = splatree.read(tmp_path / "a.sog").gaussians
    theirs = convert(tmp_path / "a.sog", tmp_path / "b.ply")
    assert all(getattr(ours, c).tobytes() == getattr(theirs, c).tobytes() for c in COLUMNS)
