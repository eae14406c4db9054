from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import splatree
from splatree import Camera, EditOptions, Gaussians, InputError, Scene, SelectOptions, build_lod, edit, psnr, render
from splatree.edit.edit import edit_rows
from splatree.edit.rows import keep_leaves
from splatree.edit.similarity import Similarity, move_from_options
from splatree.lod.select import select

from ..scenes import with_balls

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
MOVE = EditOptions(scale=2.5, rotate=(33.0, -71.0, 160.0), translate=(40.0, -7.0, 300.0))


@pytest.fixture(scope="module")
def city() -> Scene:
    """The bundled piece of a city, less all but each 30th Gaussian."""
    scene = splatree.read(str(files("splatree") / "data" / "semarang_5_9.sog"))
    return Scene.flat(scene.gaussians.take(np.arange(0, len(scene), 30)))


def moved_camera(camera: Camera, similarity: Similarity) -> Camera:
    """The camera that sees of the moved scene what this one sees of the scene: x' = s R x + t is at s times the depth."""
    pose, moved = camera.camera_from_world, np.eye(4)
    moved[:3, :3] = pose[:3, :3] @ similarity.rotation.T
    moved[:3, 3] = similarity.scale * pose[:3, 3] - moved[:3, :3] @ similarity.translation
    return replace(camera, camera_from_world=moved, near=similarity.scale * camera.near)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_the_moved_scene_looks_the_same_from_the_moved_camera(city, mode):
    scene = replace(city, mode=mode)
    middle = np.median(city.gaussians.means, axis=0).astype(np.float64)
    camera = Camera.look_at(middle + [30, -90, -120], middle, width=160, height=90)
    image = render(scene, camera).image
    again = render(edit(scene, MOVE), moved_camera(camera, move_from_options(MOVE).similarity)).image
    # The goal. What is left is float32 in means some hundred units from the origin: 1e-5 of a pixel's width.
    assert image.std() > 0.05 and psnr(again, image) > 60


def test_harmonics_turn_with_the_scene(city):
    """Without turning them the picture is far off: the test above would not pass by chance."""
    middle = np.median(city.gaussians.means, axis=0).astype(np.float64)
    camera = Camera.look_at(middle + [30, -90, -120], middle, width=160, height=90)
    turned = edit(city, MOVE)
    kept = replace(turned, gaussians=replace(turned.gaussians, sh=city.gaussians.sh))
    image = render(kept, moved_camera(camera, move_from_options(MOVE).similarity)).image
    assert psnr(image, render(city, camera).image) < 40


def test_moving_there_and_back_is_no_move(city):
    there = edit(city, EditOptions(rotate=(90.0, 0.0, 0.0), translate=(1.0, 2.0, 3.0)))
    back = edit(edit(there, EditOptions(translate=(-1.0, -2.0, -3.0))), EditOptions(rotate=(-90.0, 0.0, 0.0)))
    # A rounding or two of float32 for values of up to a thousand, and for harmonics of up to about 4.
    np.testing.assert_allclose(back.gaussians.means, city.gaussians.means, atol=3e-4)
    np.testing.assert_allclose(back.gaussians.sh, city.gaussians.sh, atol=1e-5)
    np.testing.assert_allclose(back.gaussians.quats, city.gaussians.quats, atol=1e-6)


def test_no_edit_keeps_every_bit(city):
    same = edit(city, EditOptions())
    assert same.gaussians is city.gaussians and same.tree is city.tree


@pytest.mark.parametrize(
    "options",
    [
        MOVE,
        EditOptions(sh_degree=1, min_opacity=0.5),
        replace(MOVE, crop_box=(500.0, 0.0, 800.0, 1000.0, 500.0, 1200.0)),
        EditOptions(crop_sphere=(200.0, 0.0, 400.0, 150.0)),
    ],
)
def test_rows_are_edited_as_the_scene_is(city, options):
    """Chunk by chunk gives the same bits as the whole: no row depends on its place."""
    whole = edit(city, options).gaussians
    few = [city.gaussians.take(np.arange(begin, min(begin + 1000, len(city)))) for begin in range(0, len(city), 1000)]
    parts = Gaussians.concatenate([edit_rows(part, options, move_from_options(options)) for part in few])
    assert len(whole) > 0 and all(getattr(whole, c).tobytes() == getattr(parts, c).tobytes() for c in COLUMNS)


