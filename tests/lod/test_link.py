import json
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import splatree
from splatree import Gaussians, InputError, Scene, SelectOptions, link_levels
from splatree.lod.link import parents_of

from .. import scenes

cloud = partial(scenes.cloud, degree=1)


def levels(*sizes):
    return [Scene.flat(cloud(n, seed)) for seed, n in enumerate(sizes)]


def sorted_rows(g):
    table = np.concatenate([getattr(g, f.name).reshape(len(g), -1) for f in fields(g)], axis=1)
    return table[np.lexsort(table.T)]


def same_rows(a, b):
    return np.array_equal(sorted_rows(a), sorted_rows(b))


def parent_of_rows(tree):
    """The last row before each that is one level up; −1 for roots."""
    last = {-1: -1}
    parents = []
    for row, depth in enumerate(tree.depth.tolist()):
        parents.append(last[depth - 1])
        last[depth] = row
    return np.array(parents)


def test_each_level_is_a_depth_of_the_tree():
    given_levels = levels(600, 200, 50, 7)
    scene = link_levels(given_levels)
    assert scene.tree.num_levels == 4
    for depth, level in enumerate(reversed(given_levels)):
        assert same_rows(scene.gaussians.take(scene.tree.depth == depth), level.gaussians)
    assert np.array_equal(scene.tree.is_leaf, scene.tree.depth == 3)
    assert json.loads(scene.source.metadata["levels"])["nodes"] == [600, 200, 50, 7]


def test_leaves_keep_their_identity():
    finest, coarser = levels(300, 40)
    scene = link_levels([finest, coarser])
    leaves = np.flatnonzero(scene.tree.is_leaf)
    assert np.array_equal(scene.gaussians.means[leaves], finest.gaussians.means[scene.ids[leaves]])
    assert len(np.unique(scene.ids)) == len(scene)


def test_extents_hold_the_subtree():
    scene = link_levels(levels(300, 60, 9))
    g, tree = scene.gaussians, scene.tree
    reach = 3 * np.exp(g.log_scales.max(axis=1).astype(np.float64))
    for row in range(len(scene)):
        inside = slice(row, int(tree.subtree_end[row]))
        away = np.linalg.norm(g.means[inside].astype(np.float64) - g.means[row], axis=1)
        assert (away + reach[inside]).max() <= tree.extents[row] * (1 + 1e-6)


@given(st.integers(1, 200), st.data())
def test_every_coarse_one_has_a_child_and_most_have_their_nearest(num_fine, data):
    num_coarse = data.draw(st.integers(1, num_fine))
    fine, coarse = cloud(num_fine, 1).means, cloud(num_coarse, 2).means
    parents, num_moved = parents_of(fine, coarse)
    assert len(np.unique(parents)) == num_coarse
    nearest = np.linalg.norm(fine[:, None].astype(np.float64) - coarse, axis=2).argmin(axis=1)
    assert (parents != nearest).sum() <= num_moved


def test_a_coarse_one_that_is_nobodys_nearest_takes_a_near_child_that_can_be_spared():
    fine = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], np.float32)
    coarse = np.array([[0.1, 0, 0], [5, 0, 0]], np.float32)
    parents, num_moved = parents_of(fine, coarse)
    assert parents.tolist() == [0, 0, 1] and num_moved == 1


def test_many_at_one_place_are_linked_or_left_out():
    level = cloud(200)
    level.means[:] = 0
    scene = link_levels([Scene.flat(level), Scene.flat(cloud(150, 1))])
    report = json.loads(scene.source.metadata["levels"])
    assert scene.tree.num_leaves == 200 and len(scene) == 350 - report["dropped"]


def test_surroundings_that_are_part_of_every_level_stand_once():
    far, *near = cloud(5, 9), *(cloud(n, n) for n in (80, 20))
    far.means[:] += 1000
    scene = link_levels([Scene.flat(Gaussians.concatenate([g, far])) for g in near])
    assert len(scene) == 80 + 20 + 5
    assert scene.tree.num_leaves == 85


def test_levels_of_the_same_scene_are_one():
    (level,) = levels(30)
    scene = link_levels([level, level, level])
    assert len(scene) == 30 and scene.tree.num_levels == 1


def test_one_level_is_a_flat_scene():
    (level,) = levels(30)
    assert same_rows(link_levels([level]).gaussians, level.gaussians)


def test_the_selection_says_which_profile_is_meant():
    scene = link_levels(levels(60, 20))
    camera = splatree.Camera.look_at((0, 0, -9), (0, 0, 0), width=32, height=32)
    assert "sphere" in splatree.select(scene, camera, SelectOptions(profile="exact")).notes[-1]
    assert not splatree.select(scene, camera, SelectOptions(profile="sphere")).notes


def test_levels_that_cannot_be_linked():
    small, large = levels(10, 20)
    with pytest.raises(InputError, match="finest level first"):
        link_levels([small, large])
    with pytest.raises(InputError, match="no levels"):
        link_levels([])
    with pytest.raises(InputError, match="one mode"):
        link_levels([large, replace(small, mode="antialiased")])
    with pytest.raises(InputError, match="is empty"):
        link_levels([small, Scene.flat(Gaussians.empty(1))])
    with pytest.raises(InputError, match="levels of its own"):
        link_levels([large, link_levels([large, small])])


def test_cuts_of_a_real_streamed_scene_are_like_its_finest_level_from_near_and_far():
    folder = Path(__file__).resolve().parents[3] / "shared" / "data" / "trained" / "playbot"
    if not folder.is_dir():
        pytest.skip("needs the real scenes of ../shared/data")
    levels = [splatree.read(folder, level=i) for i in (3, 4, 5, 6)]  # the finer ones take seconds
    scene = link_levels(levels)
    for distance, pixel_error in ((1.5, 30), (4.0, 20), (4.0, 30)):  # each draws another mixture of levels
        camera = splatree.Camera.look_at((0.3 * distance, -0.5, -distance), (0, -0.5, 0), width=160, height=120)
        wanted = splatree.render(levels[0], camera).image
        frame = splatree.trace(scene, camera, select=SelectOptions(pixel_error=pixel_error, profile="sphere"))
        assert len(frame.selection) < len(levels[0])
        smaller = next(level for level in levels if len(level) <= len(frame.selection))
        # As good as the level of the file with no more nodes; a decibel for the seams between levels.
        assert (
            splatree.psnr(frame.result.image, wanted)
            > splatree.psnr(splatree.render(smaller, camera).image, wanted) - 1
        )
