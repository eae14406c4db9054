"""Stores: what is selected and drawn page by page is what is selected and drawn of the whole tree."""

import json
import shutil
import zipfile
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.io.formats.splatree.rows import open_scene
from splatree.io.pages.index import _pages_above, index_of_folder
from splatree.io.pages.table import table_of
from splatree.kernels.cpu.frame import select as kernel
from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.outofcore import paging
from splatree.scene.view import view_of

from ..laws.hard_scenes import hard_scenes
from ..laws.test_select_kernel import random_camera, random_scene, random_tau
from .conftest import small_pages


@hs.composite
def cameras(draw, means):
    """A camera near the scene, or within it, with a narrow view or a wide one."""
    rng = np.random.default_rng(draw(hs.integers(0, 2**32 - 1)))
    near_by = means[np.abs(means).max(axis=1) < 100]
    target = near_by[rng.integers(len(near_by))] if len(near_by) else means[0]
    eye = target + rng.normal(size=3) * draw(hs.sampled_from([0.3, 2.0, 30.0]))
    up = rng.normal(size=3)
    return st.Camera.look_at(eye, target, up=up, width=40, height=24, fov_y_deg=draw(hs.sampled_from([8.0, 50.0])))


@hs.composite
def choices(draw):
    """Options of a selection."""
    profile = draw(hs.sampled_from([None, "exact", "sphere", "pixel", "3dgs"]))
    view_test = draw(hs.sampled_from(["footprint", "footprint", "centre", "none"]))
    pixel_error = draw(hs.sampled_from([0.0, 1.0, 3.0, 12.0, 200.0, 1e7, np.inf]))
    max_radius = draw(hs.sampled_from([None, None, 5.0]))
    return st.SelectOptions(pixel_error, profile=profile, view_test=view_test, max_radius=max_radius)


def check_is_drawn_as(store, scene, camera, options):
    wanted, found = st.select(scene, camera, options), store.select(camera, options)
    np.testing.assert_array_equal(found.rows, wanted.rows)
    assert (found.pixel_error, found.profile, found.notes) == (wanted.pixel_error, wanted.profile, wanted.notes)
    frames = [st.trace(each, camera, select=options) for each in (store, scene)]
    for part, names in (("splats", ("rows", "records", "order")), ("bins", ("tile_start", "splat_from_pair"))):
        for name in names:
            arrays = [getattr(getattr(frame, part), name) for frame in frames]
            if name == "records":
                arrays = [array[:, :13] for array in arrays]  # the others are not used
            assert arrays[0].tobytes() == arrays[1].tobytes(), name
    for name in ("image", "alpha", "depth"):
        assert getattr(frames[0].result, name).tobytes() == getattr(frames[1].result, name).tobytes(), name


def check_boxes_hold(store):
    """Each box holds the rows of its page or block that may be drawn from it, portals apart: at any extent up to which inner rows
    are drawn, none of these is wider than both a third of it and what the steps say."""
    index, table = store.index, store.index.table
    for number in range(len(table)):
        page = store.page(number)
        means, inner = page.gaussians.means, ~page.tree.is_leaf
        is_portal = ~inner if number < index.num_own and index.has_parts else np.zeros(len(page), bool)
        scales = np.exp(page.gaussians.log_scales.max(axis=1))
        assert (means >= table.lower[number]).all() and (means <= table.upper[number]).all()
        for nth, block in enumerate(range(table.block_start[number], table.block_start[number + 1])):
            rows = np.flatnonzero(~is_portal[256 * nth : 256 * (nth + 1)]) + 256 * nth
            assert (means[rows] >= table.block_lower[block]).all() and (means[rows] <= table.block_upper[block]).all()
            steps, of_step = table.block_step_extents[block], table.block_step_scales[block]
            for extent in (*np.unique(page.tree.extents[rows]), *steps[np.isfinite(steps)]):
                drawn = rows[~inner[rows] | (page.tree.extents[rows] <= extent)]
                scale = of_step[(steps <= extent).sum() - 1]
                assert scales[drawn].max(initial=0) <= max(scale, extent / 3) * (1 + 2e-5)
                assert scale <= table.leaf_scales[number]


