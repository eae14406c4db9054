"""Cuts that draw what is hidden more coarsely, held to the definition: radii multiplied by factors, and a walk down the tree."""

from dataclasses import replace
from functools import partial
from importlib.resources import as_file, files

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import splatree
from splatree.constants import DILATION_PX2
from splatree.errors import InputError
from splatree.kernels.cpu.frame import select as cpu
from splatree.kernels.cpu.frame import stages as cpu_stages
from splatree.kernels.reference.select import cut_by_walk, radii
from splatree.lod.blocks import with_blocks
from splatree.lod.occlusion import (
    AS_BEFORE,
    LEAST_SHARE,
    POWER,
    SHARE_OF_LOOK,
    Cover,
    Light,
    blurred,
    cover_of,
    first_look,
    light_of,
    select_eased,
)
from splatree.lod.select import count_nested, count_uncovered, select
from splatree.metrics.psnr import psnr
from splatree.scene.cameras import Camera
from splatree.scene.frame import CutRange
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import Wanted, view_of

CAMERA = Camera.look_at([0, 0, -3], [0, 0, 0], width=64, height=48)


def scene_of(means, scale, opacity, colors=0.5) -> Scene:
    """Round Gaussians without levels."""
    n = len(means)
    log_scales = np.broadcast_to(np.log(np.asarray(scale, np.float32)).reshape(-1, 1), (n, 3)).astype(np.float32)
    logits = np.broadcast_to(np.log(opacity / (1 - np.asarray(opacity))), n).astype(np.float32)
    sh = np.broadcast_to((np.asarray(colors) - 0.5) / 0.28209479, (n, 3)).astype(np.float32)[:, None]
    quats = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    return Scene.flat(Gaussians(np.asarray(means, np.float32), quats, log_scales.copy(), logits.copy(), sh.copy()))


def levels(flat: Scene) -> Scene:
    return with_blocks(splatree.build_lod(flat, splatree.BuildOptions("pairs")))


def cube(seed: int, num_leaves: int = 300) -> Scene:
    """A tree over random Gaussians in a cube."""
    rng = np.random.default_rng(seed)
    return levels(scene_of(rng.uniform(-1, 1, (num_leaves, 3)), rng.uniform(0.01, 0.05, num_leaves), 0.9))


def wall(num_behind: int) -> Scene:
    """An opaque wall before the camera, and small Gaussians far behind it."""
    rng = np.random.default_rng(1)
    side = np.linspace(-1.5, 1.5, 81)
    front = np.stack([*np.meshgrid(side, side), np.zeros((81, 81))], axis=-1).reshape(-1, 3)
    means = np.concatenate([front, rng.uniform([-1, -1, 2], [1, 1, 4], (num_behind, 3))])
    scales = np.concatenate([np.full(len(front), 0.04), np.full(num_behind, 0.06)])
    return scene_of(means, scales, 0.98, 0.5 + 0.3 * np.sin(9 * means))


@given(
    seed=st.integers(0, 20), profile=st.sampled_from(["pixel", "exact", "sphere"]), tau=st.floats(1, 40), data=st.data()
)
@settings(max_examples=40, deadline=None)
def test_the_cut_is_that_of_the_larger_radii(seed, profile, tau, data):
    scene = cube(seed)
    options = SelectOptions(pixel_error=tau, profile=profile, view_test="none")
    view = view_of(scene, CAMERA)
    tree = scene.tree
    factors = np.ones(len(tree))
    rng = np.random.default_rng(data.draw(st.integers(0, 100)))

    def plain(asked):
        rows, visited = cpu.select(scene.gaussians, tree, scene.blocks, view, asked)
        return rows, visited, asked.pixel_error

    def range_at(finest, coarsest, every=1):
        at = SelectOptions(pixel_error=finest, profile=profile, view_test="none")
        return cpu.select_range(scene.gaussians, tree, scene.blocks, view, at, coarsest=coarsest, every=every)

    def look(rows, coarser, limits):
        some = rows[rng.random(len(rows)) < 0.7]
        found = rng.uniform(0.06, 1, len(some)).astype(np.float32)
        for row, factor in zip(some, found, strict=True):
            factors[row : tree.subtree_end[row]] = factor
        return Cover(some, tree.subtree_end[some], found)

    rows, _, pixel_error = select_eased(plain, range_at, look, options, every=1)
    sizes = AS_BEFORE * radii(scene.gaussians, tree.extents, CAMERA, profile, view.dilation_px2) * factors
    near = np.isclose(sizes, tau, rtol=1e-4)
    assert pixel_error == tau
    assert count_nested(tree, rows) == 0 and count_uncovered(tree, rows) == 0
    if not near.any():
        # what an ancestor of C' would cover stays finer: radii above C' are not multiplied, and beyond τ' in any case
        assert rows.tolist() == cut_by_walk(tree, sizes, tau).tolist()


