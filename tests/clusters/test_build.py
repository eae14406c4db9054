import json
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.clusters.build import _large, subtree_runs
from splatree.kernels import reference

from ..scenes import gaussians
from .conftest import balls


def flat(n: int, seed: int) -> st.Scene:
    return st.Scene.flat(gaussians(n, seed))


def check_partition(scene: st.Scene) -> None:
    clusters = scene.clusters
    assert clusters is not None
    assert clusters.num_rows == len(scene)
    slow = reference.spheres.bound_clusters(scene.gaussians, clusters.start, clusters.centers)
    for name in ("radii", "mean_radii", "footprint_radii"):
        assert np.all(getattr(clusters, name) >= getattr(slow, name) * (1 - 1e-7))
    # The compiled boxes are wider by 1e-5 of a reach; 1e-6 of the coordinates is rounding.
    slack = 1e-6 * (np.abs(slow.box_low) + np.abs(slow.box_high))
    assert np.all(clusters.box_low <= slow.box_low + slack) and np.all(clusters.box_high >= slow.box_high - slack)


@pytest.mark.parametrize("size_classes", [False, True])
def test_rows_of_a_flat_scene_are_permuted_with_their_ids(size_classes: bool) -> None:
    scene = flat(500, 1)
    made = st.build_clusters(scene, 20, st.ClusterOptions(size_classes=size_classes))
    check_partition(made)
    assert len(made.clusters) == 20
    assert made.ids is not None
    np.testing.assert_array_equal(np.sort(made.ids), np.arange(500))
    for column in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_array_equal(getattr(made.gaussians, column), getattr(scene.gaussians, column)[made.ids])
    np.testing.assert_array_equal(made.tree.extents, scene.tree.extents[made.ids])


def test_pictures_keep_every_bit(view: tuple[st.Scene, st.Camera]) -> None:
    scene, camera = view
    if len(scene) == 0:
        pytest.skip("nothing to put into clusters")
    made = st.build_clusters(scene, max(1, len(scene) // 8))
    one, other = st.render(scene, camera), st.render(made, camera, select=st.SelectOptions(cull="none"))
    assert one.image.tobytes() == other.image.tobytes()


def test_each_row_is_in_the_cluster_of_its_nearest_centre() -> None:
    made = st.build_clusters(flat(400, 2), 15, st.ClusterOptions(iterations=40))
    of_row = np.repeat(np.arange(15), made.clusters.counts)
    distances = np.linalg.norm(made.gaussians.means[:, None] - made.clusters.centers[None], axis=2)
    # The centres are means of the last assignment: by then few rows, if any, would change.
    assert np.mean(distances.argmin(axis=1) != of_row) < 0.02


def test_large_gaussians_get_clusters_of_their_own() -> None:
    g = gaussians(400, 3)
    g.log_scales[::10] = 0.5  # a tenth is larger than all others
    made = st.build_clusters(st.Scene.flat(g), 20, st.ClusterOptions(size_classes=True))
    largest = made.gaussians.log_scales.max(axis=1) == 0.5
    per_cluster = np.add.reduceat(largest, made.clusters.start[:-1])
    assert set(per_cluster / made.clusters.counts) == {0, 1}
    assert (per_cluster > 0).sum() == 5


def test_of_gaussians_as_large_the_first_along_the_curve_are_large(monkeypatch) -> None:
    sizes = np.float32([1, 2, 2, 3, 2, 1, 2, 0])
    for part in (3, 100):
        monkeypatch.setattr("splatree.clusters.build.ROWS_AT_ONCE", part)
        assert np.flatnonzero(_large(sizes, 3, np.zeros)).tolist() == [1, 2, 3]
        assert np.flatnonzero(_large(sizes, 1, np.zeros)).tolist() == [3]


def test_clusters_of_a_tree_are_complete_subtrees() -> None:
    tree = st.build_lod(flat(600, 4))
    made = st.build_clusters(tree, 30)
    check_partition(made)
    np.testing.assert_array_equal(made.gaussians.means, tree.gaussians.means)
    end, depth = tree.tree.subtree_end, tree.tree.depth
    for first, last in zip(made.clusters.start[:-1], made.clusters.start[1:], strict=True):
        if last - first > 1:
            # Siblings with all their descendants: nothing below them lies elsewhere, and none is below another's parent.
            assert end[first:last].max() == last
            assert depth[first:last].min() == depth[first]
    assert 15 <= len(made.clusters) <= 120


def test_subtree_runs_cover_a_small_forest() -> None:
    scene = flat(7, 5)
    end, depth = np.int32([5, 4, 3, 4, 5, 6, 7]), np.uint8([0, 1, 2, 2, 1, 0, 0])
    assert subtree_runs(end, depth, 7).tolist() == [0, 7]
    assert subtree_runs(end, depth, 3).tolist() == [0, 1, 4, 5, 7]  # the root alone, its children, and the two roots
    assert subtree_runs(end, depth, 1).tolist() == list(range(8))
    assert subtree_runs(scene.tree.subtree_end, scene.tree.depth, 4).tolist() == [0, 4, 7]


def test_the_number_of_clusters_follows_the_scene() -> None:
    assert len(st.build_clusters(flat(300, 6)).clusters) == 300
    rules = json.loads(st.build_clusters(flat(2000, 6)).source.metadata["clusters"])
    assert rules["clusters"] == 1024
    assert rules["version"] == 2


def test_coinciding_gaussians_make_fewer_clusters() -> None:
    scene = flat(50, 7)
    scene.gaussians.means[:] = scene.gaussians.means[0]
    made = st.build_clusters(scene, 5)
    assert len(made.clusters) == 1
    check_partition(made)


def test_levels_built_of_a_clustered_scene_have_no_stale_clusters() -> None:
    made = st.build_lod(st.build_clusters(flat(300, 8), 10))
    assert made.clusters is None
    assert "clusters" not in made.source.metadata


@pytest.mark.parametrize(("number", "message"), [(0, "found 0 for 60"), (61, "found 61 for 60")])
def test_a_number_that_cannot_be_met_is_refused(number: int, message: str) -> None:
    with pytest.raises(st.InputError, match=message):
        st.build_clusters(flat(60, 9), number)


def test_an_empty_scene_is_refused() -> None:
    with pytest.raises(st.InputError, match="without Gaussians"):
        st.build_clusters(st.Scene.flat(st.Gaussians.empty()))


def test_clusters_must_cover_the_scene() -> None:
    made = st.build_clusters(flat(60, 10), 5)
    for start in ([0, 20, 20, 60], [1, 60], [0, 30, 20, 60]):
        count = len(start) - 1
        with pytest.raises(st.ShapeError, match="ascending"):
            balls(np.int32(start), np.zeros((count, 3), np.float32))
    shorter = balls(np.int32([0, 59]), np.zeros((1, 3), np.float32), 1e3)
    with pytest.raises(st.ShapeError, match="clusters of other Gaussians"):
        replace(made, clusters=shorter)
