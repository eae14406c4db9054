import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatree import BuildOptions, Gaussians, InputError, MergeOptions, Scene, build_lod
from splatree.lod.grow_radius import extents_of
from splatree.lod.report import report_levels
from splatree.maths.covariance import covariances_from_gaussians

from ..scenes import surface

NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")


def parents_of(scene: Scene) -> np.ndarray:
    """Row of the parent of each row, −1 for roots."""
    parents = np.full(len(scene), -1)
    for i, end in enumerate(scene.tree.subtree_end):
        child = i + 1
        while child < end:
            parents[child] = i
            child = scene.tree.subtree_end[child]
    return parents


def check_moments(scene: Scene, *, num_merges: int) -> None:
    """Mean, covariance and harmonics of each inner node are those of its leaves by opacity, after so many merges at most."""
    g, is_leaf = scene.gaussians, scene.tree.is_leaf
    covariances = covariances_from_gaussians(g.quats, g.log_scales)
    for i in np.flatnonzero(~is_leaf):
        rows = np.arange(i, scene.tree.subtree_end[i])
        rows = rows[is_leaf[rows]]
        w = 1 / (1 + np.exp(-g.logit_opacities[rows].astype(np.float64)))
        w /= w.sum()
        x = g.means[rows].astype(np.float64)
        mean = w @ x
        expected = np.einsum("n,nij->ij", w, covariances[rows] + np.einsum("ni,nj->nij", x - mean, x - mean))
        # Each merge rounds to float32, which is 5e-7 at the edge of the surface; a covariance passes through a rotation too.
        np.testing.assert_allclose(g.means[i], mean, atol=1e-6 * num_merges)
        np.testing.assert_allclose(covariances[i], expected, atol=2e-6 * num_merges * expected.max())
        np.testing.assert_allclose(g.sh[i], np.einsum("n,nkc->kc", w, g.sh[rows].astype(np.float64)), atol=1e-5)


small_scenes = st.builds(surface, st.integers(0, 150), st.integers(0, 1000), st.sampled_from([0, 1, 2]))


@given(small_scenes, st.sampled_from(["classic", "antialiased"]), st.integers(1, 10))
def test_leaves_are_the_input_bit_for_bit(gaussians, mode, max_roots):
    scene = build_lod(Scene.flat(gaussians, mode=mode), BuildOptions(max_roots=max_roots))
    leaves = np.flatnonzero(scene.tree.is_leaf)
    assert len(leaves) == len(gaussians)
    rows = scene.ids[leaves]
    np.testing.assert_array_equal(np.sort(rows), np.arange(len(gaussians)))
    for name in NAMES:
        assert getattr(scene.gaussians, name)[leaves].tobytes() == getattr(gaussians, name)[rows].tobytes()
    assert len(np.unique(scene.ids)) == len(scene)
    assert scene.mode == mode


@given(small_scenes)
def test_inner_nodes_have_two_children_or_more(gaussians):
    scene = build_lod(Scene.flat(gaussians), BuildOptions(max_roots=1, color_radius=None))
    parents = parents_of(scene)
    inner = np.flatnonzero(~scene.tree.is_leaf)
    assert (np.bincount(parents[parents >= 0], minlength=len(scene))[inner] >= 2).all()
    assert (parents < 0).sum() == min(1, len(gaussians))


@given(small_scenes, st.sampled_from(["classic", "antialiased"]), st.sampled_from([1.3, 2.0, 3.0]))
def test_extents_lie_within_their_level_and_grow_upwards(gaussians, mode, growth):
    """So levels are drawn one after the other, and extents by rule are those of no other level."""
    scene = build_lod(Scene.flat(gaussians, mode=mode), BuildOptions("radius", max_roots=2, growth=growth))
    if scene.tree.record is None or len(scene) == len(gaussians):
        return
    extents, inner = scene.tree.extents.astype(np.float64), np.flatnonzero(~scene.tree.is_leaf)
    radii = np.array(scene.tree.record.steps)
    nearest = radii[np.abs(np.log(extents[inner, None] / (2 * radii))).argmin(axis=1)]
    assert (np.abs(np.log(extents[inner] / (2 * nearest))) < np.log(growth) / 2).all()
    parents = parents_of(scene)
    below = inner[parents[inner] >= 0]
    assert (extents[below] < extents[parents[below]]).all()


