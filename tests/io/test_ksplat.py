import numpy as np
import pytest

import splatree
from splatree import FormatError, InputError, Scene, WriteOptions
from splatree.constants import SH_C0

from ..scenes import random_gaussians
from .conftest import same_bits


def rows_in_buckets(g):
    """The row at each place of a file: by blocks, along x first; those of full buckets before the last ones of each block."""
    size = float(np.float32(min(5.0, 1310 * np.exp(np.median(np.sort(g.log_scales)[:, 1])))))
    blocks = np.floor((g.means - g.means.min(axis=0).astype(np.float64)) / size)
    order = np.lexsort(blocks.T)
    _, start, sizes = np.unique(blocks[order][:, ::-1], axis=0, return_index=True, return_counts=True)
    is_partial = np.arange(len(g)) - np.repeat(start, sizes) >= np.repeat(sizes // 256 * 256, sizes)
    return np.concatenate([order[~is_partial], order[is_partial]])


def sigmoid(x):
    return 1 / (1 + np.exp(-x.astype(np.float64)))


def unit(quats):
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def written(tmp_path, g, level):
    lost = splatree.write(Scene.flat(g), tmp_path / "a.ksplat", force=True, options=WriteOptions(compression=level))
    return splatree.read(tmp_path / "a.ksplat").gaussians, lost


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_floats_keep_their_bits_at_level_0(tmp_path, degree):
    g = random_gaussians(300, degree)
    b, lost = written(tmp_path, g, 0)
    kept = min(degree, 2)
    assert same_bits(b.means, g.means) and same_bits(b.sh[:, 1:], g.sh[:, 1 : (kept + 1) ** 2])
    np.testing.assert_allclose(b.log_scales, g.log_scales, atol=1e-6)  # rounding of exp and log
    np.testing.assert_allclose(b.quats, unit(g.quats), atol=1e-6)
    assert any("degree 3" in sentence for sentence in lost) == (degree == 3)


@pytest.mark.parametrize("level", [1, 2])
def test_round_trip_is_within_a_quantum(tmp_path, level):
    g = random_gaussians(3000, 2)
    b, _ = written(tmp_path, g, level)
    g = g.take(rows_in_buckets(g))
    # Half of 1/32767 of half a block of 5, and the rounding of the centre to float32.
    assert np.abs(b.means - g.means).max() <= 2.5 / 32767 / 2 + 4e-6
    np.testing.assert_allclose(np.exp(b.log_scales), np.exp(g.log_scales), rtol=2**-11, atol=2**-25)  # half precision
    np.testing.assert_allclose(b.quats, unit(g.quats), atol=2**-12)
    np.testing.assert_allclose(sigmoid(b.logit_opacities), sigmoid(g.logit_opacities), atol=0.51 / 255 + 1e-6)
    colors = np.clip(0.5 + SH_C0 * g.sh[:, 0], 0, 1)
    np.testing.assert_allclose(0.5 + SH_C0 * b.sh[:, 0], colors, atol=0.51 / 255)
    rest = g.sh[:, 1:]
    step = max(rest.max() / 127, -rest.min() / 128)
    tolerance = {"rtol": 2**-11, "atol": 2**-25} if level == 1 else {"atol": step / 2 + 1e-6}
    np.testing.assert_allclose(b.sh[:, 1:], rest, **tolerance)


def test_harmonics_go_degree_by_degree_and_channel_by_channel(tmp_path):
    g = random_gaussians(1, 2)
    g.sh[0, 1:, :] = (10 * np.arange(8)[:, None] + np.arange(3)).astype(np.float32)  # 10 coefficient + channel
    splatree.write(Scene.flat(g), tmp_path / "a.ksplat", options=WriteOptions(compression=0))
    rest = np.frombuffer((tmp_path / "a.ksplat").read_bytes(), "<f4", 24, 4096 + 1024 + 44)
    red, green, blue = (10 * np.arange(3, 8) + channel for channel in range(3))
    np.testing.assert_array_equal(rest, [0, 10, 20, 1, 11, 21, 2, 12, 22, *red, *green, *blue])


@pytest.mark.parametrize("level", [0, 1, 2])
def test_files_of_its_own_tool_agree_with_their_source(data, level):
    """The block by GaussianSplats3D, which dropped the 37 Gaussians of opacity below 1/255 and truncates colours."""
    source = splatree.read(data / "formats/semarang_block/block_inria.ply").gaussians
    found = splatree.read(data / f"formats/semarang_block/block_c{level}.ksplat").gaussians
    assert len(found) == int((sigmoid(source.logit_opacities) * 255 >= 1).sum()) == 29176
    kept = source.take(sigmoid(source.logit_opacities) * 255 >= 1)

    def by_place(g):  # rows stand by buckets in the file: pair them on a grid far coarser than the codes
        return g.take(np.lexsort(np.rint(g.means.T.astype(np.float64) / 2e-3)))

    kept, found = by_place(kept), by_place(found)
    near = np.abs(kept.means - found.means).max(axis=1) < 5e-5
    assert near.mean() > 0.97  # a few fall into another cell of the sort
    kept, found = kept.take(near), found.take(near)
    np.testing.assert_allclose(found.means, kept.means, atol=0 if level == 0 else 2.5 / 32767 / 2 + 4e-6)
    # The tool truncates half precision: a whole step, 2^-24 below its normal range.
    rtol, atol = (1e-6, 0) if level == 0 else (2**-10, 2**-24)
    np.testing.assert_allclose(np.exp(found.log_scales), np.exp(kept.log_scales), rtol=rtol, atol=atol)
    np.testing.assert_allclose(np.abs((unit(found.quats) * unit(kept.quats)).sum(axis=1)), 1, atol=1e-6)
    colors = np.clip(0.5 + SH_C0 * kept.sh[:, 0], 0, 1)
    np.testing.assert_allclose(0.5 + SH_C0 * found.sh[:, 0], colors, atol=1 / 255 + 1e-6)
    if level > 0:
        # The tool takes the range from all but the last coefficient and clips: 0.719 where the scene has 0.891.
        low, high = -0.7826258, 0.7189795
        step = (high - low) / 255 if level == 2 else 2**-11
        np.testing.assert_allclose(
            np.clip(found.sh[:, 1:9], low, high), np.clip(kept.sh[:, 1:9], low, high), atol=step + 1e-6
        )


def test_clipped_colours_are_counted(tmp_path):
    g = random_gaussians(5, 0)
    g.sh[:] = 0
    g.sh[[1, 3], 0, 2] = (3, -2)
    g.sh[4, 0, 0] = 0.5 / SH_C0  # a colour of 1
    assert "the colours of 2 Gaussians: ksplat clips them to 0 to 1" in written(tmp_path, g, 1)[1]


def test_small_scenes_get_small_blocks(tmp_path):
    g = random_gaussians(500, 0)
    g.means[:] *= 1e-3
    g.log_scales[:] -= np.float32(np.log(1e3))
    b, _ = written(tmp_path, g, 1)
    g = g.take(rows_in_buckets(g))
    sigma = np.exp(np.median(g.log_scales))
    assert np.abs(b.means - g.means).max() < 0.02 * sigma


@pytest.mark.parametrize("scale", [1, 1e9])  # with 1e9 the blocks between are more than 2⁶²
def test_far_outliers_have_a_bucket_of_their_own(tmp_path, scale):
    g = random_gaussians(50, 0)
    g.means[7] = np.array([1e6, -3e5, 2e4]) * scale
    b, _ = written(tmp_path, g, 1)
    far = np.abs(b.means).max(axis=1).argmax()
    assert np.abs(b.means[far] - g.means[7]).max() <= scale / 16  # float32 has steps of 1/16 at 1e6
    assert np.abs(np.delete(b.means, far, axis=0)).max() < 100


def edited(tmp_path, offset, dtype, value, level=1):
    splatree.write(Scene.flat(random_gaussians(20, 1)), tmp_path / "a.ksplat", options=WriteOptions(compression=level))
    data = bytearray((tmp_path / "a.ksplat").read_bytes())
    data[offset : offset + np.dtype(dtype).itemsize] = np.array(value, dtype).tobytes()
    (tmp_path / "a.ksplat").write_bytes(data)
    return tmp_path / "a.ksplat"


@pytest.mark.parametrize(
    ("offset", "dtype", "value", "message"),
    [
        (1, "u1", 2, "version 0.2, wanted 0.1"),
        (20, "<u2", 3, "level 3, wanted 0, 1 or 2"),
        (4, "<u4", 2**31, "wanted more for 2147483648 section headers"),
        (4096 + 4, "<u4", 2**32 - 1, r"found \d+ bytes, wanted 1\d{11} for its 1 sections"),
        (4096, "<u4", 21, "found 21 splats, wanted at most the 20"),
        (4096 + 12, "<u4", 3, "found 3 buckets, wanted the 0 full and"),
        (4096 + 16, "<f4", np.nan, "block size of nan"),
        (4096 + 20, "<u2", 13, "found 13 bytes a bucket, wanted 12"),
        (4096 + 40, "<u2", 4, "degree 4, wanted 0 to 3"),
        (5120, "<u4", 0, "found buckets of 19 splats in all, wanted 20"),
        (36, "<f4", np.nan, "harmonics between nan"),
    ],
)
def test_headers_that_do_not_fit_are_refused(tmp_path, offset, dtype, value, message):
    with pytest.raises(FormatError, match=message):
        splatree.read(edited(tmp_path, offset, dtype, value))


def test_a_cut_off_file_is_refused(tmp_path):
    splatree.write(Scene.flat(random_gaussians(20, 1)), tmp_path / "a.ksplat")
    whole = (tmp_path / "a.ksplat").read_bytes()
    for length in (0, 100, 4096, 5000, len(whole) - 1):
        (tmp_path / "a.ksplat").write_bytes(whole[:length])
        with pytest.raises(FormatError, match=f"found {length} bytes[;,] (a download|wanted)"):
            splatree.read(tmp_path / "a.ksplat")


def test_an_unknown_level_is_refused(tmp_path):
    with pytest.raises(InputError, match="compression 3, wanted level 0, 1 or 2"):
        splatree.write(Scene.flat(random_gaussians(1)), tmp_path / "a.ksplat", options=WriteOptions(compression=3))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("level", [0, 1, 2])
def test_an_empty_scene(tmp_path, level):
    assert len(written(tmp_path, random_gaussians(0), level)[0]) == 0