def check_portals_are_found(store):
    """The pages of the crown that are named for a page of a part hold the copies of all roots of its rows, and no others."""
    index, table = store.index, store.index.table
    crown = store._files[0]
    ids, ends = crown.file.rows("ids"), crown.file.rows("tree.subtree_end")
    leaves = np.flatnonzero(ends == np.arange(1, len(crown) + 1))
    copies = np.empty(index.num_roots, np.int64)
    copies[ids[leaves]] = leaves
    for number in range(index.num_own, len(table)):
        page = store.page(number)
        roots = np.searchsorted(np.flatnonzero(page.depth == 0), np.arange(len(page)), side="right") - 1
        wanted = (
            np.searchsorted(table.begin[: index.num_own], copies[table.first_root[number] + roots], side="right") - 1
        )
        found = index.above[index.above_start[number] : index.above_start[number + 1]]
        np.testing.assert_array_equal(found, np.unique(wanted))
    assert index.above_start[index.num_own] == 0


def test_boxes_of_large_pages_hold_what_is_drawn_from_them(folder):
    """Pages of several blocks; a box that is too small fails, and so does a step that is."""
    crown = open_scene(folder / "crown.splatree")
    parts = [open_scene(path) for path in sorted((folder / "parts").iterdir())]
    with st.open_store(folder) as store:
        check_portals_are_found(store)
        store.index = index_of_folder(crown, table_of(crown, portals=True), map(table_of, parts), folder)
        table = store.index.table
        assert store.index.num_own < len(crown) / 256 and (np.isfinite(table.block_step_extents).sum(axis=1) > 2).any()
        check_boxes_hold(store)
        check_portals_are_found(store)
        for column in (table.block_upper, table.block_step_scales):
            column.setflags(write=True)
            held = column[-1].copy()
            column[-1] = 0 if column is table.block_step_scales else table.block_lower[-1]
            with pytest.raises(AssertionError):
                check_boxes_hold(store)
            column[-1] = held
        check_boxes_hold(store)


def test_a_part_without_rows_has_no_page_below_the_crown(tmp_path):
    st.write(st.Scene.flat(st.Gaussians.empty()), tmp_path / "empty.splatree")
    found = table_of(open_scene(tmp_path / "empty.splatree"))
    assert _pages_above(found.table, np.zeros(0, np.int64)) == []


@settings(max_examples=40, deadline=None)
@given(data=hs.data(), gaussians=hard_scenes(most=400, degree=1), rows=hs.sampled_from([1, 7, 40, 10**4]))
def test_a_file_is_drawn_by_pages_as_it_is_drawn_in_memory(tmp_path_factory, data, gaussians, rows):
    method, radius = data.draw(hs.sampled_from([("radius", "auto"), ("radius", 0.3), ("pairs", "auto")]))
    scene = st.build_lod(st.Scene.flat(gaussians), st.BuildOptions(method=method, radius=radius, max_roots=3))
    path = tmp_path_factory.mktemp("store") / "scene.splatree"
    st.write(scene, path)
    scene = st.read(path)
    with small_pages(rows), st.open_store(path) as store:
        assert len(store) == len(scene)
        for _ in range(3):
            camera, options = data.draw(cameras(gaussians.means)), data.draw(choices())
            check_is_drawn_as(store, scene, camera, options)


@settings(max_examples=30, deadline=None)
@given(
    data=hs.data(),
    gaussians=hard_scenes(most=400, degree=1),
    rows=hs.sampled_from([1, 7, 40, 10**4]),
    part_rows=hs.sampled_from([16, 60, 1000]),
    part_levels=hs.integers(1, 6),
)
def test_a_folder_is_drawn_by_pages_as_its_tree_is_drawn_in_memory(
    tmp_path_factory, data, gaussians, rows, part_rows, part_levels
):
    path = tmp_path_factory.mktemp("store") / "in.ply"
    st.write(st.Scene.flat(gaussians), path)
    options = st.BuildOptions(radius=data.draw(hs.sampled_from(["auto", 0.3])), max_roots=data.draw(hs.integers(1, 20)))
    running = st.FolderOptions(part_rows=part_rows, part_levels=part_levels)
    with small_pages(rows):
        folder = st.build_folder(path, path.with_name("out.splatree"), options, running).path
        scene = st.read(folder)
        with st.open_store(folder) as store:
            assert (len(store), store.index.num_leaves) == (len(scene), len(gaussians))
            assert store.index.num_levels == scene.tree.num_levels
            check_boxes_hold(store)
            check_portals_are_found(store)
            for _ in range(3):
                camera, chosen = data.draw(cameras(gaussians.means)), data.draw(choices())
                check_is_drawn_as(store, scene, camera, chosen)


CAMERAS = [
    st.Camera.look_at((x, 3, 2), (x, 5, 0), up=(0, 0, 1), width=48, height=32, fov_y_deg=40) for x in range(1, 9)
]


