"""The kernel that fits merged Gaussians to the pixel of their level, held to its reference (kernels/reference/curves.py)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st_

import splatree as st
from splatree.kernels.cpu.build import curves as kernel
from splatree.kernels.reference import curves as reference
from splatree.lod.follow import STORED_SHARE, dilations_of_extents, least_dilation
from splatree.maths.covariance import covariances_from_gaussians
from splatree.scene.gaussians import Gaussians

from ..scenes import cloud


def tree_over(gaussians: Gaussians, method: str = "radius") -> st.Scene:
    return st.build_lod(st.Scene.flat(gaussians), st.BuildOptions(method=method, max_roots=2, follow=False))  # type: ignore[arg-type]


def both(
    scene: st.Scene,
    seen: np.ndarray,
    *,
    kept_extent: float = 0.0,
    dilations: tuple[float, float] = (0.0, 0.0),
) -> list[tuple[Gaussians, np.ndarray]]:
    arguments = scene.gaussians, scene.tree.subtree_end, seen, 0.4, scene.tree.extents
    limits = dict(zip(("kept_extent", "kept_dilation", "least_dilation"), (kept_extent, *dilations), strict=True))
    return [machine.fit_curves(*arguments, **limits) for machine in (kernel, reference)]


@given(
    n=st_.integers(2, 60),
    seed=st_.integers(0, 2**20),
    method=st_.sampled_from(["radius", "pairs"]),
    share_kept=st_.sampled_from([0.0, 0.5, 1.0]),
    dilations=st_.tuples(st_.sampled_from([0.0, 1e-3, 0.1]), st_.sampled_from([0.0, 0.05, 10.0])),
)
@settings(max_examples=40, deadline=None)
def test_the_kernel_is_the_reference(n, seed, method, share_kept, dilations):
    rng = np.random.default_rng(seed)
    scene = tree_over(cloud(n, seed, log_scales=("normal", -3.0, 1.5), logits=("normal", 0.0, 3.0)), method)
    seen = rng.uniform(0.01, 1, len(scene)).astype(np.float32)
    kept_extent = float(np.quantile(scene.tree.extents, share_kept))
    (found, curves), (wanted, expected) = both(scene, seen, kept_extent=kept_extent, dilations=dilations)
    # The kernel keeps a leaf's opacity as float32, 6e-8 of it; what it gives is rounded to float32 once more.
    np.testing.assert_allclose(curves, expected, rtol=1e-6)
    np.testing.assert_allclose(found.means, wanted.means, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.logit_opacities, wanted.logit_opacities, rtol=1e-5, atol=1e-5)
    # Axes of nearly equal length may turn, so shapes are compared and not axes. A float32 logarithm of size 10 is good to 1e-6.
    shapes = [covariances_from_gaussians(g.quats, g.log_scales) for g in (found, wanted)]
    sizes = np.trace(shapes[1], axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(shapes[0] / sizes, shapes[1] / sizes, atol=5e-6)
    leaf = scene.tree.is_leaf
    for name in ("means", "quats", "log_scales", "logit_opacities"):
        np.testing.assert_array_equal(getattr(found, name)[leaf], getattr(scene.gaussians, name)[leaf])


def test_nodes_of_leaves_that_are_all_invisible_stay_finite():
    """Some programs hide a Gaussian by a logit far below that of any opacity: nothing is shown, at any dilation."""
    hidden = replace(cloud(20, 1), logit_opacities=np.full(20, -1e10, np.float32))
    scene = tree_over(hidden, "pairs")
    (found, curves), (wanted, expected) = both(
        scene, np.ones(len(scene), np.float32), kept_extent=1e9, dilations=(0.1, 0.1)
    )
    for g in (found, wanted):
        assert np.isfinite(g.log_scales).all() and np.isfinite(g.logit_opacities).all()
        assert g.opacities()[~scene.tree.is_leaf].max() < 2e-6  # the least opacity of a node
    np.testing.assert_allclose(curves, expected, rtol=1e-6)


def test_any_number_of_threads_gives_the_same_bits():
    """More rows than one thread takes at a time."""
    scene = tree_over(cloud(30_000, 3, log_scales=("normal", -4.0, 1.0)))
    seen = np.random.default_rng(4).uniform(0.01, 1, len(scene)).astype(np.float32)
    arguments = scene.gaussians, scene.tree.subtree_end, seen, 0.4, scene.tree.extents
    one, many = (kernel.fit_curves(*arguments, threads=t) for t in (1, 7))
    np.testing.assert_array_equal(one[1], many[1])
    for name in ("means", "quats", "log_scales", "logit_opacities"):
        np.testing.assert_array_equal(getattr(one[0], name), getattr(many[0], name))


@pytest.mark.parametrize("log_scale", [-200.0, 40.0, 87.0])
def test_absurd_sizes_are_drawn_as_stored(log_scale):
    """Nodes beyond float32's squares have no curve; what is stored of them stays finite."""
    g = cloud(12, 1)
    scene = tree_over(g)
    columns = replace(scene.gaussians, log_scales=np.full_like(scene.gaussians.log_scales, log_scale))
    (found, curves), (_, expected) = both(
        replace(scene, gaussians=columns, blocks=None), np.ones(len(scene), np.float32)
    )
    np.testing.assert_allclose(curves, expected, rtol=1e-5)
    inner = ~scene.tree.is_leaf
    assert inner.any()
    assert curves[inner].any() == (log_scale < 0)
    for name in ("means", "quats", "log_scales", "logit_opacities"):
        assert np.isfinite(getattr(found, name)).all()


