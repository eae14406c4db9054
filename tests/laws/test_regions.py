"""A box that grows by itself, with some space around it, has the nodes of a build at once, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.lod.assemble import assemble
from splatree.lod.cells import halve
from splatree.lod.forest import forest_of_leaves, forest_of_roots
from splatree.lod.graft import graft
from splatree.lod.grow import grow
from splatree.lod.grow_region import TooNarrowError, grow_region
from splatree.lod.region import EVERYWHERE, Region

from .hard_scenes import hard_scene, hard_scenes
from .test_parts import MODES, check_same_tree, resolved_for


def built_by_boxes(scene, resolved, cell_rows, num_levels, widths, seen=None):
    radii = list(resolved.sizes_from(0, num_levels))
    parts, counts = [], []
    for box in halve(scene.gaussians.means, cell_rows).boxes:
        far = box.distances(scene.gaussians.means)
        reach = widths * sum(radii) + 1e-3
        while True:
            inputs = np.flatnonzero(far <= reach)
            part = st.Scene.flat(scene.gaussians.take(inputs), mode=scene.mode)
            try:
                leaves = forest_of_leaves(
                    part, resolved, inputs=inputs, visibilities=None if seen is None else seen[inputs]
                )
                owned = grow_region(leaves, resolved, Region(box, reach), num_levels=num_levels)
                break
            except TooNarrowError:
                reach = 1.5 * reach
        counts.append(owned.counts)
        if len(owned.rows):
            flat = st.Scene.flat(part.gaussians.take(owned.rows), mode=scene.mode)
            parts.append(assemble(owned.forest, flat, resolved))
    top = grow(forest_of_roots(parts, resolved), resolved)
    return graft(top, parts, resolved), np.sum(counts, axis=0)


@settings(max_examples=60)
@given(
    hard_scenes(degree=1), hs.sampled_from([16, 50, 200]), hs.integers(0, 4), hs.sampled_from([0.5, 3.0, 7.0]), MODES
)
def test_boxes_give_the_tree_of_a_build_at_once(gaussians, cell_rows, num_levels, widths, mode):
    scene = st.Scene.flat(gaussians, mode=mode)
    options = st.BuildOptions(follow=False, visibility=False, radius=0.15, max_roots=1)
    whole = st.build_lod(scene, options)
    found, counts = built_by_boxes(scene, resolved_for(scene, options), cell_rows, num_levels, widths)
    # A build at once ends when one node is left, so there may be no more levels than that takes.
    if (counts[:-1] > 1).all():
        check_same_tree(found, whole)


@settings(max_examples=60)
@given(
    hard_scenes(degree=1), hs.sampled_from([16, 50]), hs.integers(1, 4), hs.sampled_from([0.5, 7.0]), hs.integers(0, 99)
)
def test_boxes_give_the_same_tree_where_merges_are_limited_by_what_they_change(
    gaussians, cell_rows, num_levels, widths, seed
):
    scene = st.Scene.flat(gaussians)
    resolved = resolved_for(scene, st.BuildOptions(radius=0.15, max_roots=1))
    assert resolved.visibility
    seen = np.random.default_rng(seed).random(len(gaussians), np.float32)
    whole = grow(forest_of_leaves(scene, resolved, visibilities=seen), resolved)
    found, counts = built_by_boxes(scene, resolved, cell_rows, num_levels, widths, seen)
    if (counts[:-1] > 1).all():
        check_same_tree(found, assemble(whole, scene, resolved))


def test_what_is_seen_of_a_scene_is_seen_of_its_roots():
    """Visibilities of merged Gaussians are means by weight, so their weighted sum is kept."""
    scene = st.Scene.flat(hard_scene(400, "surface", 3))
    resolved = resolved_for(scene, st.BuildOptions(radius=0.3, max_roots=1))
    leaves = forest_of_leaves(
        scene, resolved, visibilities=np.random.default_rng(0).uniform(0.01, 1, 400).astype(np.float32)
    )
    grown = grow(leaves, resolved, num_levels=4)
    assert len(grown.roots) < 200
    assert grown.root_weights @ grown.visibilities == pytest.approx(leaves.root_weights @ leaves.visibilities, rel=1e-5)


@pytest.mark.parametrize("shape", ["line", "surface"])
def test_long_chains_of_neighbours_are_followed(shape):
    """Rows alike in size and opacity decide by their numbers: chains are long, and what is loaded at first is too little."""
    scene = st.Scene.flat(hard_scene(1500, shape, 1, equal=True))
    options = st.BuildOptions(follow=False, visibility=False, radius=0.3, max_roots=1, color_radius=None)
    found, _ = built_by_boxes(scene, resolved_for(scene, options), 100, 2, 1.0)
    check_same_tree(found, st.build_lod(scene, options))


def test_everywhere_is_a_region_that_owns_all():
    scene = st.Scene.flat(hard_scene(300, "surface", 4, degree=1))
    options = st.BuildOptions(follow=False, visibility=False, radius=0.2, max_roots=1)
    resolved = resolved_for(scene, options)
    owned = grow_region(forest_of_leaves(scene, resolved), resolved, Region(EVERYWHERE, np.inf), num_levels=4)
    grown = grow(forest_of_leaves(scene, resolved), resolved, num_levels=4)
    part = st.Scene.flat(scene.gaussians.take(owned.rows))
    check_same_tree(assemble(owned.forest, part, resolved), assemble(grown, scene, resolved))
    assert owned.counts[-1] == len(grown.roots)


def test_a_region_that_is_too_small_is_told():
    scene = st.Scene.flat(hard_scene(100, "surface", 1))
    resolved = resolved_for(scene, st.BuildOptions(follow=False, visibility=False, radius=0.2))
    box = halve(scene.gaussians.means, 30).boxes[0]
    inputs = np.flatnonzero(box.distances(scene.gaussians.means) <= 0.5)
    part = st.Scene.flat(scene.gaussians.take(inputs))
    with pytest.raises(TooNarrowError, match=r"found 0\.5 world units known around the box"):
        grow_region(forest_of_leaves(part, resolved, inputs=inputs), resolved, Region(box, 0.5), num_levels=2)
    with pytest.raises(st.InputError, match="found method 'pairs'"):
        pairs = resolved_for(scene, st.BuildOptions(follow=False, method="pairs"))
        grow_region(forest_of_leaves(scene, pairs), pairs, Region(EVERYWHERE, np.inf), num_levels=1)


@given(hs.integers(1, 2000), hs.integers(1, 300), hs.integers(0, 10**6))
def test_cells_are_as_few_as_can_be_and_equally_large(num_points, most, seed):
    points = np.random.default_rng(seed).permutation(3 * num_points).reshape(-1, 3).astype(np.float32)  # all apart
    cells = halve(points, most)
    sizes = np.bincount(cells.of(points), minlength=len(cells))
    assert len(cells) == -(-num_points // most) and sizes.max() <= most
    assert np.ptp(sizes) <= np.log2(len(cells)) + 1  # each cut rounds to whole rows