def test_a_store_keeps_what_fits(folder, scene):
    with st.open_store(folder, max_memory="30k") as store, st.open_session(store) as session:
        for camera in CAMERAS:
            assert session.draw(camera).image.tobytes() == st.render(scene, camera).image.tobytes()
            assert 0 < store.resident_bytes <= 30_000
    assert store.resident_bytes == 0
    with pytest.raises(st.InputError, match="closed"):
        store.select(CAMERAS[0])


def test_a_view_reads_only_pages_that_it_needs(folder):
    """A tenth of the leaves is in view: 75 of 164 pages are read. Two fifths of the merged nodes are wider than their extent.
    Where boxes hold such nodes as a whole, coarse ones too, 101 pages are read."""
    with st.open_store(folder) as store:
        store.select(CAMERAS[0])
        first = store.num_loaded
        assert 0 < first < len(store.index.table) / 2
        store.select(CAMERAS[0])
        assert store.num_loaded == first


@settings(max_examples=60, deadline=None)
@given(
    seed=hs.integers(0, 2**20), profile=hs.sampled_from(["pixel", "sphere", "exact"]), rows=hs.sampled_from([16, 60])
)
def test_no_box_that_is_out_of_the_image_has_a_row_that_is_drawn(seed, profile, rows):
    scene, camera = random_scene(seed), random_camera(seed)
    options = st.SelectOptions(random_tau(seed), profile=profile)
    view, blocks = view_of(scene, camera), index_blocks(scene.gaussians, scene.tree, rows_per_block=rows)
    packed = kernel.pack(view, options)
    boxes = paging._Boxes(blocks.lower, blocks.upper, blocks.step_extents, blocks.step_scales)
    outside = paging._outside(boxes, view, options, packed)
    assert not outside[st.select(scene, camera, options).rows // rows].any()


def test_a_wide_node_counts_from_the_distance_at_which_it_is_drawn():
    scene = st.Scene.flat(st.Gaussians.empty())
    ahead = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=100, height=100, fov_y_deg=90)
    options, view = st.SelectOptions(3.0, profile="pixel"), view_of(scene, ahead)
    found = {}
    for distance in (10.0, 60.0):
        corner = np.float32([[1.5 * distance, 0, distance]])  # a node of extent 2 is drawn from 33 on
        boxes = paging._Boxes(corner, corner, np.float32([[0, 2]]), np.float32([[0.01, 9]]))
        found[distance] = bool(paging._outside(boxes, view, options, kernel.pack(view, options))[0])
    assert found == {10.0: True, 60.0: False}


def test_narrow_views_at_any_pixel_error_select_what_is_selected_of_the_whole_tree(folder, scene):
    """Wide nodes reach into views that their block lies out of, and views between the crown's nodes have open portals."""
    with st.open_store(folder) as store:
        for x in np.linspace(0, 8, 9):
            for target, fov in ((5, 3), (3.5, 20)):
                camera = st.Camera.look_at((x, 3, 2), (x, target, 0), up=(0, 0, 1), width=48, height=32, fov_y_deg=fov)
                for pixel_error in (0, 6, 40, 150, 400):
                    options = st.SelectOptions(pixel_error)
                    wanted = st.select(scene, camera, options).rows
                    np.testing.assert_array_equal(store.select(camera, options).rows, wanted)


def test_a_budget_is_met_by_a_cut_of_the_whole_tree(folder, scene):
    with st.open_store(folder) as store:
        last = None
        for camera in CAMERAS:
            found = store.select(camera, st.SelectOptions(budget=150), last=last)
            wanted = st.select(scene, camera, st.SelectOptions(pixel_error=found.pixel_error))
            np.testing.assert_array_equal(found.rows, wanted.rows)
            assert len(found) <= 150
            last = found.pixel_error


def test_sessions_batches_and_scores_take_stores(folder, scene):
    with st.open_store(folder) as store:
        for found, wanted in zip(st.evaluate(store, CAMERAS[:2]), st.evaluate(scene, CAMERAS[:2]), strict=True):
            assert found.cut_vs_leaves == wanted.cut_vs_leaves
        pictures = [[r.image.tobytes() for r in st.render_batch(each, CAMERAS[:3])] for each in (store, scene)]
        assert pictures[0] == pictures[1]
        reference = st.render(store, CAMERAS[0], device="reference").image
        assert reference.tobytes() == st.render(scene, CAMERAS[0], device="reference").image.tobytes()
        with st.open_session(store) as session:
            assert (session.scene.mode, len(session.scene)) == (scene.mode, 0)
            pending = [session.enqueue(camera) for camera in CAMERAS[:2]]
            assert [each.result().image.tobytes() for each in pending] == pictures[0][:2]
            with pytest.raises(st.InputError, match="found a store, wanted a scene in memory"):
                session.update({})


