from dataclasses import replace

import numpy as np
import pytest

from splatree import Camera, Gaussians, GaussianTree, InputError, Scene, SelectOptions, select
from splatree.lod.select import smallest_radius
from splatree.lod.serial import select_serial
from splatree.render.pipeline import trace
from splatree.scene.levels import LevelRecord
from splatree.scene.view import View


def quad_tree(levels: int) -> Scene:
    """A unit square of Gaussians on the plane z = 0, each with four children of half its size."""
    means, sizes, depth, end = [], [], [], []

    def visit(x: float, y: float, size: float, level: int) -> None:
        row = len(means)
        means.append((x, y, 0.0))
        sizes.append(size)
        depth.append(level)
        end.append(0)
        if level + 1 < levels:
            for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                visit(x + sx * size / 4, y + sy * size / 4, size / 2, level + 1)
        end[row] = len(means)

    visit(0.0, 0.0, 1.0, 0)
    n = len(means)
    sigmas = np.array(sizes, np.float32) / 3
    gaussians = Gaussians(
        np.array(means, np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.repeat(np.log(sigmas)[:, None], 3, axis=1),
        np.full(n, 4.0, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    return Scene(gaussians, GaussianTree(np.array(end, np.int32), np.array(depth, np.uint8), 6 * sigmas))


def camera_at(distance: float, x: float = 0.0) -> Camera:
    return Camera.look_at(np.array([x, 0.0, -distance]), np.array([x, 0.0, 0.0]), width=200, height=200)


def test_levels_get_coarser_with_distance():
    scene = quad_tree(5)
    # 3σ of level l is 2^−l: its radius in the middle of the image, f 2^−l / distance, is 2.9 px.
    for level in range(5):
        camera = camera_at(camera_at(1.0).K[0, 0] * 0.5**level / 2.9)
        options = SelectOptions(pixel_error=3.0, view_test="none")
        rows = select(scene, View(camera, dilation_px2=0.0), options).rows
        assert set(scene.tree.depth[rows]) == {level}
        assert len(rows) == 4**level


def test_footprint_keeps_a_splat_whose_centre_is_out_of_the_image():
    scene = quad_tree(1)
    # Half the image is 0.93 wide at this distance; the splat's opacity of 0.98 falls to 1/255 at 3.3 σ = 1.1.
    for shift, seen in ((0.9, True), (1.3, False)):
        camera = camera_at(2.0, 0.93 + shift)
        assert len(select(scene, camera)) == seen
        assert len(select(scene, camera, SelectOptions(view_test="centre"))) == 0
        assert len(select(scene, camera, SelectOptions(view_test="none"))) == 1


def test_footprint_drops_what_is_too_faint_to_draw():
    scene = quad_tree(1)
    assert len(select(scene, View(camera_at(2.0), threshold=0.97))) == 1  # its opacity is 0.982
    assert len(select(scene, View(camera_at(2.0), threshold=0.99))) == 0


def test_budget_raises_the_pixel_error_until_the_visible_cut_fits():
    scene = quad_tree(6)
    camera = camera_at(1.0)
    free = select(scene, camera, SelectOptions(pixel_error=2.0))
    for budget in (1, 7, 100, len(free) - 1, len(free)):
        bound = select(scene, camera, SelectOptions(pixel_error=2.0, budget=budget))
        assert 0 < len(bound) <= budget
        exactly = select(scene, camera, SelectOptions(pixel_error=bound.pixel_error))
        assert exactly.rows.tolist() == bound.rows.tolist()
    assert bound.pixel_error == 2.0
    assert bound.rows.tolist() == free.rows.tolist()


def test_budget_below_the_roots_in_view_is_refused():
    scene = Scene.flat(quad_tree(3).gaussians)
    with pytest.raises(InputError, match=r"21 roots in view.*at most 20"):
        select(scene, camera_at(1.5), SelectOptions(budget=20))


def test_pixel_error_below_the_smallest_radius_is_noted():
    scene = quad_tree(3)
    far = camera_at(1000.0)
    assert smallest_radius("exact") == pytest.approx(3 * np.sqrt(0.3))
    assert smallest_radius("ref") == pytest.approx(2.355, abs=1e-3)
    found = select(scene, far, SelectOptions(pixel_error=2.3, profile="ref"))
    assert len(found) == 16
    assert "all leaves" in found.notes[0]
    assert select(scene, far, SelectOptions(pixel_error=2.3)).notes == ()
    assert select(scene, far, SelectOptions(pixel_error=0.0)).notes == ()


def test_max_radius_drops_large_nodes():
    scene = quad_tree(3)
    assert len(select(scene, camera_at(2.0), SelectOptions(max_radius=10.0))) == 0
    assert len(select(scene, camera_at(2.0), SelectOptions(max_radius=700.0))) == 16


def test_log_serial_counts_what_is_out_of_view_as_small():
    scene = quad_tree(3)
    options = SelectOptions(rule="log-serial", profile="ref", view_test="none")
    # The image is 0.47 wide: the centres of level 1 at ±0.25 are just out of it but within 1.3 of the half width, those of
    # their outer children at ±0.375 are not.
    rows = select(scene, camera_at(0.5), options).rows
    assert len(rows) == 16
    nearer = select(scene, camera_at(0.3), options).rows  # now level 1 is out by more
    assert set(scene.tree.depth[nearer]) == {1}
    away = Camera.look_at(np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, -4.0]))
    assert len(select(scene, away, options)) == 0


def test_roots_that_were_found_hidden_lose_their_subtrees():
    one = quad_tree(2)
    n = len(one)
    ends = np.concatenate([one.tree.subtree_end, one.tree.subtree_end + n]).astype(np.int32)
    depth, extents = np.tile(one.tree.depth, 2), np.tile(one.tree.extents, 2)
    gaussians = Gaussians.concatenate([one.gaussians, one.gaussians])
    options = SelectOptions(rule="log-serial", profile="ref", view_test="none")
    tree, view = GaussianTree(ends, depth, extents), View(camera_at(2.0))
    both, _ = select_serial(gaussians, tree, None, view, options)
    second, visited = select_serial(gaussians, tree, None, view, options, roots=np.array([n]))
    assert both.tolist() == [1, 2, 3, 4, 6, 7, 8, 9]
    assert second.tolist() == [6, 7, 8, 9]
    assert visited == 5


def test_options_that_do_not_exist_are_refused_by_name():
    with pytest.raises(InputError, match="profile: found 'oval', wanted 'exact', '3dgs', 'ref', 'sphere', 'pixel'"):
        SelectOptions(profile="oval")
    with pytest.raises(InputError, match="max_radius: found 0"):
        SelectOptions(max_radius=0)


def of_rule(scene: Scene, rule, profile) -> Scene:
    return replace(scene, tree=replace(scene.tree, record=LevelRecord(rule, profile)))


def test_linked_levels_are_noted_by_their_record_alone():
    options = SelectOptions(pixel_error=3.0, profile="exact")
    for rule in ("linked", "pairs", "foreign"):
        notes = select(of_rule(quad_tree(3), rule, "sphere"), camera_at(2.0), options).notes
        assert any("linked" in note for note in notes) == (rule == "linked")


@pytest.mark.parametrize(("rule", "profile"), [("linked", "sphere"), ("pairs", "pixel"), ("radius-thinning", "exact")])
def test_the_profile_is_that_of_the_levels_unless_it_is_named(rule, profile):
    scene = of_rule(quad_tree(3), rule, profile)
    assert select(scene, camera_at(2.0)).profile == profile
    assert trace(scene, camera_at(2.0)).selection.profile == profile
    assert select(scene, camera_at(2.0), SelectOptions(profile="3dgs")).profile == "3dgs"
