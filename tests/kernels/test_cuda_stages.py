"""Each stage of the device against the same references, scenes and bands as the stage of the processor."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

import splatree as st
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.plan import Blend, Launch
from splatree.kernels.cuda.stages import Stages
from splatree.kernels.reference.bin import smallest_distances
from splatree.scene.frame import Splats
from splatree.scene.view import Wanted

from ..scenes import camera, gaussians
from .conftest import SCENES, absurd
from .simt_device import Emulator
from .test_bin import pairs_of, splats_of
from .test_blend import BACKGROUND, EVERYTHING, assert_outputs_are_those_of_the_reference, same_bits
from .test_project import MODES, all_rows, aspect, assert_at_a_step, seen

KERNELS: tuple[Blend, ...] = get_args(Blend)
ROW_BY_ROW = [kernel for kernel in KERNELS if kernel.startswith("blend")]
"""Those that take the tiles in their order; the others have the same bits."""


@pytest.fixture(params=SCENES)
def view(request: pytest.FixtureRequest) -> tuple[st.Scene, st.Camera]:
    """Each hard scene in turn."""
    g, seen_by = SCENES[request.param]()
    return st.Scene.flat(g), seen_by


def assert_same_splats(found: Splats, wanted: Splats, seen_by: st.Camera) -> None:
    """The bands of tests/kernels/test_project.py."""
    assert_at_a_step(found, np.setdiff1d(found.rows, wanted.rows), seen_by, 1 / 255)
    assert_at_a_step(wanted, np.setdiff1d(wanted.rows, found.rows), seen_by, 1 / 255)
    _, i, j = np.intersect1d(found.rows, wanted.rows, return_indices=True)
    relative = 1e-6 * aspect(wanted)[j] + 4e-6
    place = np.abs(wanted.means_px[j]) + seen_by.K[0, 0]
    assert np.all(np.abs(found.means_px[i] - wanted.means_px[j]) <= 4e-6 * place)
    np.testing.assert_allclose(found.depths[i], wanted.depths[j], rtol=4e-6)
    largest = np.abs(wanted.factors[j]).max(axis=1, initial=0)
    assert np.all(np.abs(found.factors[i] - wanted.factors[j]).max(axis=1, initial=0) <= relative * largest)
    assert np.all(np.abs(found.opacities[i] - wanted.opacities[j]) <= relative * wanted.opacities[j].max(initial=0))
    np.testing.assert_allclose(found.colors[i], wanted.colors[j], atol=4e-6)
    clear = wanted.opacities[j] > 1.1 / 255
    np.testing.assert_allclose(found.half_sizes_px[i][clear], wanted.half_sizes_px[j][clear], rtol=2e-4)


@pytest.mark.parametrize("mode", MODES)
def test_splats_are_those_of_the_reference(view: tuple[st.Scene, st.Camera], device: Device, mode: str) -> None:
    scene, seen_by = view
    rows = all_rows(scene)
    found, wanted = (
        stage.project(scene.gaussians, None, rows, seen(seen_by, mode)) for stage in (Stages(device), reference.project)
    )
    assert_same_splats(found, wanted, seen_by)


def test_rows_that_a_reader_would_refuse_spoil_no_others(device: Device) -> None:
    scene, seen_by = st.Scene.flat(absurd()), camera()
    rows = all_rows(scene)[11:]
    found, alone = (
        Stages(device).project(scene.gaussians, None, chosen, seen(seen_by)) for chosen in (all_rows(scene), rows)
    )
    kept = np.isin(found.rows, rows)
    np.testing.assert_array_equal(found.records[kept], alone.records)


def test_order_is_by_depth_and_then_by_id(device: Device) -> None:
    g = gaussians(200, 1)
    g.means[:, 2] = np.round(g.means[:, 2])  # many of one depth for a camera that looks along z
    g.log_scales[:] = -1
    ids = np.random.default_rng(0).permutation(200).astype(np.uint32) + 1000
    seen_by = st.Camera.look_at((0, 0, -6), (0, 0, 0), width=40, height=30)
    for given in (ids, None):
        splats = Stages(device).project(g, given, np.arange(200, dtype=np.int32), seen(seen_by))
        assert len(np.unique(splats.depths)) < len(splats) / 4
        tie = splats.rows if given is None else given[splats.rows]
        np.testing.assert_array_equal(splats.order, np.lexsort((tie, splats.depths)))


@pytest.mark.parametrize("has_ids", [False, True])
def test_order_of_more_than_a_tile_of_the_sort(has_ids: bool, device: Device) -> None:
    g = gaussians(9000, 3)
    g.log_scales[:] = -1
    g.means[4000:] = g.means[:5000]  # ties across tiles
    ids = np.random.default_rng(1).permutation(9000).astype(np.uint32) if has_ids else None
    splats = Stages(device).project(g, ids, np.arange(9000, dtype=np.int32), seen(camera()))
    assert len(splats) > 8192
    tie = splats.rows if ids is None else ids[splats.rows]
    np.testing.assert_array_equal(splats.order, np.lexsort((tie, splats.depths)))


def test_thread_blocks_that_take_turns_find_the_same_order_and_lists(emulator: Emulator) -> None:
    """Sums over three chunks look back while the chunk before is at work, and see late what it has published."""
    g = gaussians(11000, 3, log_scales=(-6, -3))
    rows, found = np.arange(11000, dtype=np.int32), []
    for seed, num_resident in ((1, 1), (2, 3), (3, 4)):
        emulator.seed(seed)
        emulator.interleave(num_resident)
        splats = Stages(emulator).project(g, None, rows, seen(camera()))
        bins = Stages(emulator).bin(splats, seen(camera()))
        found.append((splats.order.tobytes(), bins.tile_start.tobytes(), bins.splat_from_pair.tobytes()))
    assert len(splats) > 8192
    assert found[0] == found[1] == found[2]


def test_pairs_are_those_of_the_reference(view: tuple[st.Scene, st.Camera], device: Device) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    bins = Stages(device).bin(splats, seen(seen_by))
    found, wanted = pairs_of(bins), pairs_of(reference.bin.bin(splats, seen(seen_by)))
    assert wanted <= found
    # The margin of tests/kernels/test_bin.py.
    distances = smallest_distances(splats, seen_by)
    k = np.sqrt(2 * np.log(splats.opacities.astype(np.float64) * 255))
    margin = (3e-3 + 4e-6 * splats.half_sizes_px.sum(axis=1)) * np.linalg.norm(splats.factors, axis=1) + 1e-4
    for tile, splat in found - wanted:
        assert distances[splat, tile] <= k[splat] + margin[splat]
    place = np.empty(len(splats), np.int64)
    place[splats.order] = np.arange(len(splats))
    for start, end in zip(bins.tile_start[:-1], bins.tile_start[1:], strict=True):
        assert np.all(np.diff(place[bins.splat_from_pair[start:end]]) > 0)


def test_splats_over_many_tiles_are_listed_in_depth_order(device: Device) -> None:
    # 300 × 200 px are 19 × 13 tiles: splats that a warp lists together, and more tiles than a digit of the sort holds.
    scene, seen_by = st.Scene.flat(gaussians(60, 3, log_scales=(-2, 1))), camera(300, 300)
    splats = splats_of(scene, seen_by)
    wanted, bins = cpu.bin.bin(splats, seen(seen_by)), Stages(device).bin(splats, seen(seen_by))
    assert len(bins.tile_start) > 256
    assert pairs_of(bins) == pairs_of(wanted)
    np.testing.assert_array_equal(bins.splat_from_pair, wanted.splat_from_pair)


def test_more_tiles_than_16_bits_number_are_listed_alike(device: Device) -> None:
    # 4112 × 4112 px are 257 × 257 tiles: keys of 32 bits, in three passes.
    scene, seen_by = st.Scene.flat(gaussians(30, 3, log_scales=(-6, -3))), camera(4112, 4112)
    splats = splats_of(scene, seen_by)
    wanted, bins = cpu.bin.bin(splats, seen(seen_by)), Stages(device).bin(splats, seen(seen_by))
    assert wanted.num_tiles_x * wanted.num_tiles_y > 1 << 16
    np.testing.assert_array_equal(bins.tile_start, wanted.tile_start)
    np.testing.assert_array_equal(bins.splat_from_pair, wanted.splat_from_pair)


@pytest.mark.parametrize("kernel", ROW_BY_ROW)
def test_picture_of_the_same_lists_is_that_of_the_reference(
    view: tuple[st.Scene, st.Camera], device: Device, kernel: Blend
) -> None:
    scene, seen_by = view
    splats = splats_of(scene, seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    fast = Stages(device).blend(splats, bins, seen(seen_by, **BACKGROUND), kernel=kernel)
    slow = reference.blend.blend(splats, bins, seen(seen_by, **BACKGROUND))
    # The bands of tests/kernels/test_blend.py.
    brightest = max(1.0, float(splats.colors.max(initial=0)))
    difference = np.abs(fast.image - slow.image).max(axis=-1)
    tolerance = brightest * (2e-5 + 1e-6 * min(float(splats.half_sizes_px.max(initial=0)), 1e3))
    flipped = difference > tolerance
    assert flipped.mean() <= 0.01
    assert difference.max() <= brightest * 1.5 / 255
    np.testing.assert_array_less(np.abs(fast.alpha - slow.alpha)[~flipped], tolerance)
    assert abs(fast.num_blended - slow.num_blended) <= 1e-3 * slow.num_blended + 2
    assert fast.num_evaluated >= fast.num_blended


@pytest.mark.parametrize("tile_rule", ["tau", "3sigma"])
def test_squares_are_listed_as_on_the_processor(
    view: tuple[st.Scene, st.Camera], device: Device, tile_rule: str
) -> None:
    scene, seen_by = view
    chosen = seen(seen_by, tile_rule=tile_rule, threshold=0.05)  # type: ignore[arg-type]
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), chosen)
    found = Stages(device).project(scene.gaussians, None, all_rows(scene), chosen)
    # A side is rounded up to a whole pixel: a rounding error moves one in some thousand to the next.
    assert len(np.setxor1d(found.rows, splats.rows)) <= 1
    bins, wanted = (stage.bin(splats, chosen) for stage in (Stages(device), cpu.bin))
    moved = {splat for _, splat in pairs_of(bins) ^ pairs_of(wanted)}
    assert len(moved) <= 1e-3 * len(splats) + 1


@pytest.mark.parametrize("kernel", ROW_BY_ROW)
def test_splats_are_tapered_as_by_the_reference(
    view: tuple[st.Scene, st.Camera], device: Device, kernel: Blend
) -> None:
    scene, seen_by = view
    chosen = seen(seen_by, pixels="taper", threshold=0.05, **BACKGROUND)  # type: ignore[arg-type]
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), chosen)
    wanted, bins = cpu.bin.bin(splats, chosen), Stages(device).bin(splats, chosen)
    assert wanted.floors is not None
    assert bins.floors is not None
    # |L d|² of a needle's nearest point loses digits as in the lists; the opacity follows it by e^(-½ that).
    np.testing.assert_allclose(bins.floors, wanted.floors, rtol=2e-3)
    fast = Stages(device).blend(splats, wanted, chosen, kernel=kernel)
    slow = reference.blend.blend(splats, wanted, chosen)
    brightest = max(1.0, float(splats.colors.max(initial=0)))
    difference = np.abs(fast.image - slow.image).max(axis=-1)
    # As without a taper, times its slope of 2.
    tolerance = brightest * (4e-5 + 2e-6 * min(float(splats.half_sizes_px.max(initial=0)), 1e3))
    assert (difference > tolerance).mean() <= 0.01
    assert difference.max() <= brightest * 1.5 / 255


@pytest.mark.parametrize("pixels", ["hard", "taper"])
def test_contributions_are_those_of_the_processor(
    view: tuple[st.Scene, st.Camera], device: Device, pixels: str
) -> None:
    scene, seen_by = view
    chosen = seen(seen_by, pixels=pixels, threshold=0.02)  # type: ignore[arg-type]
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), chosen)
    bins = cpu.bin.bin(splats, chosen)
    asked = replace(chosen, wanted=Wanted(contributions=True))
    found, wanted = (stage.blend(splats, bins, asked) for stage in (Stages(device), cpu.blend))
    assert found.contributions is not None
    assert wanted.contributions is not None
    # 256 pixels of up to 1; a pixel at τ may fall either way in either.
    close = np.abs(found.contributions - wanted.contributions) <= 1e-3 + 1e-4 * wanted.contributions
    assert (~close).sum() <= 0.01 * len(close) + 1
    # FilterGS: what the pairs of the picture contribute is what its pixels stop.
    np.testing.assert_allclose(found.contributions.sum(), found.alpha.sum(dtype=np.float64), rtol=1e-4, atol=1e-4)
    plain = Stages(device).blend(splats, bins, chosen)
    np.testing.assert_array_equal(plain.image, found.image)


@pytest.mark.parametrize("pixels", ["hard", "taper"])
def test_outputs_beside_the_picture_are_those_of_the_processor(
    view: tuple[st.Scene, st.Camera], device: Device, pixels: str
) -> None:
    scene, seen_by = view
    chosen = seen(seen_by, pixels=pixels, threshold=0.02, wanted=EVERYTHING)
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), chosen)
    bins = cpu.bin.bin(splats, chosen)
    found = Stages(device).blend(splats, bins, chosen)
    assert_outputs_are_those_of_the_reference(found, cpu.blend.blend(splats, bins, chosen))
    plain = Stages(device).blend(splats, bins, replace(chosen, wanted=Wanted()))
    np.testing.assert_array_equal(plain.image, found.image)
    alone = Stages(device).blend(splats, bins, replace(chosen, wanted=Wanted(last_pair=True)))
    np.testing.assert_array_equal(alone.last_pair, found.last_pair)
    np.testing.assert_array_equal(alone.tiles.evaluated, found.tiles.evaluated)
    assert (alone.median_depth, alone.contributions) == (None, None)


def test_all_blend_kernels_draw_the_same_bits_in_any_order(emulator: Device) -> None:
    scene, seen_by = st.Scene.flat(gaussians(300, 1, degree=3)), camera()
    splats = splats_of(scene, seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    first = Stages(emulator).blend(splats, bins, seen(seen_by, **BACKGROUND))
    for seed in (2, 3):
        emulator.seed(seed)  # type: ignore[attr-defined]
        for kernel in KERNELS:
            assert same_bits(first, Stages(emulator).blend(splats, bins, seen(seen_by, **BACKGROUND), kernel=kernel))


# 6, 247 and 1311 tiles: less and more than threads
@pytest.mark.parametrize("size", [(48, 32), (300, 200), (1100, 300)])
def test_tiles_with_the_longest_lists_come_first(size: tuple[int, int], device: Device) -> None:
    seen_by = camera(*size)
    splats = splats_of(st.Scene.flat(gaussians(200, 3, log_scales=(-4, -1))), seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    work = Stages(device)._workspace(None, seen(seen_by), num_rows=len(splats), pairs=bins.num_pairs)
    work.fill("tile_start", bins.tile_start[:, None])
    work.run([Launch("order_tiles", 1)])
    order = work.arrays["tile_order"].numpy()[: len(bins.tile_start) - 1, 0]
    assert sorted(order.tolist()) == list(range(len(order)))
    lengths = np.diff(bins.tile_start)[order]
    longest_behind = np.maximum.accumulate(lengths[::-1])[::-1]
    assert (longest_behind <= 1.5 * lengths).all()  # half an octave
    assert lengths[0] > 2 * np.median(lengths)


def test_what_lies_behind_a_wall_is_not_read(device: Device) -> None:
    g = gaussians(4000, 5, log_scales=(-3, -2))
    g.log_scales[:40], g.logit_opacities[:40] = 0.5, 9
    g.means[:40, 2] = -2  # 40 opaque sheets before the cloud
    scene, seen_by = st.Scene.flat(g), camera()
    splats = splats_of(scene, seen_by)
    bins = cpu.bin.bin(splats, seen(seen_by))
    for kernel in KERNELS:
        work = Stages(device).blend(splats, bins, seen(seen_by), kernel=kernel).tiles
        assert work.consumed.sum() < 0.6 * bins.num_pairs
        assert np.all(work.consumed <= np.diff(bins.tile_start))


def test_rows_that_are_not_there_are_refused(device: Device) -> None:
    with pytest.raises(st.InputError, match="rows: found -1 to 3, wanted 0 to 39"):
        Stages(device).project(gaussians(40, 1), None, np.array([-1, 3], np.int32), seen(camera()))
