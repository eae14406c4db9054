"""Chunks hold every leaf once, levels are cuts, and any mix of levels over chunks is a cut."""

from itertools import pairwise
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from splatree import InputError
from splatree.lod.select import count_nested, count_uncovered
from splatree.stream import levels
from splatree.stream.chunks import chunks_of_tree, leaves_of_chunk
from splatree.stream.levels import cuts_of, intervals_of, levels_of_tree

from .conftest import forest

forests = some.builds(
    lambda n, roots, seed: forest(max(n, roots), seed=seed, num_roots=roots),
    some.integers(1, 250),
    some.integers(1, 6),
    some.integers(0, 10_000),
)


def leaves_of(scene, start, end):
    return np.flatnonzero(scene.tree.is_leaf[start:end]) + start


@given(forests, some.integers(1, 40))
@settings(max_examples=60, deadline=None)
def test_chunks_are_sibling_subtrees_and_hold_every_leaf_once(scene, chunk_leaves):
    chunks = chunks_of_tree(scene, chunk_leaves)
    tree = scene.tree
    held = [leaves_of(scene, a, b) for a, b in zip(chunks.start, chunks.end, strict=True)]
    assert np.array_equal(np.concatenate(held), np.flatnonzero(tree.is_leaf))
    for start, end, leaves in zip(chunks.start, chunks.end, held, strict=True):
        assert 1 <= len(leaves) <= chunk_leaves
        row, depth = start, tree.depth[start]
        while row < end:
            assert tree.depth[row] == depth  # siblings, or roots
            row = tree.subtree_end[row]
        assert row == end
        assert not chunks.is_spine[start:end].any()
    assert chunks.is_spine.sum() == len(tree) - (chunks.end - chunks.start).sum()


def first_small_row_on_each_path(scene, chunks, size):
    """The definition of a cut, path by path."""
    tree, found = scene.tree, set()
    for leaf in np.flatnonzero(tree.is_leaf):
        path = [row for row in range(leaf + 1) if tree.subtree_end[row] > leaf and not chunks.is_spine[row]]
        found.add(next((row for row in path if tree.extents[row] <= size), leaf))
    return sorted(found)


@given(forests, some.integers(1, 40), some.floats(0, 3))
@settings(max_examples=40, deadline=None)
def test_a_cut_is_the_first_small_row_on_each_path(scene, chunk_leaves, size):
    chunks = chunks_of_tree(scene, chunk_leaves)
    found = intervals_of(scene.tree, chunks).rows_at(size)
    assert found.tolist() == first_small_row_on_each_path(scene, chunks, np.float32(size))


@given(forests, some.integers(1, 40), some.sampled_from([1.5, 2.0, 4.0]), some.randoms(use_true_random=False))
@settings(max_examples=60, deadline=None)
def test_any_mix_of_levels_over_chunks_is_a_cut(scene, chunk_leaves, ratio, random):
    chunks = chunks_of_tree(scene, chunk_leaves)
    levels = levels_of_tree(scene.tree, chunks, ratio=ratio, num_levels=6)
    assert np.array_equal(levels[0].rows, np.flatnonzero(scene.tree.is_leaf))
    assert all(len(coarse) < len(fine) for fine, coarse in pairwise(levels))
    chosen = np.concatenate([random.choice(levels).of_chunk(chunk) for chunk in range(len(chunks))])
    assert count_nested(scene.tree, chosen) == 0
    assert count_uncovered(scene.tree, chosen) == 0


@given(forests, some.integers(1, 40), some.floats(0.5, 300.0))
@settings(max_examples=60, deadline=None)
def test_all_cuts_are_counted_and_the_nearest_is_found(scene, chunk_leaves, target):
    intervals = intervals_of(scene.tree, chunks_of_tree(scene, chunk_leaves))
    with mock.patch.object(levels, "_ROWS_AT_ONCE", 7):
        sizes, counts = cuts_of(intervals)
        cuts = [intervals.rows_at(float(size)) for size in sizes]
    from_size = intervals.from_sizes(slice(0, len(scene)))
    is_used = from_size < intervals.to_size
    np.testing.assert_array_equal(sizes, np.unique(from_size[is_used & (from_size > 0)]))
    assert counts.tolist() == [len(cut) for cut in cuts] == sorted(counts.tolist(), reverse=True)
    assert all((np.diff(cut) > 0).all() for cut in cuts)
    if len(sizes):
        assert levels._nearest(counts, target) == np.argmin(np.abs(np.log(counts / target)))


def test_levels_by_a_radius_have_cuts_of_any_size(city_tree):
    """Extents differ within a level. With one extent a level, cuts come in steps."""
    _, counts = cuts_of(intervals_of(city_tree.tree))
    counts = counts[counts >= city_tree.tree.num_leaves / 64].astype(np.float64)
    assert (counts[:-1] / counts[1:]).max() < 1.01


def test_levels_shrink_by_the_ratio_to_a_sixty_fourth(city_tree):
    chunks = chunks_of_tree(city_tree)
    counts = [len(level) for level in levels_of_tree(city_tree.tree, chunks)]
    np.testing.assert_allclose(counts, counts[0] / np.array([1, 2.5, 2.5**2, 2.5**3, 2.5**4, 64]), rtol=0.01)
    counts = [len(level) for level in levels_of_tree(city_tree.tree, chunks, ratio=2)]
    np.testing.assert_allclose(counts, counts[0] / 2.0 ** np.arange(7), rtol=0.01)
    counts = [len(level) for level in levels_of_tree(city_tree.tree, chunks, ratio=4, num_levels=3)]
    np.testing.assert_allclose(counts, counts[0] / 4.0 ** np.arange(3), rtol=0.01)


@pytest.mark.parametrize(("num_leaves", "wanted"), [(100, 2048), (524_320, 4096), (4_250_000, 16_384)])
def test_a_small_scene_has_small_chunks(num_leaves, wanted):
    assert leaves_of_chunk(num_leaves) == wanted


def test_chunks_suit_the_scene_where_nothing_is_asked_for(city_tree):
    chunks = chunks_of_tree(city_tree)
    assert 0.75 <= len(chunks) / (city_tree.tree.num_leaves / 2048) <= 2


def test_a_far_outlier_gets_a_chunk_of_its_own():
    scene = forest(400, seed=2, num_roots=40)
    roots = np.flatnonzero(scene.tree.depth == 0)
    far = int(roots[20])
    scene.gaussians.means[far : scene.tree.subtree_end[far]] += 1e4
    chunks = chunks_of_tree(scene, 10_000)
    assert len(chunks) == 3
    assert chunks.start[1] == far and chunks.end[1] == scene.tree.subtree_end[far]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ratio": 1.0}, "ratio: found 1.0, wanted at least 1.2"),
        ({"num_levels": 0}, "levels: found 0, wanted at least 1"),
    ],
)
def test_a_ladder_that_cannot_be_is_refused(arguments, message):
    scene = forest(20, seed=0)
    with pytest.raises(InputError, match=message):
        levels_of_tree(scene.tree, chunks_of_tree(scene, 10), **arguments)
