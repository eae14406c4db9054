import json

import numpy as np
import pytest

import splatree
from splatree import FormatError, Gaussians, Scene
from splatree.constants import SH_C0
from splatree.io.chunks import chunks_of
from splatree.io.writing import write_chunks
from splatree.maths.rotations import matrices_from_quats

from ..scenes import random_gaussians


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def test_round_trip_is_within_a_quantum(tmp_path):
    g = random_gaussians(500, 0)
    splatree.write(Scene.flat(g), tmp_path / "a.splat")
    assert (tmp_path / "a.splat").stat().st_size == 500 * 32
    b = splatree.read(tmp_path / "a.splat").gaussians
    rows = np.lexsort(g.means.T)[
        np.argsort(np.lexsort(b.means.T))
    ]  # rows of g in the order of the file, by exact means
    g = g.take(rows)
    np.testing.assert_array_equal(g.means, b.means)
    np.testing.assert_allclose(b.log_scales, g.log_scales, atol=1e-6)  # float32 rounding of exp and log
    np.testing.assert_allclose(sigmoid(b.logit_opacities), sigmoid(g.logit_opacities), atol=0.5 / 255 + 1e-6)
    colors = np.clip(0.5 + SH_C0 * g.sh[:, 0], 0, 1)
    np.testing.assert_allclose(0.5 + SH_C0 * b.sh[:, 0], colors, atol=0.5 / 255 + 1e-6)
    # Each of three free components is off by at most 1/256: 2 √3 / 256 rad = 0.78 degrees.
    turn = matrices_from_quats(g.quats) @ np.swapaxes(matrices_from_quats(b.quats), 1, 2)
    angles = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angles.max() < 0.8


def test_clipped_colours_are_counted(tmp_path):
    g = random_gaussians(5, 0)
    g.sh[:] = 0
    g.sh[[1, 3], 0, 2] = (3, -2)
    g.sh[4, 0, 0] = 0.5 / SH_C0  # a colour of 1
    one = splatree.write(Scene.flat(g.take(np.arange(2))), tmp_path / "one.splat")
    assert "the colours of 1 Gaussian: splat clips them to 0 to 1" in one
    lost = splatree.write(Scene.flat(g), tmp_path / "a.splat")
    assert "the colours of 2 Gaussians: splat clips them to 0 to 1" in lost
    assert not any(
        "clips" in said for said in splatree.write(splatree.read(tmp_path / "a.splat"), tmp_path / "b.splat")
    )


def test_what_was_read_is_written_back_byte_for_byte(tmp_path):
    """Codes are fixed points: colours, opacities and rotations survive any number of round trips."""
    splatree.write(Scene.flat(random_gaussians(300, 0)), tmp_path / "a.splat")
    first = splatree.read(tmp_path / "a.splat")
    splatree.write(first, tmp_path / "b.splat")
    a, b = ((tmp_path / name).read_bytes() for name in ("a.splat", "b.splat"))
    codes = [np.frombuffer(x, np.uint8).reshape(-1, 32)[:, 24:28] for x in (a, b)]
    assert sorted(map(bytes, codes[0])) == sorted(map(bytes, codes[1]))


def test_rows_go_by_descending_opacity_times_volume(tmp_path):
    splatree.write(Scene.flat(random_gaussians(200, 0)), tmp_path / "a.splat")
    records = np.fromfile(tmp_path / "a.splat", np.uint8).reshape(-1, 32)
    scales, alpha = np.ascontiguousarray(records[:, 12:24]).view("<f4"), records[:, 27]
    volume = scales.prod(axis=1)
    low, high = volume * (alpha - 0.5), volume * (alpha + 0.5) * 1.000001  # what the rounded opacity may have been
    # Within a quarter of an octave rows keep their order.
    assert (low[1:] <= 2**0.25 * np.minimum.accumulate(high)[:-1]).all()


def test_rows_of_equal_rank_keep_their_order(tmp_path):
    g = random_gaussians(100, 0)
    g.log_scales[:], g.logit_opacities[:] = -3, 1
    splatree.write(Scene.flat(g), tmp_path / "a.splat")
    np.testing.assert_array_equal(splatree.read(tmp_path / "a.splat").gaussians.means, g.means)


def test_rows_that_wait_in_a_file_come_in_the_same_order(tmp_path, monkeypatch):
    scene = Scene.flat(random_gaussians(1000, 0))
    splatree.write(scene, tmp_path / "a.splat")
    monkeypatch.setattr("splatree.io.formats.splat.format._ROWS_IN_MEMORY", 300)
    monkeypatch.setattr("splatree.io.formats.splat.format._ROWS_PLACED", 70)
    splatree.write(scene, tmp_path / "b.splat")
    write_chunks(chunks_of(scene, rows=130), tmp_path / "c.splat")  # which do not fill the memory
    a, b, c = ((tmp_path / f"{name}.splat").read_bytes() for name in "abc")
    assert a == b == c and len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("sign", [1, -1])
def test_a_rotation_about_an_axis_is_exact(tmp_path, axis, sign):
    g = random_gaussians(1, 0)
    quats = np.zeros((1, 4), np.float32)
    quats[0, axis] = 3 * sign
    splatree.write(Scene.flat(Gaussians(g.means, quats, g.log_scales, g.logit_opacities, g.sh)), tmp_path / "a.splat")
    found = splatree.read(tmp_path / "a.splat").gaussians.quats[0]
    assert abs(found[axis]) == 1 and np.count_nonzero(found) == 1


def test_a_cut_off_file_is_refused_or_repaired(tmp_path):
    splatree.write(Scene.flat(random_gaussians(4, 0)), tmp_path / "a.splat")
    (tmp_path / "a.splat").write_bytes((tmp_path / "a.splat").read_bytes()[:-7])
    with pytest.raises(FormatError, match="found 121 bytes, wanted a multiple of 32"):
        splatree.read(tmp_path / "a.splat")
    scene = splatree.read(tmp_path / "a.splat", repair=True)
    assert len(scene) == 3 and json.loads(scene.source.metadata["repairs"]) == {"unexpected_bytes": 25}


def test_what_has_no_code_is_refused_before_a_file_is_made(tmp_path):
    g = random_gaussians(3, 0)
    g.quats[1] = 0
    with pytest.raises(FormatError, match="scene to write: row 1, quats"):
        splatree.write(Scene.flat(g), tmp_path / "a.splat")
    assert list(tmp_path.iterdir()) == []