def test_filters_keep_what_they_say(city):
    opaque = edit(city, EditOptions(min_opacity=0.25)).gaussians
    opacities = 1 / (1 + np.exp(-city.gaussians.logit_opacities.astype(np.float64)))
    assert len(opaque) == (opacities >= 0.25).sum()
    inside = edit(city, EditOptions(crop_sphere=(200.0, 0.0, 400.0, 150.0))).gaussians
    distances = np.linalg.norm(city.gaussians.means - [200.0, 0, 400], axis=1)
    assert len(inside) == (distances <= 150).sum() > 0
    # Cropped where it lies after the move: the box of the moved centre holds the middle, that of the old one does not.
    moved = edit(city, EditOptions(translate=(1e4, 0.0, 0.0), crop_box=(9e3, -1e4, -1e4, 2e4, 1e4, 1e4)))
    assert len(moved) > 0.9 * len(city)


def test_morton_order_brings_neighbours_together(city):
    ordered = edit(city, EditOptions(order="morton"))

    def step(scene: Scene) -> float:
        return float(np.median(np.linalg.norm(np.diff(scene.gaussians.means, axis=0), axis=1)))

    shuffled = Scene.flat(city.gaussians.take(np.random.default_rng(0).permutation(len(city))))
    assert step(edit(shuffled, EditOptions(order="morton"))) == step(ordered) < 0.2 * step(shuffled)
    rows = np.lexsort(ordered.gaussians.means.T), np.lexsort(city.gaussians.means.T)
    np.testing.assert_array_equal(ordered.gaussians.means[rows[0]], city.gaussians.means[rows[1]])


@pytest.fixture(scope="module")
def levels(city) -> Scene:
    return build_lod(Scene.flat(city.gaussians.take(np.arange(0, len(city), 10))))


@pytest.fixture(scope="module")
def tree(levels) -> Scene:
    return with_balls(levels)


def check_extents(scene: Scene) -> None:
    """Balls hold the means of their subtrees and their 3σ."""
    means = scene.gaussians.means.astype(np.float64)
    reach = 3 * np.exp(scene.gaussians.log_scales.max(axis=1).astype(np.float64))
    for i, end in enumerate(scene.tree.subtree_end):
        distances = np.linalg.norm(means[i:end] - means[i], axis=1) + reach[i:end]
        assert distances.max() <= scene.tree.extents[i]


def test_extents_of_levels_are_scaled(levels):
    """And keep their bits where nothing moves: what balls are raised by, for a far Gaussian, would draw other nodes."""
    inner = ~levels.tree.is_leaf
    moved = edit(levels, MOVE)
    np.testing.assert_array_equal(moved.tree.extents[inner], np.float32(2.5) * levels.tree.extents[inner])
    flat = edit(levels, EditOptions(sh_degree=0))
    np.testing.assert_array_equal(flat.tree.extents[inner], levels.tree.extents[inner])


