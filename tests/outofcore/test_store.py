"""Stores: what is selected and drawn page by page is what is selected and drawn of the whole tree."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.outofcore import pages

from ..laws.hard_scenes import hard_scene, hard_scenes


def small_pages(rows):
    """Pages of so many rows, or a few more, as long as the context lasts."""
    return mock.patch.object(pages, "PAGE_BYTES", rows * 100)  # a row of degree 0 has about as much


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
    profile = draw(hs.sampled_from([None, "exact", "sphere", "3dgs"]))
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


def check_pages_hold(store, scene):
    """Each box holds what its page stands for; of a page of the crown, what is below its portals."""
    table, whole = store.index.table, store.index.whole_rows
    is_inner = ~scene.tree.is_leaf
    for number in range(store.index.num_own):
        first, last = (int(whole[row]) for row in (table.begin[number], table.end[number] - 1))
        rows = slice(first, int(scene.tree.subtree_end[last]))  # all between, parts' rows too
        means, scales = scene.gaussians.means[rows], np.exp(scene.gaussians.log_scales[rows].max(axis=1))
        assert (means >= table.lower[number]).all() and (means <= table.upper[number]).all()
        assert scales[~is_inner[rows]].max() <= table.leaf_scales[number] * (1 + 1e-6)


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
            check_pages_hold(store, scene)
            for _ in range(3):
                camera, chosen = data.draw(cameras(gaussians.means)), data.draw(choices())
                check_is_drawn_as(store, scene, camera, chosen)
