"""Splats shrunk to τ above 1/255: listed in fewer tiles, drawn whole there or tapered off."""

from itertools import pairwise

import numpy as np
import pytest

import splatree as st
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.view import Wanted

from ..scenes import camera, gaussians
from .test_bin import pairs_of
from .test_project import all_rows, seen

TAU = 0.08


def everywhere(splats: Splats, bins: TileBins) -> TileBins:
    """The splats that are listed in any tile listed in all, with the same floors."""
    num_tiles = bins.num_tiles_x * bins.num_tiles_y
    listed = splats.order[np.isin(splats.order, bins.splat_from_pair)]
    start = np.arange(num_tiles + 1, dtype=np.int64) * len(listed)
    return TileBins(start, np.tile(listed, num_tiles), bins.num_tiles_x, bins.num_tiles_y, bins.floors)


def drawn(
    scene: st.Scene, seen_by: st.Camera, pixels: str, threshold: float = TAU, tile_rule: str = "ellipse"
) -> tuple[Splats, TileBins, Picture]:
    named = seen(seen_by, pixels=pixels, threshold=threshold, tile_rule=tile_rule)
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    bins = cpu.bin.bin(splats, named)
    return splats, bins, cpu.blend.blend(splats, bins, named)


def test_floors_are_those_of_the_reference(view: tuple[st.Scene, st.Camera], isa: str) -> None:
    scene, seen_by = view
    splats, bins, _ = drawn(scene, seen_by, "taper")
    slow = reference.bin.bin(splats, seen(seen_by, pixels="taper", threshold=TAU))
    assert bins.floors is not None and slow.floors is not None
    assert np.all((bins.floors >= np.float32(1 / 255) * (1 - 1e-6)) & (bins.floors <= TAU * (1 + 1e-6)))
    # Tiles beyond the picture's border count as lost here, so a floor may be higher; lower only by rounding of |L d|². A splat
    # that is listed in no tile has none, and one in a tile within the margin for rounding another.
    other_tiles = [splat for _, splat in pairs_of(bins) ^ pairs_of(slow)]
    same_tiles = np.setdiff1d(bins.splat_from_pair, other_tiles)
    assert len(same_tiles) >= 0.9 * len(np.unique(slow.splat_from_pair))
    tolerance = 1e-4 + 1e-5 * np.abs(splats.factors).max(axis=1, initial=0) * (
        1 + splats.half_sizes_px.max(axis=1, initial=0)
    )
    assert np.all((bins.floors >= slow.floors * (1 - tolerance))[same_tiles])


def test_floors_of_splats_inside_the_picture_are_exact() -> None:
    scene, seen_by = st.Scene.flat(gaussians(300, 1, log_scales=(-4, -2), spread=0.4)), camera(160, 120)
    splats, bins, _ = drawn(scene, seen_by, "taper")
    slow = reference.bin.bin(splats, seen(seen_by, pixels="taper", threshold=TAU))
    assert bins.floors is not None and slow.floors is not None
    assert 0.2 < np.mean(bins.floors > 1.1 / 255) < 0.9  # both kinds are there
    np.testing.assert_allclose(bins.floors, slow.floors, rtol=1e-3)  # e^(-½ |L d|²) of |L d|² up to 11 in float32


@pytest.mark.parametrize("pixels", ["hard", "taper"])
def test_picture_of_the_same_lists_is_that_of_the_reference(
    view: tuple[st.Scene, st.Camera], isa: str, pixels: str
) -> None:
    scene, seen_by = view
    named = seen(seen_by, pixels=pixels, threshold=TAU)
    splats, bins, fast = drawn(scene, seen_by, pixels)
    slow = reference.blend.blend(splats, bins, named)
    brightest = max(1.0, float(splats.colors.max(initial=0)))
    difference = np.abs(fast.image - slow.image).max(axis=-1)
    # As for whole splats, times the slope of the taper.
    tolerance = 2 * brightest * (2e-5 + 1e-6 * min(float(splats.half_sizes_px.max(initial=0)), 1e3))
    assert (difference > tolerance).mean() <= 0.01
    assert difference.max() <= brightest * 1.5 / 255


@pytest.mark.parametrize("tile_rule", ["ellipse", "balanced"])
def test_tapered_picture_does_not_depend_on_the_tiles(view: tuple[st.Scene, st.Camera], tile_rule: str) -> None:
    scene, seen_by = view
    splats, bins, picture = drawn(scene, seen_by, "taper", tile_rule=tile_rule)
    whole = cpu.blend.blend(
        splats, everywhere(splats, bins), seen(seen_by, pixels="taper", threshold=TAU), whole_tile=True
    )
    # In a tile that a splat is not listed in, its opacity is at most its floor, where it is tapered to 1/255; few splats have
    # their largest opacity there in a pixel.
    brightest = max(1.0, float(splats.colors.max(initial=0)))
    assert np.abs(picture.image - whole.image).max() <= 1.01 / 255 * brightest


def test_hard_pixels_show_the_edges_of_lost_tiles() -> None:
    # The law above could hold for any picture: here is one that it does not hold for.
    scene, seen_by = st.Scene.flat(gaussians(40, 3, log_scales=(-2, -1))), camera()
    splats, bins, picture = drawn(scene, seen_by, "hard")
    whole = cpu.blend.blend(
        splats, everywhere(splats, bins), seen(seen_by, pixels="hard", threshold=TAU), whole_tile=True
    )
    assert np.abs(picture.image - whole.image).max() > 5 / 255


