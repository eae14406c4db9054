from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st_

import splatree as st
from splatree.constants import ALPHA_MAX
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.view import Wanted

from ..scenes import camera, gaussians
from .test_bin import splats_of
from .test_project import all_rows, seen

BACKGROUND = {"background": (0.2, 0.5, 0.9)}


def same_bits(one: Picture, other: Picture) -> bool:
    return (
        one.image.tobytes() == other.image.tobytes()
        and one.alpha.tobytes() == other.alpha.tobytes()
        and one.depth.tobytes() == other.depth.tobytes()
        and one.num_blended == other.num_blended
    )


def test_picture_of_the_same_lists_is_that_of_the_reference(view: tuple[st.Scene, st.Camera], isa: str) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    fast, slow = (stage.blend.blend(splats, bins, seen(seen_by, **BACKGROUND)) for stage in (cpu, reference))
    brightest = max(1.0, float(splats.colors.max(initial=0)))
    difference = np.abs(fast.image - slow.image).max(axis=-1)
    # Hundreds of products of float32; |L d| of a long splat adds 6e-8 of its length in px times 1.8.
    tolerance = brightest * (2e-5 + 1e-6 * min(float(splats.half_sizes_px.max(initial=0)), 1e3))
    flipped = difference > tolerance
    # A splat at τ or a pixel at its last splat may fall either way: few do, and each changes little.
    assert flipped.mean() <= 0.01
    assert difference.max() <= brightest * 1.5 / 255
    np.testing.assert_array_less(np.abs(fast.alpha - slow.alpha)[~flipped], tolerance)
    assert abs(fast.num_blended - slow.num_blended) <= 1e-3 * slow.num_blended + 2


def test_blocks_left_out_change_no_bit(view: tuple[st.Scene, st.Camera], isa: str) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    ellipse = cpu.bin.bin(splats, seen(seen_by))
    box = cpu.bin.bin(splats, seen(seen_by), whole_box=True)
    picture = cpu.blend.blend(splats, ellipse, seen(seen_by, **BACKGROUND))
    assert same_bits(picture, cpu.blend.blend(splats, ellipse, seen(seen_by, **BACKGROUND), whole_tile=True))
    assert same_bits(picture, cpu.blend.blend(splats, box, seen(seen_by, **BACKGROUND), whole_tile=True))
    assert same_bits(picture, cpu.blend.blend(splats, box, seen(seen_by, **BACKGROUND)))


def test_all_tiles_of_the_image_change_no_bit() -> None:
    # Stronger than the box: every splat in every tile.
    scene, seen_by = st.Scene.flat(gaussians(150, 3)), camera()
    splats = splats_of(scene, seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    num_tiles = bins.num_tiles_x * bins.num_tiles_y
    start = np.arange(num_tiles + 1, dtype=np.int64) * len(splats)
    everywhere = TileBins(start, np.tile(splats.order, num_tiles), bins.num_tiles_x, bins.num_tiles_y)
    one = cpu.blend.blend(splats, bins, seen(seen_by, **BACKGROUND))
    other = cpu.blend.blend(splats, everywhere, seen(seen_by, **BACKGROUND), whole_tile=True)
    assert same_bits(one, other)


def stack(opacities: list[float], colors: list[tuple[float, float, float]]) -> tuple[Splats, TileBins, st.Camera]:
    """Flat wide splats one behind the other over a picture of one pixel, at its centre."""
    n = len(opacities)
    records = np.zeros((n, 16), np.float32)
    records[:, 0:2] = 0.5
    records[:, 2], records[:, 4] = 1e-3, 1e-3
    records[:, 5], records[:, 6] = opacities, np.log2(opacities)
    records[:, 7:10], records[:, 10], records[:, 11:13] = colors, np.arange(1, n + 1), 3000
    rows = np.arange(n, dtype=np.int32)
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=1, height=1)
    return Splats(rows, records, rows), TileBins(np.array([0, n]), rows, 1, 1), seen_by


@pytest.mark.parametrize("stage", [cpu, reference], ids=["cpu", "reference"])
def test_two_splats_in_closed_form(stage: object) -> None:
    splats, bins, seen_by = stack([0.5, 0.25], [(1, 0, 0), (0, 1, 0)])
    picture = stage.blend.blend(splats, bins, seen(seen_by, background=(0.0, 0.0, 1.0)))  # type: ignore[attr-defined]
    # At the centre α is the opacity: weights 1/2, 1/2 · 1/4, and 3/8 for the background.
    np.testing.assert_allclose(picture.image[0, 0], [0.5, 0.125, 0.375], rtol=1e-6)
    np.testing.assert_allclose(picture.alpha[0, 0], 0.625, rtol=1e-6)
    np.testing.assert_allclose(picture.depth[0, 0], (0.5 * 1 + 0.125 * 2) / 0.625, rtol=1e-6)
    assert picture.num_blended == 2


