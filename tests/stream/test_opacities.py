"""Opacities of levels that are looked at from nearer than their nodes were made for."""

import numpy as np
import pytest

import splatree as st
from splatree.stream.chunks import chunks_of_tree
from splatree.stream.levels import levels_of_tree
from splatree.stream.opacities import logits_of_level

from .conftest import forest


def coverage(scene, rows, h):
    """Σ α A(Σ + h I) of some rows, one at a time."""
    total = 0.0
    for row in rows:
        x, y, z = np.sqrt(np.exp(2 * scene.gaussians.log_scales[row].astype(float)) + h)
        total += (x * y + y * z + z * x) / (1 + np.exp(-float(scene.gaussians.logit_opacities[row])))
    return total


@pytest.mark.parametrize("drawn_px", [2.0, 6.0, 50.0])
def test_a_node_covers_what_its_leaves_cover_where_it_is_drawn(drawn_px):
    scene = forest(300, seed=8)
    scene.gaussians.logit_opacities[:] -= 3  # far from the largest opacity
    tree = scene.tree
    levels = levels_of_tree(tree, chunks_of_tree(scene, 50), num_levels=3)
    for level in levels[1:]:
        found = logits_of_level(scene, level, level.rows, drawn_px)
        for row, logit in zip(level.rows, found, strict=True):
            if tree.subtree_end[row] == row + 1:
                assert logit == scene.gaussians.logit_opacities[row]
                continue
            below = np.arange(row + 1, tree.subtree_end[row])
            leaves = below[tree.is_leaf[below]]
            made, drawn = 0.3 * (float(tree.extents[row]) / 3) ** 2, 0.3 * (level.size / drawn_px) ** 2
            ratio = coverage(scene, leaves, drawn) / coverage(scene, [row], drawn)
            ratio /= coverage(scene, leaves, made) / coverage(scene, [row], made)
            opacity = min(ratio / (1 + np.exp(-float(scene.gaussians.logit_opacities[row]))), 0.999)
            assert 1 / (1 + np.exp(-float(logit))) == pytest.approx(opacity, rel=1e-5)


def test_opacities_stay_where_nodes_are_drawn_as_they_were_made():
    scene = forest(300, seed=8)
    level = levels_of_tree(scene.tree, chunks_of_tree(scene, 50), num_levels=3)[2]
    kept = scene.gaussians.logit_opacities[level.rows]
    assert np.array_equal(logits_of_level(scene, level, level.rows, 3.0), kept)
    antialiased = st.Scene(scene.gaussians, scene.tree, mode="antialiased")
    assert np.array_equal(logits_of_level(antialiased, level, level.rows, 7.5), kept)


def test_a_level_seen_from_near_is_nearer_to_the_leaves(city_tree):
    """Brightness and PSNR of a coarse level whose nodes are drawn larger than they were made for, against all leaves."""
    level = levels_of_tree(city_tree.tree, chunks_of_tree(city_tree), num_levels=3)[2]
    camera = st.orbit(city_tree, st.PathOptions(views=1, width=600, height=400))[0]
    every_leaf = st.SelectOptions(pixel_error=0)
    truth = st.render(city_tree, camera, select=every_leaf).image
    images = []
    for drawn_px in (3.0, 7.5):
        part = city_tree.gaussians.take(level.rows)
        part.logit_opacities[:] = logits_of_level(city_tree, level, level.rows, drawn_px)
        images.append(st.render(st.Scene.flat(part), camera, select=every_leaf).image)
    as_made, as_drawn = (st.psnr(image, truth) for image in images)
    assert as_drawn > as_made + 0.2, (as_made, as_drawn)  # 0.3 dB: the nodes themselves are right at their own pixel
    assert abs(images[1].mean() / truth.mean() - 1) < 0.03
