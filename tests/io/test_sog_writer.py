import json
import zipfile
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import splatree
from splatree import Gaussians, InputError, Scene, WriteOptions
from splatree.maths.rotations import matrices_from_quats

from ..scenes import random_gaussians
from .conftest import COLUMNS, same_bits
from .sog_files import write_sog


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def written(tmp_path, g, name="a.sog", **options):
    splatree.write(Scene.flat(g), tmp_path / name, options=WriteOptions(**options))
    return splatree.read(tmp_path / name).gaussians


def in_order_of(a, b):
    """Rows of ``a`` in the order of ``b``, found by the nearest mean."""
    distances = np.abs(a.means[None] - b.means[:, None]).sum(axis=2)
    assert len(set(distances.argmin(axis=1))) == len(a)
    return a.take(distances.argmin(axis=1))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [1, 5, 700])
def test_round_trip_is_within_the_quanta(tmp_path, n, degree):
    g = random_gaussians(n, degree)
    b = written(tmp_path, g)
    g = in_order_of(g, b)
    m, m_read = (np.sign(x) * np.log1p(np.abs(x)) for x in (g.means.astype(np.float64), b.means.astype(np.float64)))
    step = (m.max(axis=0) - m.min(axis=0)) / 65535
    assert (np.abs(m - m_read) <= 0.5 * step + 1e-6).all()  # and the rounding of float32 at 30 units
    np.testing.assert_allclose(sigmoid(b.logit_opacities), sigmoid(g.logit_opacities), atol=0.5 / 255 + 1e-6)
    # Three components in steps of √2 / 255: 2 · ½ · √2 √3 / 255 rad, and the largest one follows from them, 0.8 degrees at most.
    turn = matrices_from_quats(g.quats) @ np.swapaxes(matrices_from_quats(b.quats), 1, 2)
    angles = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angles.max() < 1.0
    # 256 values for a range of some 7 and 2: the densest parts get finer steps, and rows that nobody sees, small ones, coarser.
    assert np.abs(b.log_scales - g.log_scales).max() < 0.3
    assert np.sqrt(np.mean((b.log_scales - g.log_scales) ** 2)) < 0.01
    assert np.abs(b.sh[:, 0] - g.sh[:, 0]).max() < 0.05
    if n <= 5:  # a palette entry for each row; values by the codebook
        assert np.abs(b.sh - g.sh).max(initial=0) < 0.05


def test_rows_of_a_sog_are_written_without_loss(tmp_path):
    """Few different values: codebooks and palette hold them exactly."""
    write_sog(tmp_path / "s", n=700, bands=3, palette=70)
    a = splatree.read(tmp_path / "s").gaussians
    b = written(tmp_path, a)
    a = in_order_of(a, b)
    for name in ("log_scales", "logit_opacities", "sh"):
        assert same_bits(getattr(a, name), getattr(b, name)), name
    # Half a step of the logarithm, 3 / 65535 here, times 1 + |x| of up to e³; and as much again from the other range.
    np.testing.assert_allclose(a.means, b.means, atol=1e-3)


def test_a_folder_holds_what_a_bundle_holds(tmp_path):
    scene = Scene.flat(random_gaussians(300, degree=2))
    splatree.write(scene, tmp_path / "s.sog")
    splatree.write(scene, tmp_path / "folder" / "meta.json")
    bundle, folder = splatree.read(tmp_path / "s.sog"), splatree.read(tmp_path / "folder")
    assert folder.source.format == "sog"
    assert all(same_bits(getattr(folder.gaussians, c), getattr(bundle.gaussians, c)) for c in COLUMNS)


def test_another_scene_in_the_folder_is_whole_until_it_is_replaced(tmp_path, monkeypatch):
    target = tmp_path / "folder" / "meta.json"
    splatree.write(Scene.flat(random_gaussians(20)), target)
    before = splatree.read(target.parent)
    other = Scene.flat(random_gaussians(30))
    with pytest.raises(splatree.OutputError, match="exists already"):
        splatree.write(other, target)
    monkeypatch.setattr(
        "splatree.io.formats.sog.writer.json.dumps", lambda meta, **_: 1 / 0
    )  # fails when all pictures are written
    with pytest.raises(ZeroDivisionError):
        splatree.write(other, target, force=True)
    monkeypatch.undo()
    after = splatree.read(target.parent)
    assert all(same_bits(getattr(after.gaussians, c), getattr(before.gaussians, c)) for c in COLUMNS)
    splatree.write(other, target, force=True)
    assert len(splatree.read(target.parent)) == 30


def test_equal_scenes_give_equal_files(tmp_path):
    for name in ("a.sog", "b.sog"):
        written(tmp_path, random_gaussians(300, 1), name)
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_the_mode_is_kept(tmp_path, mode):
    splatree.write(Scene.flat(random_gaussians(9, 0), mode=mode), tmp_path / "a.sog")
    assert splatree.read(tmp_path / "a.sog").mode == mode


def test_an_empty_scene(tmp_path):
    assert len(written(tmp_path, Gaussians.empty(3))) == 0


def test_extremes(tmp_path):
    g = random_gaussians(40, 1)
    g.means[0] = (1e15, -1e15, 0)
    g.log_scales[1] = (-30, 30, 0)
    g.logit_opacities[2:4] = (-80, 80)
    g.sh[4] = 1e6
    b = written(tmp_path, g)
    assert b.means.max() > 0.99e15 and b.log_scales.max() > 29
    assert sigmoid(b.logit_opacities).min() < 1e-5


def test_the_palette_has_the_size_that_was_asked_for(tmp_path):
    written(tmp_path, random_gaussians(500, 2), sh_palette=40, iterations=1)
    with zipfile.ZipFile(tmp_path / "a.sog") as bundle:
        rest = json.loads(bundle.read("meta.json"))["shN"]
        assert rest["count"] == 40 and rest["bands"] == 2
        size = Image.open(BytesIO(bundle.read(rest["files"][0]))).size
    assert size == (64 * 8, 1)


@pytest.mark.parametrize("wrong", [{"sh_palette": 0}, {"sh_palette": 65537}, {"iterations": -1}, {"sh_bits": 4}])
def test_options_that_cannot_be(tmp_path, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        written(tmp_path, random_gaussians(9, 1), **wrong)
    assert not list(tmp_path.iterdir())


def test_values_without_a_code_are_refused(tmp_path):
    g = random_gaussians(9, 1)
    g.means[3, 1] = np.nan
    with pytest.raises(InputError, match=r"row 3, means\[1\]"):
        written(tmp_path, g)


def test_columns_are_complete(tmp_path):
    b = written(tmp_path, random_gaussians(70, 3))
    assert all(len(getattr(b, name)) == 70 and np.isfinite(getattr(b, name)).all() for name in COLUMNS)
