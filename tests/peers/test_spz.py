"""splat-transform (with the format's own library inside), gsply and GaussForge read the .spz that we write, and we theirs."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import splatree
from splatree import Scene, WriteOptions

TOOL = shutil.which("splat-transform")
BUNDLED = Path(splatree.__file__).parent / "data" / "semarang_5_9.sog"


@pytest.fixture(scope="module")
def few():
    scene = splatree.read(BUNDLED)
    return scene.gaussians.take(np.arange(0, len(scene), 97))


def check_same(ours, theirs):
    np.testing.assert_array_equal(ours.means, theirs.means)
    np.testing.assert_array_equal(ours.log_scales, theirs.log_scales)
    np.testing.assert_allclose(ours.logit_opacities, theirs.logit_opacities, atol=1e-5)
    np.testing.assert_allclose(ours.sh, theirs.sh, atol=1e-6)
    # q and −q are one rotation. A component that lies on a step may be rounded either way, by one of 511 steps to √½.
    cosines = np.abs((ours.quats.astype(np.float64) * theirs.quats).sum(axis=1))
    assert (cosines > 1 - 3 * (np.sqrt(0.5) / 511) ** 2).all()


@pytest.mark.skipif(TOOL is None, reason="splat-transform is not installed")
@pytest.mark.parametrize("version", [2, 3, 4])
def test_splat_transform_reads_ours(tmp_path, few, version):
    splatree.write(Scene.flat(few), tmp_path / "a.spz", options=WriteOptions(format_version=version))
    subprocess.run([str(TOOL), "-q", tmp_path / "a.spz", tmp_path / "b.ply"], check=True, capture_output=True)
    check_same(splatree.read(tmp_path / "a.spz").gaussians, splatree.read(tmp_path / "b.ply").gaussians)


@pytest.mark.skipif(TOOL is None, reason="splat-transform is not installed")
@pytest.mark.parametrize("version", [3, 4])
def test_ours_has_the_codes_of_the_formats_own_library(tmp_path, few, version):
    splatree.write(Scene.flat(few), tmp_path / "a.ply")
    splatree.write(Scene.flat(few), tmp_path / "a.spz", options=WriteOptions(format_version=version, sh_bits=4))
    command = [str(TOOL), "-q", "--spz-version", str(version), tmp_path / "a.ply", tmp_path / "b.spz"]
    subprocess.run(command, check=True, capture_output=True)
    check_same(*(splatree.read(tmp_path / name).gaussians for name in ("a.spz", "b.spz")))


@pytest.mark.parametrize("version", [3, 4])
def test_gsply_reads_ours_and_we_read_its(tmp_path, few, version):
    gsply = pytest.importorskip("gsply", reason="gsply is not installed")
    splatree.write(Scene.flat(few), tmp_path / "a.spz", options=WriteOptions(format_version=version))
    theirs, ours = gsply.read_spz(tmp_path / "a.spz"), splatree.read(tmp_path / "a.spz").gaussians
    np.testing.assert_array_equal(theirs.means, ours.means)
    np.testing.assert_allclose(theirs.shN, ours.sh[:, 1:], atol=1e-6)
    np.testing.assert_allclose(theirs.quats, ours.quats, atol=1e-5)
    gsply.write_spz(tmp_path / "b.spz", theirs, version=version)
    check_same(ours, splatree.read(tmp_path / "b.spz").gaussians)


@pytest.mark.skipif(sys.platform == "win32", reason="its wheel is not tested there")
@pytest.mark.parametrize("version", [2, 3, 4])
def test_gaussforge_reads_ours(tmp_path, few, version):
    gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is not installed")
    splatree.write(Scene.flat(few), tmp_path / "a.spz", options=WriteOptions(format_version=version))
    theirs, ours = (
        gaussforge.GaussForge().read((tmp_path / "a.spz").read_bytes(), "spz"),
        splatree.read(tmp_path / "a.spz"),
    )
    data = theirs["data"]
    assert data["numPoints"] == len(few)
    np.testing.assert_array_equal(np.frombuffer(data["positions"], "<f4"), ours.gaussians.means.reshape(-1))
    np.testing.assert_array_equal(np.frombuffer(data["sh"], "<f4"), ours.gaussians.sh[:, 1:].reshape(-1))