@pytest.mark.parametrize("stage", [cpu, reference], ids=["cpu", "reference"])
def test_alpha_stops_at_its_maximum_and_the_pixel_at_its_minimum(stage: object) -> None:
    splats, bins, seen_by = stack([1.0] * 50, [(1, 1, 1)] * 50)
    picture = stage.blend.blend(splats, bins, seen(seen_by))  # type: ignore[attr-defined]
    # 0.01² = 1e-4 is where a pixel is finished. In float64 1 − 0.99 is a little above 0.01, in float32 a little below; the
    # second splat may be drawn or not, the third never is.
    assert picture.num_blended in (1, 2)
    np.testing.assert_allclose(
        picture.alpha[0, 0], [ALPHA_MAX, 1 - (1 - ALPHA_MAX) ** 2][picture.num_blended - 1], rtol=1e-6
    )


@pytest.mark.parametrize("stage", [cpu, reference], ids=["cpu", "reference"])
def test_the_splat_that_would_finish_a_pixel_is_not_drawn(stage: object) -> None:
    # T = 0.1, 0.01, 0.001, then 0.000095 < 1e-4: the fourth is left out, and so is all behind it, however faint.
    splats, bins, seen_by = stack([0.9, 0.9, 0.9, 0.905, 0.1], [(0, 0, 0)] * 3 + [(1, 0, 0), (0, 1, 0)])
    picture = stage.blend.blend(splats, bins, seen(seen_by))  # type: ignore[attr-defined]
    assert picture.num_blended == 3
    np.testing.assert_allclose(picture.alpha[0, 0], 0.999, rtol=1e-6)
    np.testing.assert_array_equal(picture.image[0, 0], [0, 0, 0])


@pytest.mark.parametrize("stage", [cpu, reference], ids=["cpu", "reference"])
def test_opacity_below_the_threshold_leaves_no_trace(stage: object) -> None:
    splats, bins, seen_by = stack([0.0039, 0.004], [(1, 0, 0), (0, 1, 0)])  # 1/255 is 0.00392
    picture = stage.blend.blend(splats, bins, seen(seen_by))  # type: ignore[attr-defined]
    assert picture.num_blended == 1
    np.testing.assert_allclose(picture.image[0, 0], [0, 0.004, 0], rtol=1e-5)


def test_nothing_is_background() -> None:
    scene, seen_by = st.Scene.flat(st.Gaussians.empty()), camera()
    splats = splats_of(scene, seen_by)
    picture = cpu.blend.blend(splats, cpu.bin.bin(splats, seen(seen_by)), seen(seen_by, **BACKGROUND))
    np.testing.assert_array_equal(picture.image, np.broadcast_to(np.float32([0.2, 0.5, 0.9]), picture.image.shape))
    assert not picture.alpha.any() and not picture.depth.any()


def test_a_tile_reads_its_list_until_its_pixels_are_finished() -> None:
    # 200 splats of α = 0.95 over the first tile: T = 0.05, 0.0025, 0.000125, then < 1e-4.
    records = np.zeros((200, 16), np.float32)
    records[:, 2], records[:, 4] = 1e-3, 1e-3  # flat over the tile
    records[:, 5], records[:, 10], records[:, 11:13] = 0.95, np.arange(1, 201), 3e3
    records[:, 6] = np.log2(0.95)
    splats = Splats(np.arange(200, dtype=np.int32), records, np.arange(200, dtype=np.int32))
    bins = TileBins(np.int64([0, 200, 200, 210]), np.r_[np.arange(200), np.arange(10)].astype(np.int32), 3, 1)
    seen_by = camera(33, 16)
    slow = reference.blend.blend(splats, bins, seen(seen_by)).tiles
    assert slow.is_exact
    assert slow.consumed.tolist() == [4, 0, 4]  # the fourth is read and not drawn
    fast = cpu.blend.blend(splats, bins, seen(seen_by)).tiles
    assert fast.consumed[1] == 0
    # The compiled blend looks for finished pixels every 32 entries.
    assert 4 <= fast.consumed[0] <= 4 + 32
    assert fast.consumed[2] == 10
    assert fast.blended.tolist() == slow.blended.tolist()
    exact = cpu.blend.blend(splats, bins, seen(seen_by, wanted=Wanted(last_pair=True))).tiles
    for name in ("consumed", "evaluated", "blended"):
        np.testing.assert_array_equal(getattr(exact, name), getattr(slow, name))


EVERYTHING = Wanted(contributions=True, last_pair=True, median_depth=True)


def assert_outputs_are_those_of_the_reference(fast: Picture, slow: Picture) -> None:
    """Equal but for pixels at which a step of the definition falls the other way: at most one in a hundred."""
    assert fast.last_pair is not None and slow.last_pair is not None
    assert fast.median_depth is not None and slow.median_depth is not None
    same = fast.last_pair == slow.last_pair
    assert same.mean() >= 0.99
    np.testing.assert_array_equal(fast.last_pair[same] < 0, slow.alpha[same] == 0)
    # T passes ½ at another splat only where it comes within rounding of ½.
    assert np.isclose(fast.median_depth, slow.median_depth, rtol=1e-6).mean() >= 0.99
    assert fast.tiles.is_exact and slow.tiles.is_exact
    # By the definition, whatever the back end skips: a pixel at a step reads other entries, all others the same.
    for found, wanted in ((fast.tiles.consumed, slow.tiles.consumed), (fast.tiles.evaluated, slow.tiles.evaluated)):
        assert (found == wanted).mean() >= 0.9 or np.abs(found - wanted).sum() <= 0.01 * wanted.sum()
    assert abs(fast.num_evaluated - slow.num_evaluated) <= 1e-2 * slow.num_evaluated