def test_a_moved_tree_keeps_its_levels_and_bounds(tree):
    moved = edit(tree, MOVE)
    assert moved.tree.subtree_end is tree.tree.subtree_end and not tree.tree.is_leaf.all()
    check_extents(moved)
    middle = np.median(tree.gaussians.means, axis=0).astype(np.float64)
    camera = Camera.look_at(middle + [30, -90, -120], middle, width=160, height=90)
    options = SelectOptions(pixel_error=8)
    before = select(tree, camera, options).rows
    after = select(moved, moved_camera(camera, move_from_options(MOVE).similarity), options).rows
    # The same cut, but for nodes whose radius rounds to the other side of the limit.
    assert len(np.setxor1d(before, after)) <= 0.002 * len(before) and len(before) > 50


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
@settings(max_examples=25)
def test_a_filtered_tree_is_a_tree_over_the_kept_leaves(tree, seed, share):
    leaves = np.flatnonzero(tree.tree.is_leaf)
    # Whole stretches are dropped, as a crop does.
    is_kept = np.repeat(np.random.default_rng(seed).random(len(tree) // 20 + 1) < share, 20)[: len(tree)]
    kept = keep_leaves(tree, is_kept)  # GaussianTree checks its own nesting
    wanted = leaves[is_kept[leaves]]
    assert kept.gaussians.means[kept.tree.is_leaf].tobytes() == tree.gaussians.means[wanted].tobytes()
    bad = tree.tree.is_leaf & ~is_kept
    whole = [i for i, end in enumerate(tree.tree.subtree_end) if end > i + 1 and not bad[i:end].any()]
    assert len(kept) == len(wanted) + len(whole)
    np.testing.assert_array_equal(kept.gaussians.means[~kept.tree.is_leaf], tree.gaussians.means[whole])


def test_a_cropped_tree_says_what_went(tree):
    middle = np.median(tree.gaussians.means, axis=0)
    cropped = edit(tree, EditOptions(crop_sphere=(*map(float, middle), 60.0)))
    assert 0 < len(cropped) < len(tree) and not cropped.tree.is_leaf.all()
    check_extents(cropped)
    assert "merged nodes: Gaussians below them were dropped" in cropped.source.metadata["lost"]


def test_a_tree_is_not_reordered(tree):
    with pytest.raises(InputError, match="in the order of its tree"):
        edit(tree, EditOptions(order="morton"))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"scale": 0}, "scale: found 0, wanted 1e-12 to 1e12"),
        ({"scale": np.inf}, "scale: found inf"),
        ({"min_opacity": 1}, "wanted at least 0 and less than 1"),
        ({"rotate": (0, np.nan, 0)}, "rotate: found"),
        ({"crop_box": (0, 0, 0, 1, -1, 1)}, "the least x y z, then the largest"),
        ({"crop_sphere": (0, 0, 0, -1)}, "found radius -1"),
        ({"crop_sphere": (0, 0, 0)}, r"crop_sphere: found \(0, 0, 0\), wanted 4 numbers"),
        ({"crop_box": (0, 0, 0)}, r"crop_box: found \(0, 0, 0\), wanted 6 numbers"),
        ({"translate": (1, 2)}, r"translate: found \(1, 2\), wanted 3 numbers"),
        ({"translate": "abc"}, "translate: found 'abc', wanted 3 numbers"),
        ({"rotate": 90}, "rotate: found 90, wanted 3 numbers"),
        ({"rotate": None}, "rotate: found None, wanted 3 numbers"),
        ({"sh_degree": 4}, "found 4, wanted 0 to 3"),
        ({"order": "hilbert"}, "found 'hilbert'"),
    ],
)
def test_edits_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        EditOptions(**wrong)


@pytest.mark.parametrize(
    ("options", "keeps"),
    [
        (EditOptions(sh_degree=1), True),
        (MOVE, False),
        (EditOptions(min_opacity=0.3), False),
        (EditOptions(order="morton"), False),
    ],
)
def test_clusters_go_with_what_they_held(city, options, keeps):
    clustered = splatree.build_clusters(city, 9)
    edited = edit(clustered, options)
    assert (edited.clusters is not None) == keeps
    assert ("the 9 clusters" in edited.source.metadata.get("lost", "")) != keeps


def test_numbers_may_come_as_lists_and_arrays():
    wanted = EditOptions(rotate=(90, 0, 0), crop_box=(0, 0, 0, 1, 1, 1))
    for kind in (list, np.array):
        assert EditOptions(rotate=kind([90, 0, 0]), crop_box=kind([0, 0, 0, 1, 1, 1])) == wanted
