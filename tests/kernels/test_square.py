"""The square extents of published code: `3sigma` and `tau`."""

import numpy as np
import pytest

import splatree as st
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.kernels.reference.square import half_sides, rule_of
from splatree.scene.frame import Splats

from ..scenes import camera, gaussians
from .test_bin import pairs_of
from .test_project import all_rows, seen

RULES = [("3sigma", 1 / 255), ("tau", 1 / 255), ("tau", 0.05), ("tau", 0.3)]


def radii_of(splats: Splats, tile_rule: str, threshold: float) -> np.ndarray:
    a, b, c = splats.factors.astype(np.float64).T
    covariances = 1 / a**2 + (b / (a * c)) ** 2, -b / (a * c**2), 1 / c**2
    rule = rule_of(seen(camera(), tile_rule=tile_rule, threshold=threshold))
    return half_sides(*covariances, splats.opacities.astype(np.float64), rule)


@pytest.mark.parametrize(("tile_rule", "threshold"), RULES)
def test_pairs_are_those_of_the_reference(
    view: tuple[st.Scene, st.Camera], isa: str, tile_rule: str, threshold: float
) -> None:
    scene, seen_by = view
    named = seen(seen_by, tile_rule=tile_rule, threshold=threshold)
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    fast, slow = (pairs_of(stage.bin.bin(splats, named)) for stage in (cpu, reference))
    # A radius is rounded up to whole pixels, and the tiles down: where float32 ends on the other side of a step, a side moves by
    # one pixel, and the tiles with it where it was at their edge.
    assert len(fast ^ slow) <= 0.02 * len(slow) + 2
    one_more = radii_of(splats, tile_rule, threshold) + 1
    x, y = splats.means_px.astype(np.float64).T
    for tile, splat in fast ^ slow:
        row, column = divmod(tile, -(-seen_by.width // 16))
        # 0.01 px: what float32 loses of a place in the picture.
        assert abs(16 * column + 8 - x[splat]) <= one_more[splat] + 16.01
        assert abs(16 * row + 8 - y[splat]) <= one_more[splat] + 16.01


@pytest.mark.parametrize(("tile_rule", "threshold"), RULES)
def test_splats_are_those_that_are_listed(view: tuple[st.Scene, st.Camera], tile_rule: str, threshold: float) -> None:
    scene, seen_by = view
    named = seen(seen_by, tile_rule=tile_rule, threshold=threshold)
    fast = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    slow = reference.project.project(scene.gaussians, None, all_rows(scene), named)
    assert len(np.setxor1d(fast.rows, slow.rows)) <= 0.01 * len(slow) + 1  # at a step, as above
    listed = np.unique(reference.bin.bin(slow, named).splat_from_pair)
    assert len(slow) - len(listed) <= 0.01 * len(slow) + 1  # the covariance from the float32 factor, at a step


def test_a_round_splat_in_closed_form() -> None:
    # σ = 4 px before dilation: λ = 16.3 + √0.1 by the floor under the root, 3 √λ = 12.23, rounded up 13.
    sigma, distance = 4.0, 4.0
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=64, height=64)
    focal = seen_by.K[0, 0]
    g = st.Gaussians(
        np.array([[0, 0, distance]], np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
        np.full((1, 3), np.log(sigma * distance / focal), np.float32),
        np.zeros(1, np.float32),
        np.zeros((1, 1, 3), np.float32),
    )
    rows = np.zeros(1, np.int32)
    wanted = {("3sigma", 1 / 255): 13.0, ("tau", 1 / 255): 14.0}
    # τ = 0.3: √(2 ln(0.5 / 0.3)) √λ = 1.0108 · 4.0764 = 4.12, one more and rounded up 6. τ = 0.9: a tenth of 3 √λ, 1.22 + 1.
    wanted |= {("tau", 0.3): 6.0, ("tau", 0.9): 3.0}
    for (tile_rule, threshold), half_side in wanted.items():
        named = seen(seen_by, tile_rule=tile_rule, threshold=threshold)
        splats = cpu.project.project(g, None, rows, named)
        assert radii_of(splats, tile_rule, threshold) == half_side
        # The centre is 31.5 in Kerbl's pixels; the square ends in tile ⌊(31.5 + r + 15) / 16⌋, which is not counted.
        first, end = int((31.5 - half_side) // 16), int((31.5 + half_side + 15) // 16)
        for stage in (cpu, reference):
            assert stage.bin.bin(splats, named).num_pairs == (end - first) ** 2


def test_squares_list_splats_of_any_opacity_as_their_codes_do() -> None:
    g = gaussians(50, 1)
    g.logit_opacities[:] = -20
    rows = np.arange(50, dtype=np.int32)
    for tile_rule in ("3sigma", "tau"):
        named = seen(camera(), tile_rule=tile_rule, threshold=0.1)
        splats = cpu.project.project(g, None, rows, named)
        assert len(splats) > 40
        assert cpu.bin.bin(splats, named).num_pairs >= len(splats)
    assert len(cpu.project.project(g, None, rows, seen(camera()))) == 0


def test_threads_do_not_change_the_lists() -> None:
    scene = st.Scene.flat(gaussians(9000, 3))  # more than one chunk
    seen_by = camera(120, 90)
    named = seen(seen_by, tile_rule="tau", threshold=0.05)
    splats = cpu.project.project(scene.gaussians, None, all_rows(scene), named)
    one, three = (cpu.bin.bin(splats, named, threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one.tile_start, three.tile_start)
    np.testing.assert_array_equal(one.splat_from_pair, three.splat_from_pair)