@pytest.mark.parametrize("pixels", ["hard", "taper"])
def test_outputs_beside_the_picture_are_those_of_the_reference(
    view: tuple[st.Scene, st.Camera], isa: str, pixels: str
) -> None:
    scene, seen_by = view
    named = seen(seen_by, pixels=pixels, threshold=0.02, wanted=EVERYTHING)
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    bins = cpu.bin.bin(splats, named)
    fast, slow = (stage.blend.blend(splats, bins, named) for stage in (cpu, reference))
    assert_outputs_are_those_of_the_reference(fast, slow)
    plain = cpu.blend.blend(splats, bins, replace(named, wanted=Wanted()))
    assert plain.image.tobytes() == fast.image.tobytes()
    assert (plain.last_pair, plain.median_depth, plain.contributions) == (None, None, None)
    np.testing.assert_array_equal(plain.tiles.blended, fast.tiles.blended)
    for wanted in (Wanted(last_pair=True), Wanted(median_depth=True)):
        alone = cpu.blend.blend(splats, bins, replace(named, wanted=wanted))
        for name in ("last_pair", "median_depth"):
            if getattr(wanted, name):
                np.testing.assert_array_equal(getattr(alone, name), getattr(fast, name))
            else:
                assert getattr(alone, name) is None


@settings(max_examples=25)
@given(seed=st_.integers(0, 2**20), threads=st_.integers(1, 3))
def test_the_last_pair_ends_the_light_of_a_pixel(seed: int, threads: int) -> None:
    # Lists cut off behind the last pair of each tile draw the same bits, and one entry less does not.
    scene, seen_by = st.Scene.flat(gaussians(200, seed, log_scales=(-3, -1))), camera(40, 33)
    view = seen(seen_by, wanted=Wanted(last_pair=True))
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), view)
    bins = cpu.bin.bin(splats, view)
    picture = cpu.blend.blend(splats, bins, view, threads=threads)
    assert picture.last_pair is not None
    listed = np.repeat(np.arange(len(bins.tile_start) - 1), np.diff(bins.tile_start))
    pixel_y, pixel_x = np.indices(picture.last_pair.shape)
    tile_of_pixel = pixel_y // 16 * bins.num_tiles_x + pixel_x // 16
    last = np.full(len(bins.tile_start) - 1, -1)
    np.maximum.at(last, tile_of_pixel.ravel(), picture.last_pair.ravel())
    needed = np.arange(bins.num_pairs) <= last[listed]
    start = np.concatenate([[0], np.cumsum(np.bincount(listed[needed], minlength=len(last)))])
    shorter = TileBins(start, bins.splat_from_pair[needed], bins.num_tiles_x, bins.num_tiles_y)
    assert same_bits(picture, cpu.blend.blend(splats, shorter, view))
    blended = picture.last_pair[picture.last_pair >= 0]
    assert np.all(listed[blended] == tile_of_pixel[picture.last_pair >= 0])


@pytest.mark.parametrize("stage", [cpu, reference], ids=["cpu", "reference"])
def test_last_pair_and_median_depth_in_closed_form(stage: object) -> None:
    # T = 0.6, 0.3, 0.03, then the fourth, of opacity 0.999 → 0.99, leaves 0.0003 and the fifth would leave 3e-6.
    splats, bins, seen_by = stack([0.4, 0.5, 0.9, 0.999, 0.999, 0.5], [(1, 1, 1)] * 6)
    picture = stage.blend.blend(splats, bins, seen(seen_by, wanted=EVERYTHING))  # type: ignore[attr-defined]
    assert picture.last_pair.tolist() == [[3]]
    assert picture.median_depth.tolist() == [[2.0]]  # T passes ½ at the second
    assert picture.tiles.consumed.tolist() == picture.tiles.evaluated.tolist() == [5]
    faint, bins, seen_by = stack([0.003, 0.2], [(1, 1, 1)] * 2)
    picture = stage.blend.blend(faint, bins, seen(seen_by, wanted=EVERYTHING))  # type: ignore[attr-defined]
    assert (picture.last_pair[0, 0], picture.median_depth[0, 0]) == (1, 0)
    nothing, bins, seen_by = stack([0.003], [(1, 1, 1)])
    picture = stage.blend.blend(nothing, bins, seen(seen_by, wanted=EVERYTHING))  # type: ignore[attr-defined]
    assert (picture.last_pair[0, 0], picture.tiles.evaluated[0]) == (-1, 1)
    half, bins, seen_by = stack([0.5, 0.5, 0.5], [(1, 1, 1)] * 3)
    picture = stage.blend.blend(half, bins, seen(seen_by, wanted=EVERYTHING))  # type: ignore[attr-defined]
    assert picture.median_depth.tolist() == [[2.0]]  # exactly ½ is left after the first, less after the second
