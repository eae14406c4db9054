"""Merged Gaussians that follow the pixel they are drawn at (lod/follow.py)."""

from dataclasses import replace
from importlib.resources import as_file, files

import numpy as np
import pytest

import splatree as st
from splatree.edit.edit import edit
from splatree.edit.options import EditOptions
from splatree.kernels.reference.project import follow
from splatree.lod.follow import with_curves
from splatree.maths.covariance import covariances_from_gaussians

from ..scenes import surface

METHODS = ("radius", "pairs")


def built(method: str, **options: object) -> st.Scene:
    return st.build_lod(st.Scene.flat(surface(400)), st.BuildOptions(method=method, max_roots=4, **options))  # type: ignore[arg-type]


def area(variances: np.ndarray, dilation: float) -> np.ndarray:
    a, b, c = np.sqrt(variances.T + dilation)
    return (a * b + b * c + a * c) / 3


@pytest.mark.parametrize("method", METHODS)
def test_a_node_shows_the_mass_of_its_leaves_at_any_distance(method):
    """By the definition, leaf by leaf: exact at h = 0 and at its level, and in between within the closed form's error."""
    scene = built(method, follow=False)
    all_seen = np.ones(len(scene), np.float32)
    gaussians, tree = with_curves(scene.gaussians, scene.tree, all_seen)
    scene = replace(scene, gaussians=gaussians, tree=tree, blocks=None)
    tree, g = scene.tree, scene.gaussians
    inner = np.flatnonzero(~tree.is_leaf)[::7]
    for row in inner:
        leaves = g.take(np.arange(row, tree.subtree_end[row])[tree.is_leaf[row : tree.subtree_end[row]]])
        alphas, means = leaves.opacities(), leaves.means.astype(np.float64)
        middle = alphas @ means / alphas.sum()
        apart = means - middle
        spread = covariances_from_gaussians(leaves.quats, leaves.log_scales) + apart[:, :, None] * apart[:, None]
        own = np.linalg.eigvalsh(np.tensordot(alphas, spread, 1) / alphas.sum())[None]
        np.testing.assert_allclose(g.means[row], middle, atol=1e-4 * np.abs(middle).max() + 1e-6)
        curve = tree.curves[row : row + 1].astype(np.float64)
        for share, tolerance in ((1e-9, 1e-3), (0.03, 0.2), (0.3, 0.2), (1, 1e-3)):
            h = share * curve[0, 3]
            mass = alphas @ area(leaves.scales() ** 2, h) / area(own, h)[0]
            _, opacity = follow(curve, np.array([h]), g.scales()[row : row + 1], np.ones(1))
            np.testing.assert_allclose(opacity[0], min(mass, 0.99), rtol=tolerance)


def test_nodes_by_a_radius_are_stored_for_a_wider_pixel_than_they_are_drawn_from():
    """Four times as wide, e / 3 at a pixel error of 3 px, and 4 r_0 at least: far views draw fine levels there."""
    scene = built("radius", radius=0.1)
    inner = ~scene.tree.is_leaf
    stored = np.maximum(4 * scene.tree.extents[inner].astype(np.float64) / 3, 4 * 0.1)
    np.testing.assert_allclose(scene.tree.curves[inner, 3], 0.3 * stored**2, rtol=1e-6)
    assert (stored == 0.4).any() and (stored > 0.4).any()


@pytest.mark.parametrize("method", METHODS)
def test_leaves_stay_and_the_option_turns_it_off(method):
    plain, following = built(method, follow=False), built(method)
    assert plain.tree.curves is None
    assert following.tree.curves is not None
    leaf = following.tree.is_leaf
    np.testing.assert_array_equal(leaf, plain.tree.is_leaf)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_array_equal(getattr(following.gaussians, name)[leaf], getattr(plain.gaussians, name)[leaf])
    assert not following.tree.curves[leaf].any()
    assert (following.tree.curves[~leaf, 2] > 0).all()


def test_antialiased_scenes_have_no_use_for_it():
    scene = st.build_lod(st.Scene.flat(surface(200), mode="antialiased"))
    assert scene.tree.curves is None


def test_curves_go_through_files_and_joins(tmp_path):
    scene = built("pairs")
    st.write(scene, tmp_path / "a.splatree")
    back = st.read(tmp_path / "a.splatree")
    np.testing.assert_array_equal(back.tree.curves, scene.tree.curves)
    stored = st.open_scene(tmp_path / "a.splatree")
    np.testing.assert_array_equal(stored.rows(3, 20).curves, scene.tree.curves[3:20])
    flat = st.Scene.flat(surface(30))
    st.write(flat, tmp_path / "b.splatree")
    both = st.read([tmp_path / "a.splatree", tmp_path / "b.splatree"])
    np.testing.assert_array_equal(both.tree.curves, np.concatenate([scene.tree.curves, np.zeros((30, 4))]))
    lost = st.write(scene, tmp_path / "a.hier")
    assert any("nearer than their level" in line for line in lost)


def test_a_scene_that_is_scaled_looks_the_same_from_as_far_times_the_scale():
    scene = built("pairs")
    camera = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=80, height=60)
    large = edit(scene, EditOptions(scale=8.0))
    away = st.Camera.look_at([0, 0, -48], [0, 0, 0], width=80, height=60)
    for select in (st.SelectOptions(budget=60), st.SelectOptions(pixel_error=8)):
        one = st.render(scene, camera, select=select).image
        other = st.render(large, replace(away, near=8 * camera.near), select=select).image
        np.testing.assert_allclose(one, other, atol=2e-3)


@pytest.mark.parametrize("method", METHODS)
def test_budgets_of_a_real_scene_come_nearer_to_all_leaves(method):
    """A twentieth of the bundled city, from near by: at least 1 dB at a budget of a tenth of the leaves."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        scene = st.read(path)
    leaves = st.Scene.flat(scene.gaussians.take(np.arange(12_000, 24_000)))
    trees = [st.build_lod(leaves, st.BuildOptions(method=method, follow=follow)) for follow in (False, True)]
    cameras = st.flyout(leaves, st.PathOptions(views=2, width=160, height=120))
    gains = []
    for camera in cameras:
        wanted = np.clip(st.render(leaves, camera).image, 0, 1)
        pictures = [st.render(tree, camera, select=st.SelectOptions(budget=1200)).image for tree in trees]
        before, after = (st.psnr(np.clip(picture, 0, 1), wanted) for picture in pictures)
        gains.append(after - before)
    assert np.mean(gains) > 1
