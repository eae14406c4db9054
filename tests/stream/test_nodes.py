"""Nodes of levels that are looked at from nearer than they are stored for."""

import dataclasses

import numpy as np
import pytest

import splatree as st
from splatree.stream.chunks import chunks_of_tree
from splatree.stream.levels import Level, intervals_of, levels_of_tree
from splatree.stream.nodes import gaussians_of_level, gaussians_of_tree

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
EVERY_ROW = st.SelectOptions(pixel_error=0)


@pytest.fixture(scope="module")
def levels(city_tree):
    return levels_of_tree(city_tree.tree, chunks_of_tree(city_tree))


def same_bits(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in COLUMNS)


def test_a_viewer_that_knows_nothing_draws_what_we_draw(city_tree, levels):
    """One node alone, at the depth where its level is expected: as a flat Gaussian of the file, and as a node of the tree."""
    level = levels[2]
    found = gaussians_of_level(city_tree, level, level.rows, 8.0)
    drawn_px = 8 * np.sqrt(city_tree.tree.num_leaves / (2 * len(level)))
    inner = np.flatnonzero(city_tree.tree.curves[level.rows, 2] > 0)
    compared = 0
    for at in inner[:: len(inner) // 40]:
        node = np.array([level.rows[at]])
        mean = city_tree.gaussians.means[node[0]].astype(np.float64)
        focal = 300.0
        eye = mean - [0, 0, focal * level.size / drawn_px]
        camera = st.Camera.look_at(
            eye, mean, width=128, height=128, fov_y_deg=float(np.degrees(2 * np.arctan(64 / focal)))
        )
        of_file = st.render(st.Scene.flat(found.take(np.array([at]))), camera, select=EVERY_ROW).image
        tree = dataclasses.replace(
            st.Scene.flat(city_tree.gaussians.take(node)).tree, curves=city_tree.tree.curves[node]
        )
        of_tree = st.render(st.Scene(city_tree.gaussians.take(node), tree), camera, select=EVERY_ROW).image
        np.testing.assert_allclose(of_file, of_tree, atol=2e-3)
        compared += of_file.max() > 0.05
    assert compared > 20


def test_nodes_are_never_larger_nor_more_opaque_than_stored(city_tree, levels):
    level = levels[1]
    stored, near, nearer = (gaussians_of_level(city_tree, level, level.rows, px) for px in (0, 8, 30))
    leaf = city_tree.tree.is_leaf[level.rows]
    assert same_bits(stored, city_tree.gaussians.take(level.rows))
    assert same_bits(nearer.take(leaf), stored.take(leaf))
    for part in (near, nearer):
        assert (part.log_scales <= stored.log_scales + 1e-5).all()
        assert (part.logit_opacities <= stored.logit_opacities + 1e-4).all()
    fainter = [(stored.logit_opacities - part.logit_opacities)[~leaf].mean() for part in (near, nearer)]
    assert 0.1 < fainter[0] < fainter[1], fainter


@pytest.mark.parametrize("change", [{"mode": "antialiased"}, {"tree": "without curves"}])
def test_nodes_that_do_not_follow_stay_as_they_are(city_tree, levels, change):
    if "tree" in change:
        change = {"tree": dataclasses.replace(city_tree.tree, curves=None)}
    scene = dataclasses.replace(city_tree, **change)
    rows = levels[2].rows
    assert same_bits(gaussians_of_level(scene, levels[2], rows, 8.0), scene.gaussians.take(rows))


def test_a_level_seen_from_near_is_nearer_to_the_leaves(city_tree, levels):
    """Brightness and PSNR of a coarse level against all leaves: 25.9 dB as stored, 27.7 dB as drawn."""
    level = levels[2]
    camera = st.orbit(city_tree, st.PathOptions(views=1, width=600, height=400))[0]
    truth = st.render(city_tree, camera, select=EVERY_ROW).image
    parts = [gaussians_of_level(city_tree, level, level.rows, px) for px in (0, 8.0)]
    images = [st.render(st.Scene.flat(part), camera, select=EVERY_ROW).image for part in parts]
    as_stored, as_drawn = (st.psnr(image, truth) for image in images)
    assert as_drawn > as_stored + 1, (as_stored, as_drawn)
    assert abs(images[1].mean() / truth.mean() - 1) < 0.03


def test_nodes_that_are_chosen_one_by_one_are_drawn_as_in_the_cut_at_their_size(city_tree):
    """A node of a level, where the level is cut at the node's own size; leaves stay bit for bit."""
    tree, found = city_tree.tree, gaussians_of_tree(city_tree, 4.0)
    chunks = chunks_of_tree(city_tree, chunk_leaves=tree.num_leaves)  # no row is in the spine
    intervals = intervals_of(tree, chunks)
    inner = np.flatnonzero(~tree.is_leaf & (intervals.from_sizes(np.arange(len(tree))) < intervals.to_size))
    for row in inner[:: len(inner) // 20]:
        size = float(tree.extents[row])
        level = Level(size, intervals.rows_at(size), np.zeros(1, np.int64))
        alone = np.array([row])
        assert same_bits(found.take(alone), gaussians_of_level(city_tree, level, alone, 4.0))
    assert same_bits(found.take(tree.is_leaf), city_tree.gaussians.take(tree.is_leaf))
    assert same_bits(gaussians_of_tree(city_tree, 0.0), city_tree.gaussians)


def test_spark_comes_nearer_to_the_leaves(city_tree, tmp_path):
    """Of 60,000 nodes in a view that shows most of them larger than they are stored for: 29.3 dB as stored, 30.6 dB as drawn."""
    camera = st.orbit(city_tree, st.PathOptions(views=1, width=600, height=400))[0]
    quality = []
    for node_px in (0.0, None):
        options = st.StreamOptions(node_px=node_px, sh_degree=0)
        written = st.stream(city_tree, tmp_path / "city.rad", "rad", options, force=True)
        bare = dataclasses.replace(city_tree, gaussians=city_tree.gaussians.with_sh_degree(0))
        quality += [view.psnr_db for view in st.report_stream(bare, written, [camera], budgets=[60_000]).views]
    assert quality[1] > quality[0] + 1, quality


@pytest.mark.parametrize("option", [{"node_px": -1}, {"node_px": float("nan")}, {"tile_nodes": 0}, {"unit_rows": 0}])
def test_options_that_cannot_be_are_refused(option):
    with pytest.raises(st.InputError, match=f"{next(iter(option))}: found .*, wanted at least"):
        st.StreamOptions(**option)