@given(seed=st.integers(0, 20), share=st.floats(0.02, 0.9), finest=st.sampled_from([0.0, 2.0]))
@settings(max_examples=30, deadline=None)
def test_a_budget_is_kept_and_nearly_filled(seed, share, finest):
    scene = cube(seed)
    budget = max(int((scene.tree.depth == 0).sum()), int(share * scene.tree.num_leaves))
    options = SelectOptions(pixel_error=finest, budget=budget, view_test="none", occlusion=True)
    found = select(scene, CAMERA, options)
    assert len(found) <= budget and found.pixel_error >= finest
    assert count_nested(scene.tree, found.rows) == 0 and count_uncovered(scene.tree, found.rows) == 0
    if found.pixel_error > finest:
        assert len(found) >= budget - 12
    assert all(np.array_equal(found.rows, select(scene, CAMERA, options, threads=n).rows) for n in (1, 2, 3))


@given(
    seed=st.integers(0, 5), share=st.floats(0.3, 0.9), every=st.sampled_from([1, 2, 3]), look_seed=st.integers(0, 100)
)
@settings(max_examples=25, deadline=None)
def test_a_budget_has_the_cut_of_the_pixel_error_that_it_reports(seed, share, every, look_seed):
    """However far the guess is from it: the sample holds all blocks here, so it is that of a half or a third of the budget."""
    scene = cube(seed, 1500)
    view, tree = view_of(scene, CAMERA), scene.tree
    options = SelectOptions(pixel_error=0, profile="pixel", view_test="none", budget=int(share * tree.num_leaves))
    factors, rng = np.ones(len(tree)), np.random.default_rng(look_seed)

    assume((tree.depth == 0).sum() <= options.budget // SHARE_OF_LOOK)

    def plain(asked):
        found = select(scene, CAMERA, asked)
        return found.rows, found.num_visited, found.pixel_error

    def range_at(finest, coarsest, every=1):
        at = SelectOptions(pixel_error=finest, profile="pixel", view_test="none")
        return cpu.select_range(scene.gaussians, tree, scene.blocks, view, at, coarsest=coarsest)

    def look(rows, coarser, limits):
        found = rng.uniform(0.06, 1, len(rows)).astype(np.float32)
        for row, factor in zip(rows, found, strict=True):
            factors[row : tree.subtree_end[row]] = factor
        return Cover(rows, tree.subtree_end[rows], found)

    rows, _, pixel_error = select_eased(plain, range_at, look, options, every=every)
    sizes = AS_BEFORE * radii(scene.gaussians, tree.extents, CAMERA, "pixel", view.dilation_px2) * factors
    assert len(rows) <= options.budget
    wanted = cut_by_walk(tree, sizes, pixel_error * (1 + 1e-5))  # sizes are float32 in the kernel
    assert count_nested(tree, rows) == 0 and count_uncovered(tree, rows) == 0
    assert len(np.setxor1d(rows, wanted)) <= 6  # nodes whose size is the limit, and what they stand for


def test_no_limit_draws_all_leaves():
    scene = cube(3)
    every = select(scene, CAMERA, SelectOptions(pixel_error=0, view_test="none", occlusion=True))
    assert every.rows.tolist() == np.flatnonzero(scene.tree.is_leaf).tolist()
    within = SelectOptions(pixel_error=0, budget=len(scene), view_test="none", occlusion=True)
    assert select(scene, CAMERA, within).rows.tolist() == every.rows.tolist()


def test_a_budget_below_the_roots_is_refused_as_ever():
    scene = wall(10)
    with pytest.raises(InputError, match="budget: found 6571 roots in view"):
        select(
            scene, Camera.look_at([0, 0, -9], [0, 0, 0], width=64, height=48), SelectOptions(budget=9, occlusion=True)
        )


def test_hidden_rows_are_coarse_and_the_wall_is_fine():
    scene = levels(wall(4000))
    camera = Camera.look_at([0, 0, -2], [0, 0, 0], width=320, height=240)
    budget = 2000
    plain, eased = (
        select(scene, camera, SelectOptions(pixel_error=0, budget=budget, occlusion=occlusion)).rows
        for occlusion in (False, True)
    )
    is_behind = scene.gaussians.means[:, 2] > 1
    assert is_behind[plain].sum() > 2 * is_behind[eased].sum()
    truth = splatree.render(scene, camera, select=SelectOptions(pixel_error=0)).image
    before, after = (
        splatree.render(scene, camera, select=SelectOptions(pixel_error=0, budget=budget, occlusion=occlusion)).image
        for occlusion in (False, True)
    )
    assert psnr(after, truth) > psnr(before, truth) + 2


def test_what_nothing_hides_is_seen_whole_also_at_the_border():
    means = [[0, 0, 0], [0, 0, 1], [1.33, 0, 0]]  # one behind the other, and one of which half is outside
    flat = scene_of(means, 0.2, [0.95, 0.9, 0.9])
    camera = Camera.look_at([0, 0, -2], [0, 0, 0], width=160, height=120, fov_y_deg=53.0)
    frame = splatree.trace(flat, camera, wanted=Wanted(contributions=True))
    light = light_of(frame.splats, frame.bins, frame.contributions, frame.view)
    shares = light.seen / light.alone
    # the box that is inside stands for the part of the splat that is: a few percent
    assert shares[0] == pytest.approx(1, abs=0.01) and shares[1] < 0.4 and shares[2] == pytest.approx(1, abs=0.1)


def test_the_light_of_a_faint_splat_alone_ends_where_it_ends():
    flat = scene_of([[0, 0, 0]], 0.3, [0.008])  # twice the opacity at which splats end
    camera = Camera.look_at([0, 0, -2], [0, 0, 0], width=160, height=120)
    frame = splatree.trace(flat, camera, wanted=Wanted(contributions=True))
    light = light_of(frame.splats, frame.bins, frame.contributions, frame.view)
    assert light.seen / light.alone == pytest.approx(1, abs=0.02)


def test_the_first_picture_lets_as_much_light_through_as_the_picture():
    """Of Gaussians far smaller than a pixel the dilation makes discs of one size in pixels, whatever a pixel is."""
    rng = np.random.default_rng(4)
    flat = scene_of(rng.uniform([-2, -2, 0], [2, 2, 1], (6000, 3)), 0.001, 0.5)
    view = view_of(flat, Camera.look_at([0, 0, -3], [0, 0, 0], width=80, height=60, fov_y_deg=45.0))
    small = first_look(view)

    def light_left(view, change=lambda splats: splats):
        splats = change(cpu_stages.project(flat.gaussians, flat.ids, np.arange(6000, dtype=np.int32), view))
        return 1 - cpu_stages.blend(splats, cpu_stages.bin(splats, view), view).alpha.mean()

    wanted = light_left(view)
    assert 0.3 < wanted < 0.7
    # blurring spreads what hides, so a little less is left
    assert light_left(small, blurred) == pytest.approx(wanted, abs=0.04)
    assert light_left(replace(small, dilation_px2=view.dilation_px2)) < wanted - 0.2


def test_a_view_in_which_nothing_is_drawn_has_a_cut():
    """The first picture has no pairs: C′ is in view by its box alone."""
    scene = cube(1)
    away = Camera.look_at([0, 0, -3], [0, 0, -9], width=64, height=48)
    for options in (SelectOptions(4, occlusion=True), SelectOptions(4, occlusion=True, view_test="none")):
        assert count_nested(scene.tree, select(scene, away, options).rows) == 0
    assert len(select(scene, away, SelectOptions(4, occlusion=True))) == 0


def test_blurred_splats_keep_their_mass_and_gain_the_variance():
    rng = np.random.default_rng(5)
    round_ones = scene_of(rng.uniform(-1, 1, (50, 3)), 0.1, 0.7).gaussians
    long_ones = np.log(rng.uniform(0.02, 0.2, (50, 3))).astype(np.float32)
    flat = Scene.flat(replace(round_ones, log_scales=long_ones))
    view = view_of(flat, CAMERA)
    before = cpu_stages.project(flat.gaussians, flat.ids, np.arange(50, dtype=np.int32), view)
    after = blurred(before, 0.5)

    def covariances(splats):
        xx, xy, yy = splats.conics.T.astype(float)
        return np.linalg.inv(np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2))

    assert covariances(after) == pytest.approx(covariances(before) + 0.5 * np.eye(2), rel=1e-4)
    mass = [splats.opacities * np.sqrt(np.linalg.det(covariances(splats))) for splats in (before, after)]
    assert mass[1] == pytest.approx(mass[0], rel=1e-4)
    k = np.sqrt(2 * np.log(after.opacities * 255))
    sides = np.sqrt(np.diagonal(covariances(after), axis1=1, axis2=2))
    assert after.half_sizes_px == pytest.approx(k[:, None] * sides, rel=1e-4)
    assert np.exp2(after.records[:, 6]) == pytest.approx(after.opacities, rel=1e-5)