def test_a_quality_is_measured_from_the_pages(scene, folder):
    wanted = st.SelectOptions(quality=33)
    with st.open_store(folder) as store, st.open_session(store) as session:
        for camera in CAMERAS[:2]:
            expected = st.select(scene, camera, wanted)
            assert 0 < len(expected) < len(st.select(scene, camera, st.SelectOptions(pixel_error=0)))
            assert session.select(camera, select=wanted).pixel_error == expected.pixel_error


def test_what_needs_all_rows_is_refused(folder):
    with st.open_store(folder) as store:
        with pytest.raises(st.InputError, match="found 'release' for a store"):
            store.select(CAMERAS[0], st.SelectOptions(rule="release"))
        with pytest.raises(st.InputError, match="found 'exact' for a store"):
            store.select(CAMERAS[0], st.SelectOptions(cull="exact"))
        with pytest.raises(st.InputError, match="quality: found 40 dB for a store"):
            store.select(CAMERAS[0], st.SelectOptions(quality=40))
        with pytest.raises(st.InputError, match="occlusion: found it asked of a store, wanted a scene in memory"):
            store.select(CAMERAS[0], st.SelectOptions(occlusion=True))


def test_any_rows_are_drawn_as_from_the_whole_tree(folder, scene):
    rng = np.random.default_rng(2)
    with st.open_store(folder) as store:
        for count in (0, 1, 40, 2000):
            rows = np.sort(rng.choice(len(scene), count, replace=False)).astype(np.int32)
            np.testing.assert_array_equal(store.depths(store.find(rows)), scene.tree.depth[rows])

            def chosen(view, *, threads=0, rows=rows):
                return st.Selection(rows, "cut", "sphere", 0.0, len(rows))

            pictures = [st.render(each, CAMERAS[1], select=chosen).image.tobytes() for each in (store, scene)]
            assert pictures[0] == pictures[1]


def test_pages_are_loaded_ahead(folder):
    with st.open_store(folder) as store:
        store.prefetch(CAMERAS[3])
        store.prefetch(CAMERAS[3])
    with st.open_store(folder) as store:
        store.prefetch(CAMERAS[3])
        store._ahead[1].result()
        assert store.num_ahead > 0
        store.select(CAMERAS[3])
        assert store.num_loaded == 0


def test_pages_of_a_moving_camera_are_loaded_before_it_arrives(folder):
    def at(x):
        return st.Camera.look_at((x, 3, 2), (x, 5, 0), up=(0, 0, 1), width=48, height=32, fov_y_deg=40)

    def loaded_while_drawing(store):
        with st.open_session(store) as session:
            for step in range(30):
                session.draw(at(1 + 0.2 * step))
                if store._ahead is not None:
                    store._ahead[1].result()
        return store.num_loaded

    with st.open_store(folder) as store:
        ahead = loaded_while_drawing(store)
    with st.open_store(folder) as store, mock.patch.object(st.Store, "prefetch"):
        assert ahead < 0.6 * loaded_while_drawing(store)  # found: 76 of 132, of which 75 are of the first view


OLDER = Path(__file__).with_name("older_folder.zip")
"""A folder that was written before blocks had steps: its crown's boxes hold what is below its portals."""


def test_an_older_index_is_read_as_it_is(tmp_path):
    with zipfile.ZipFile(OLDER) as stored:
        stored.extractall(tmp_path / "older.splatree")
    scene = st.read(tmp_path / "older.splatree")
    with st.open_store(tmp_path / "older.splatree") as store:
        assert (len(store.index.table), store.index.above, store.index.table.block_step_scales.shape[1]) == (
            15,
            None,
            1,
        )
        check_boxes_hold(store)
        for x in (1, 3, 6):
            for distance, options in ((2, st.SelectOptions()), (12, st.SelectOptions(8)), (2, st.SelectOptions(0))):
                camera = st.Camera.look_at(
                    (x, -distance, 2), (x, 5, 0), up=(0, 0, 1), width=48, height=32, fov_y_deg=30
                )
                check_is_drawn_as(store, scene, camera, options)
    with small_pages(20):
        assert st.check(tmp_path / "older.splatree")[0].num_nodes == len(scene)


def test_an_older_folder_without_an_index_is_indexed_when_it_is_opened(folder, scene, tmp_path):
    copy = tmp_path / "older.splatree"
    shutil.copytree(folder, copy)
    (copy / "pages.index").unlink()
    manifest = json.loads((copy / "manifest.json").read_text())
    del manifest["index"]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with st.open_store(copy) as store:
        check_is_drawn_as(store, scene, CAMERAS[2], st.SelectOptions())