def test_shrinking_to_the_blend_threshold_changes_no_bit(view: tuple[st.Scene, st.Camera]) -> None:
    scene, seen_by = view
    splats, bins, lossless = drawn(scene, seen_by, "hard", threshold=1 / 255)
    every = cpu.blend.blend(splats, everywhere(splats, bins), seen(seen_by), whole_tile=True)
    tapered = drawn(scene, seen_by, "taper", threshold=1 / 255)[2]
    for other in (every, tapered):
        assert other.image.tobytes() == lossless.image.tobytes()
        assert other.alpha.tobytes() == lossless.alpha.tobytes()


def test_balanced_pairs_are_those_of_the_reference(view: tuple[st.Scene, st.Camera], isa: str) -> None:
    scene, seen_by = view
    named = seen(seen_by, tile_rule="balanced", threshold=0.2)
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    fast, slow = (pairs_of(stage.bin.bin(splats, named)) for stage in (cpu, reference))
    # One splat in a hundred may end within the margin for rounding of a tile, or have the opacity at which it ends.
    assert len(slow - fast) <= 0.002 * len(slow) and len(fast - slow) <= 0.01 * len(slow) + 1


def test_balanced_lets_large_splats_end_lower() -> None:
    # The same opacity; areas √det Σ' of about 0.3, 7 and 700 px²: τ, τ (0.3 / 7)^0.4 = 0.28 τ, and 1/255, more than 0.045 τ.
    sigmas = np.array([1e-3, 2.6, 26.5])
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=640, height=480)
    g = st.Gaussians(
        np.tile(np.array([[0, 0, 4]], np.float32), (3, 1)),
        np.tile(np.array([[1, 0, 0, 0]], np.float32), (3, 1)),
        np.log(np.tile(sigmas[:, None] * 4 / seen_by.K[0, 0], 3)).astype(np.float32),
        np.full(3, 3, np.float32),
        np.zeros((3, 1, 3), np.float32),
    )
    counts = {}
    for tile_rule, threshold in (("balanced", 0.08), ("ellipse", 0.08), ("ellipse", 0.0225), ("ellipse", 1 / 255)):
        named = seen(seen_by, tile_rule=tile_rule, threshold=threshold)
        splats = cpu.project.project(g, None, np.arange(3, dtype=np.int32), named)
        counts[tile_rule, threshold] = np.bincount(cpu.bin.bin(splats, named).splat_from_pair, minlength=3)
    small, medium, large = counts["balanced", 0.08]
    assert small == counts["ellipse", 0.08][0]
    assert medium == counts["ellipse", 0.0225][1]
    assert large == counts["ellipse", 1 / 255][2] > counts["ellipse", 0.08][2]


def test_balanced_at_the_blend_threshold_is_the_ellipse(view: tuple[st.Scene, st.Camera]) -> None:
    scene, seen_by = view
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), seen(seen_by, tile_rule="balanced"))
    balanced, ellipse = (
        cpu.bin.bin(splats, seen(seen_by, tile_rule=tile_rule)) for tile_rule in ("balanced", "ellipse")
    )
    assert balanced.splat_from_pair.tobytes() == ellipse.splat_from_pair.tobytes()
    assert balanced.tile_start.tobytes() == ellipse.tile_start.tobytes()


def test_a_larger_threshold_lists_fewer_tiles() -> None:
    scene, seen_by = st.Scene.flat(gaussians(300, 1)), camera(160, 120)
    lists = [pairs_of(drawn(scene, seen_by, "hard", threshold=tau)[1]) for tau in (1 / 255, 0.03, 0.1, 0.3)]
    rows = [drawn(scene, seen_by, "hard", threshold=tau)[0].rows for tau in (1 / 255, 0.03, 0.1, 0.3)]
    by_row = [{(tile, row[splat]) for tile, splat in pairs} for pairs, row in zip(lists, rows, strict=True)]
    for larger, smaller in pairwise(by_row):
        assert smaller < larger


def test_threads_change_no_bit() -> None:
    scene, seen_by = st.Scene.flat(gaussians(6000, 3)), camera(120, 90)
    named = seen(seen_by, pixels="taper", threshold=TAU, wanted=Wanted(contributions=True))
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    pictures = []
    for threads in (1, 3):
        bins = cpu.bin.bin(splats, named, threads=threads)
        picture = cpu.blend.blend(splats, bins, named, threads=threads)
        assert bins.floors is not None and picture.contributions is not None
        pictures.append(bins.floors.tobytes() + picture.image.tobytes() + picture.contributions.tobytes())
    assert pictures[0] == pictures[1]


def test_taper_is_for_ellipses() -> None:
    with pytest.raises(st.InputError, match="found 'taper' with tile_rule 'tau'"):
        st.RenderOptions(pixels="taper", tile_rule="tau")
    with pytest.raises(st.InputError, match=r"RenderOptions\.tile_rule: found 'box', wanted 'ellipse'"):
        st.RenderOptions(tile_rule="box")  # type: ignore[arg-type]