def test_a_point_of_the_first_picture_has_the_width_that_a_point_of_any_picture_has():
    point = scene_of(np.zeros((1, 3)), 1e-6, 0.9)
    small = first_look(view_of(point, CAMERA))
    splats = blurred(cpu_stages.project(point.gaussians, point.ids, np.zeros(1, np.int32), small))
    assert splats.conics[0] == pytest.approx([1 / DILATION_PX2, 0, 1 / DILATION_PX2], rel=1e-4, abs=1e-6)


def chain() -> tuple[np.ndarray, Light]:
    """Row 0 stands for rows 1 and 2; C′ is rows 1 and 2, of which a quarter and nothing is seen."""
    return np.int32([3, 2, 3]), Light(np.int32([1, 2]), np.float64([1.0, 0.0]), np.float64([4.0, 4.0]))


@pytest.mark.parametrize("size", [1.0, 1.5, 2.0, 3.0])
def test_factors_are_means_over_the_cuts_of_a_range(size):
    """``size`` of row 0: from 1 to it C′ is the cut, from it to 2 row 0 is."""
    ends, light = chain()
    drawn = size < 2
    coarser = CutRange(
        np.int32([0, 1, 2][not drawn :]),
        np.float32([size, 0.5, 1][not drawn :]),
        np.float32([9, size, size][not drawn :]),
    )
    cover = cover_of(light, coarser, (1.0, 2.0), ends)
    part = min(np.log2(size), 1)  # of the range, in which C′ is the cut
    expected = [part * np.log(t) + (1 - part) * np.log(1 / 8) for t in (1 / 4, LEAST_SHARE)]
    assert cover.rows.tolist() == [1, 2] and cover.ends.tolist() == [2, 3]
    assert np.log(cover.factors) == pytest.approx(POWER * np.array(expected), rel=1e-5)