def test_one_node_of_two_equal_leaves_has_twice_their_mass():
    """Closed form: two balls at one place with opacity ½: m = 2 ½ A(0), n = 1, and the mass 1 at any pixel."""
    two = Gaussians(
        np.zeros((3, 3), np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (3, 1)),
        np.zeros((3, 3), np.float32),
        np.zeros(3, np.float32),
        np.zeros((3, 1, 3), np.float32),
    )
    end = np.array([3, 2, 3], np.int32)
    found, curves = kernel.fit_curves(two, end, np.ones(3, np.float32), 0.5, np.ones(3, np.float32))
    np.testing.assert_allclose(curves[0], [1, 1, 1, 0.5], rtol=1e-6)
    wide = (1 / 0.99) ** 0.3
    np.testing.assert_allclose(found.scales()[0] ** 2, wide + (wide - 1) * 0.5, rtol=1e-6)
    assert found.opacities()[0] == pytest.approx(0.99)


@given(
    n=st_.integers(3, 80),
    seed=st_.integers(0, 2**20),
    most=st_.sampled_from([2, 5, 20]),
    at_once=st_.sampled_from([1, 7, 100]),
    stored=st_.sampled_from([0.0, 0.5]),
)
@settings(max_examples=40, deadline=None)
def test_a_tree_that_is_cut_is_fitted_with_the_bits_of_the_whole_tree(n, seed, most, at_once, stored):
    scene = tree_over(cloud(n, seed, log_scales=("normal", -3.0, 1.5), logits=("normal", 0.0, 3.0)))
    ends, is_leaf = scene.tree.subtree_end, scene.tree.is_leaf
    seen = np.random.default_rng(seed).uniform(0.01, 1, len(scene)).astype(np.float32)
    least, extents = least_dilation(stored), scene.tree.extents
    wanted, curves = kernel.fit_curves(scene.gaussians, ends, seen, STORED_SHARE, extents, least_dilation=least)
    roots, row = [], 0
    is_above = np.zeros(len(scene), bool)
    while row < len(scene):
        is_above[row] = True
        is_small = bool(ends[row] - row <= most)
        roots += [row] if is_small else []
        row = int(ends[row]) if is_small else row + 1
    below = [
        kernel.root_moments(
            scene.gaussians.rows(root, ends[root]),
            ends[root : ends[root]] - np.int32(root),
            1,
            seen=seen[root : ends[root]],
        )
        for root in roots
    ]
    rows, moments = np.flatnonzero(is_above), np.concatenate(below)
    above, own_ends = scene.gaussians.take(rows), np.searchsorted(rows, ends[rows]).astype(np.int32)
    nodes = rows[own_ends > np.arange(1, len(rows) + 1)]
    dilations, sums = dilations_of_extents(extents[nodes], stored), np.zeros((len(nodes), 2))
    before = np.concatenate([[0], np.cumsum(is_leaf)])
    leaves = scene.gaussians.take(is_leaf)
    for first in range(0, len(leaves), at_once):
        some = slice(first, first + at_once)
        columns = leaves.log_scales[some], leaves.logit_opacities[some], seen[is_leaf][some]
        kernel.add_shown(*columns, first, (before[nodes], before[ends[nodes]]), dilations, sums)
    found, found_curves = kernel.fit_curves_above(
        *(above, own_ends, moments, STORED_SHARE, extents[rows], sums), least_dilation=least
    )
    at = np.searchsorted(rows, nodes)
    assert found_curves[at].tobytes() == curves[nodes].tobytes()
    for name in ("means", "quats", "log_scales", "logit_opacities"):
        assert getattr(found, name)[at].tobytes() == getattr(wanted, name)[nodes].tobytes(), name