def test_large_nodes_of_a_level_are_drawn_from_farther_away():
    """By the closed form: e = 2 r (1.5 σ / r)^¼ near a usual node, and never beyond half a level."""
    many = surface(60, 1)
    sizes = np.geomspace(1e-3, 1e3, 60)
    many = dataclasses.replace(many, log_scales=np.repeat(np.log(sizes), 3).reshape(60, 3).astype(np.float32))
    extents = extents_of(many, radius=0.3, growth=2.0)
    assert (np.diff(extents) > 0).all()
    usual = np.abs(np.log(1.5 * sizes / 0.3)) < 0.3
    np.testing.assert_allclose(extents[usual], 0.6 * (1.5 * sizes[usual] / 0.3) ** 0.25, rtol=2e-3)
    assert extents.min() > 0.6 / np.sqrt(2) and extents.max() < 0.6 * np.sqrt(2)


def test_what_changes_the_picture_least_becomes_a_node_first():
    """Two pairs of needles equally far apart: those along one line are nearly one needle, those across each other are not."""
    length = np.log([0.4, 0.02, 0.02])
    along, across = [1, 0, 0, 0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    needles = Gaussians(
        np.float32([[0, 0, 0], [0.3, 0, 0], [0, 50, 0], [0.3, 50, 0]]),
        np.float32([along, along, along, across]),
        np.tile(length, (4, 1)).astype(np.float32),
        np.zeros(4, np.float32),
        np.zeros((4, 1, 3), np.float32),
    )

    def extents(**options):
        scene = build_lod(Scene.flat(needles), BuildOptions("radius", radius=0.4, max_roots=1, **options))
        is_pair = scene.tree.subtree_end - np.arange(len(scene)) == 3
        return dict(zip(np.round(scene.gaussians.means[is_pair, 1]), scene.tree.extents[is_pair], strict=True))

    limited, by_distance = extents(), extents(visibility=False)
    assert by_distance[0.0] == pytest.approx(by_distance[50.0], rel=0.5) and limited[0.0] == by_distance[0.0]
    assert limited[50.0] > 1.5 * limited[0.0]


@pytest.mark.parametrize("log_scale", [-1e4, 0.0, 1e4])
@pytest.mark.parametrize("radius", [1e-45, 1e30])
def test_extents_of_absurd_levels_are_numbers(log_scale, radius):
    """Above 0, for at a τ_R of 0 all leaves are drawn."""
    odd = dataclasses.replace(surface(5, 1), log_scales=np.full((5, 3), log_scale, np.float32))
    extents = extents_of(odd, radius=radius, growth=2.0)
    assert np.isfinite(extents).all() and (extents > 0).all()


def test_gaussians_at_one_place_are_drawn_by_the_ball_around_them():
    one = surface(90, 3)
    one = dataclasses.replace(one, means=np.zeros_like(one.means))
    scene = build_lod(Scene.flat(one), BuildOptions("radius", max_roots=1, color_radius=None, follow=False))
    reach = 3 * np.exp(scene.gaussians.log_scales.max(axis=1).astype(np.float64))
    assert scene.tree.depth[0] == 0 and (scene.tree.depth == 0).sum() == 1
    assert scene.tree.extents[0] >= reach.max()


def test_an_inner_node_has_the_mean_and_covariance_of_its_leaves():
    merge = MergeOptions(opacity="union", weight="opacity")
    options = BuildOptions(max_roots=4, color_radius=None, merge=merge, follow=False)
    check_moments(build_lod(Scene.flat(surface(400, degree=1)), options), num_merges=10)


def test_result_does_not_depend_on_threads():
    flat = Scene.flat(surface(3000, degree=1))
    one, two = (build_lod(flat, threads=threads) for threads in (1, 2))
    for name in NAMES:
        assert getattr(one.gaussians, name).tobytes() == getattr(two.gaussians, name).tobytes()
    for name in ("subtree_end", "depth", "extents"):
        assert getattr(one.tree, name).tobytes() == getattr(two.tree, name).tobytes()


def test_building_again_from_a_tree_uses_its_leaves():
    scene = build_lod(Scene.flat(surface(500)))
    again = build_lod(scene)
    assert again.tree.num_leaves == 500
    leaves = again.tree.is_leaf
    np.testing.assert_array_equal(np.sort(again.ids[leaves]), np.arange(500))


def test_given_ids_are_kept():
    gaussians = surface(50)
    ids = np.arange(50, dtype=np.uint32) * 7 + 3
    ids[-1] = 2**32 - 1
    for given_ids in (ids[:-1], ids):
        n = len(given_ids)
        scene = Scene.flat(gaussians.take(np.arange(n)))
        scene = Scene(scene.gaussians, scene.tree, ids=given_ids)
        built = build_lod(scene, BuildOptions(max_roots=1))
        assert len(np.unique(built.ids)) == len(built)
        if given_ids.max() < 2**32 - 1:  # above the largest there is room for the inner nodes
            np.testing.assert_array_equal(np.sort(built.ids[built.tree.is_leaf]), given_ids)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_smallest_scenes(n):
    scene = build_lod(Scene.flat(surface(n)), BuildOptions(max_roots=1, color_radius=None))
    assert len(scene) == (0, 1, 3)[n]


def test_identical_gaussians_become_one_root():
    scene = build_lod(Scene.flat(surface(1).take(np.zeros(1000, np.int64))))
    assert len(scene) == 1001
    assert scene.tree.num_levels == 2


def test_far_outliers_and_enormous_scales_build():
    g = surface(300)
    means, log_scales = g.means.copy(), g.log_scales.copy()
    means[:3] = [[1e30, 0, 0], [-1200, 1200, 0], [0, 0, -1e20]]
    log_scales[3:6] = 80.0
    scene = build_lod(Scene.flat(Gaussians(means, g.quats, log_scales, g.logit_opacities, g.sh)))
    assert scene.tree.num_leaves == 300
    assert np.isfinite(scene.gaussians.log_scales).all()


def test_rules_and_counts_are_in_the_metadata():
    options = BuildOptions(growth=1.5, merge=MergeOptions(opacity="union"))
    scene = build_lod(Scene.flat(surface(200), mode="antialiased"), options)
    levels = json.loads(scene.source.metadata["levels"])
    assert levels["growth"] == 1.5
    assert levels["merge"]["opacity"] == "union"
    assert levels["merge"]["dilation"] == 0.0
    assert levels["mode"] == "antialiased"
    assert levels["nodes"][0] == 200
    classic = build_lod(Scene.flat(surface(200)))
    merge = json.loads(classic.source.metadata["levels"])["merge"]
    # 0.3 px² where a node of σ² + 0.3 = 1 px² is seen from √2 times as far.
    assert merge["dilation"] == pytest.approx(0.3 * 2 / 0.7)
    assert merge["weight"] == "opacity"
    assert levels["merge"]["weight"] == "opacity-area"


def test_report_counts_every_node_once():
    scene = build_lod(Scene.flat(surface(1000)))
    report = report_levels(scene)
    assert sum(report.nodes_per_depth) == len(scene) == report.num_nodes
    assert sum(report.fan_out.values()) == len(scene) - report.num_leaves
    assert sum(children * nodes for children, nodes in report.fan_out.items()) == len(scene) - report.num_roots
    assert report.num_bytes == scene.gaussians.nbytes + 9 * len(scene)
    assert report.num_roots == (scene.tree.depth == 0).sum() < len(scene)


def test_report_of_nothing_is_empty():
    report = report_levels(Scene.flat(Gaussians.empty()))
    assert (report.num_nodes, report.num_leaves, report.num_roots, report.num_bytes) == (0, 0, 0, 0)
    assert (report.nodes_per_depth, report.fan_out) == ((), {})


@pytest.mark.parametrize(
    "wrong", [{"radius": 0.0}, {"radius": float("nan")}, {"growth": 1.0}, {"max_roots": 0}, {"color_radius": -1.0}]
)
def test_impossible_options_are_refused(wrong):
    with pytest.raises(InputError):
        BuildOptions(**wrong)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"method": "radius", "pixel_size": 0.2}, r"pixel_size: found 0\.2, but the method 'radius' does not use it"),
        ({"radius": 0.2, "pixel_size": 0.1}, r"radius: found 0\.2, but the method 'pairs'|pixel_size: found 0\.1"),
        ({"method": "pairs", "radius": 0.1}, r"radius: found 0\.1, .* wanted 'auto'; leave it out, or .* 'radius'"),
        ({"method": "pairs", "importance": "opacity"}, "importance: found 'opacity'"),
        ({"method": "pairs", "color_radius": None}, "color_radius: found None"),
    ],
)
def test_options_of_the_other_method_are_refused(given, found):
    with pytest.raises(InputError, match=found):
        BuildOptions(**given)


def test_not_finite_rows_are_named():
    g = surface(10)
    means = g.means.copy()
    means[6, 1] = np.inf
    with pytest.raises(InputError, match=r"means\[6\]"):
        build_lod(Scene.flat(Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh)))