def test_factors_do_not_jump_where_the_first_cut_takes_another_node():
    ends, light = chain()
    family = CutRange(np.int32([0, 1, 2]), np.float32([1.001, 0.5, 0.9]), np.float32([9, 1.001, 1.001]))
    before = cover_of(light, family, (1, 2), ends)
    whole = Light(np.int32([0]), np.float64([1.0]), np.float64([8.0]))
    after = cover_of(whole, CutRange(np.int32([0]), np.float32([0.999]), np.float32([9])), (1, 2), ends)
    # C′ is the cut in 0.0014 of the range still, where ln t differs by up to ln 125
    assert before.factors == pytest.approx([after.factors[0]] * 2, rel=4e-3)


def test_nodes_of_which_the_picture_tells_nothing_are_not_taken_to_be_hidden():
    light = Light(np.int32([0]), np.float64([0.0]), np.float64([0.0]))
    cover = cover_of(light, CutRange(np.int32([0]), np.float32([0]), np.float32([9])), (1, 2), np.int32([1]))
    assert cover.factors.tolist() == [1]


def test_factors_are_those_of_the_subtree_that_holds_a_row():
    cover = Cover(np.int32([2, 9]), np.int32([5, 10]), np.float32([0.5, 0.25]))
    rows = np.int32([0, 2, 3, 4, 5, 8, 9, 10])
    assert cover.of(rows).tolist() == [1, 0.5, 0.5, 0.5, 1, 1, 0.25, 1]
    assert cover.of(np.int32([])).tolist() == []


def test_near_views_of_a_city_gain_within_a_budget():
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        city_tree = levels(splatree.edit(splatree.read(path), splatree.EditOptions(sh_degree=0)))
    views = splatree.flyout(city_tree, splatree.PathOptions(views=3, width=480, height=270))
    gains = []
    for camera in views:
        draw = partial(splatree.render, city_tree, camera)
        truth = draw(select=SelectOptions(pixel_error=0))
        budget = truth.counters.num_selected // 4
        before, after = (
            draw(select=SelectOptions(pixel_error=0, budget=budget, occlusion=occlusion)).image
            for occlusion in (False, True)
        )
        gains.append(psnr(after, truth.image) - psnr(before, truth.image))
    assert min(gains) > 0 and gains[0] > 1


def test_other_rules_and_stores_are_refused():
    with pytest.raises(InputError, match="occlusion: found rule 'release', wanted 'cut'"):
        SelectOptions(rule="release", occlusion=True)
