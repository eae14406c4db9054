import numpy as np
import pytest

import splatree as st
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.kernels.reference.bin import smallest_distances
from splatree.scene.frame import Splats, TileBins

from ..scenes import camera, gaussians
from .test_project import all_rows, seen


def splats_of(scene: st.Scene, seen_by: st.Camera) -> Splats:
    return cpu.project.project(scene.gaussians, None, all_rows(scene), seen(seen_by))


def pairs_of(bins: TileBins) -> set[tuple[int, int]]:
    tiles = np.repeat(np.arange(len(bins.tile_start) - 1), np.diff(bins.tile_start))
    return set(zip(tiles.tolist(), bins.splat_from_pair.tolist(), strict=True))


def test_pairs_are_those_of_the_reference(view: tuple[st.Scene, st.Camera]) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    fast, slow = (stage.bin.bin(splats, seen(seen_by)) for stage in (cpu, reference))
    found, wanted = pairs_of(fast), pairs_of(slow)
    assert wanted <= found
    # More only where the ellipse misses the tile by less than the margin for rounding: 2e-3 px and 2e-6 of the box. In
    # units of |L d| a pixel is at most as long as the short axis allows.
    distances = smallest_distances(splats, seen_by)
    k = np.sqrt(2 * np.log(splats.opacities.astype(np.float64) * 255))
    steepest = np.linalg.norm(splats.factors, axis=1)
    margin = (3e-3 + 4e-6 * splats.half_sizes_px.sum(axis=1)) * steepest + 1e-4
    for tile, splat in found - wanted:
        assert distances[splat, tile] <= k[splat] + margin[splat]


def test_lists_are_in_depth_order_without_duplicates(view: tuple[st.Scene, st.Camera]) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    place = np.empty(len(splats), np.int64)
    place[splats.order] = np.arange(len(splats))
    for start, end in zip(bins.tile_start[:-1], bins.tile_start[1:], strict=True):
        assert np.all(np.diff(place[bins.splat_from_pair[start:end]]) > 0)


def test_ellipse_lists_fewer_pairs_than_the_box(view: tuple[st.Scene, st.Camera]) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    ellipse = cpu.bin.bin(splats, seen(seen_by))
    box = cpu.bin.bin(splats, seen(seen_by), whole_box=True)
    assert pairs_of(ellipse) <= pairs_of(box)


def test_threads_do_not_change_the_lists() -> None:
    scene = st.Scene.flat(gaussians(30_000, 3))  # more than one chunk
    seen_by = camera(120, 90)
    splats = splats_of(scene, seen_by)
    assert len(splats) > 16384
    one, two, three = (cpu.bin.bin(splats, seen(seen_by), threads=n) for n in (1, 2, 3))
    for other in (two, three):
        np.testing.assert_array_equal(one.tile_start, other.tile_start)
        np.testing.assert_array_equal(one.splat_from_pair, other.splat_from_pair)


def test_a_diagonal_needle_skips_the_corners_of_its_box() -> None:
    g = st.Gaussians(
        np.array([[0, 0, 4]], np.float32),
        np.array([[np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)]], np.float32),
        np.log(np.array([[2, 1e-3, 1e-3]], np.float32)),
        np.full(1, 9, np.float32),
        np.zeros((1, 1, 3), np.float32),
    )
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=160, height=160)
    splats = splats_of(st.Scene.flat(g), seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    # Through the middle of 10 × 10 tiles the diagonal meets 10 tiles and, being about 4 px thick, their neighbours' corners.
    assert bins.num_pairs <= 28
    assert cpu.bin.bin(splats, seen(seen_by), whole_box=True).num_pairs == 100


def test_pictures_with_too_many_tiles_are_refused() -> None:
    wide = camera(16 * 2**16, 1)
    with pytest.raises(st.InputError, match="wanted at most 1048560 px a side"):
        cpu.bin.bin(splats_of(st.Scene.flat(st.Gaussians.empty()), wide), seen(wide))


@pytest.mark.parametrize("rule", ["ellipse", "box"])
def test_a_tall_splat_is_listed_in_each_row_of_tiles_from_its_first_to_its_last(isa: str, rule: str) -> None:
    """Splats of 1 to 16 and of 21 rows: few are listed by the vector loop, more row by row, eight at a time."""
    n = 500
    rng = np.random.default_rng(5)
    g = gaussians(n, 5)
    g.means[:] = np.stack([rng.choice([-0.11, 0.11], n), rng.uniform(-2, 2, n), np.zeros(n)], axis=1)
    g.quats[:] = (1, 0, 0, 0)
    g.log_scales[:] = np.stack([np.full(n, -4), rng.uniform(-5, 0, n), np.full(n, -4)], axis=1)
    g.logit_opacities[:] = 4
    seen_by = st.Camera.look_at((0, 0, -5), (0, 0, 0), width=64, height=336)
    splats = splats_of(st.Scene.flat(g), seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by), whole_box=rule == "box")
    row_of_pair = np.repeat(np.arange(len(bins.tile_start) - 1), np.diff(bins.tile_start)) // bins.num_tiles_x
    # Rows whose pixel centres the box meets; an upright needle in the middle of a column of tiles meets each of them too.
    top, bottom = (splats.means_px[:, 1] + side * splats.half_sizes_px[:, 1].astype(np.float64) for side in (-1, 1))
    inside_top, inside_bottom = np.maximum(top, 0.5), np.minimum(bottom, 335.5)
    first, last = np.ceil((inside_top - 15.5) / 16), np.floor((inside_bottom - 0.5) / 16)
    # Ends within a hundredth of a pixel of a row's first or last centre may go either way.
    clear = np.ones(len(splats), bool)
    for end in (top, bottom):
        clear &= np.abs((end - 0.5 + 8) % 16 - 8) > 0.01
        clear &= np.abs((end - 15.5 + 8) % 16 - 8) > 0.01
    counts = last - first + 1
    assert set(range(1, 17)) | {21} <= set(counts[clear].astype(int))
    for splat in np.flatnonzero(clear):
        rows = np.unique(row_of_pair[bins.splat_from_pair == splat])
        np.testing.assert_array_equal(rows, np.arange(first[splat], last[splat] + 1))
