"""Cleaning from files to a file, in chunks: the file of cleaning in memory, byte for byte."""

import numpy as np
import pytest

import splatree as st
from splatree.edit import clean as cleaning
from splatree.errors import InputError
from splatree.io import cleaning as in_chunks
from splatree.io.memory import Scratch

from ..laws.hard_scenes import hard_scene

ALL = st.CleanOptions(floaters=True, cell=0.1, smallest_piece=0.05, max_distance=2.5, max_size=2.0, min_size=1e-3)


@pytest.fixture(scope="module")
def scene():
    """A surface with specks around it."""
    surface, specks = hard_scene(900, "surface", 3, degree=1), hard_scene(60, "surface", 5, degree=1)
    far = st.Gaussians(specks.means + np.float32([9, 4, 0]), *(getattr(specks, name) for name in NAMES))
    return st.Scene.flat(st.Gaussians.concatenate([surface, far]))


NAMES = ("quats", "log_scales", "logit_opacities", "sh")


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    monkeypatch.setattr(in_chunks, "ROWS_AT_ONCE", 100)
    monkeypatch.setattr(cleaning, "ROWS_AT_ONCE", 130)


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".splat", ".sog", ".glb", ".splatree"])
@pytest.mark.parametrize(
    "options", [ALL, st.CleanOptions(floaters=True, cell=0.1, smallest_piece=0.1), st.CleanOptions(max_distance=1.0)]
)
def test_a_file_is_that_of_cleaning_in_memory(scene, tmp_path, suffix, options):
    st.write(scene, tmp_path / "in.ply")
    done = st.clean_file(tmp_path / "in.ply", tmp_path / f"out{suffix}", options)
    cleaned = st.clean(st.read(tmp_path / "in.ply"), options)
    st.write(cleaned.scene, tmp_path / f"whole{suffix}")
    assert (tmp_path / f"out{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()
    assert done.in_chunks and done.dropped == cleaned.dropped
    assert 0 < done.num_read - done.num_written == cleaned.num_dropped < 500


def test_all_inputs_are_one_scene_and_columns_may_lie_in_a_file(scene, tmp_path, monkeypatch):
    halves = [tmp_path / "a.ply", tmp_path / "b.ply"]
    for path, part in zip(halves, (slice(0, 400), slice(400, 960)), strict=True):
        st.write(st.Scene.flat(scene.gaussians.take(np.arange(960)[part])), path)
    monkeypatch.setattr(Scratch, "beside", lambda *_: Scratch(0, tmp_path))
    done = st.clean_file(halves, tmp_path / "out.ply", ALL)
    cleaned = st.clean(st.read(halves), ALL)
    assert (done.dropped, done.num_read) == (cleaned.dropped, 960)
    assert st.read(tmp_path / "out.ply").gaussians.means.tobytes() == cleaned.scene.gaussians.means.tobytes()


def test_leaves_of_a_tree_and_the_tree_are_cleaned_in_chunks(scene, tmp_path):
    tree = st.build_lod(scene, st.BuildOptions(method="radius"))
    st.write(tree, tmp_path / "tree.splatree")
    leaves = st.clean_file(tmp_path / "tree.splatree", tmp_path / "leaves.ply", ALL)
    kept = st.clean_file(tmp_path / "tree.splatree", tmp_path / "kept.splatree", ALL)
    assert leaves.in_chunks and kept.in_chunks
    assert leaves.dropped == kept.dropped and leaves.num_written == kept.num_written
    assert any("merged nodes" in sentence for sentence in leaves.lost)
    st.write(st.clean(tree, ALL).scene, tmp_path / "wanted.ply")
    assert (tmp_path / "leaves.ply").read_bytes() == (tmp_path / "wanted.ply").read_bytes()
    assert st.read(tmp_path / "kept.splatree").tree.num_levels > 1
    in_memory = st.clean_file(tmp_path / "tree.splatree", tmp_path / "kept.hier", ALL)
    assert not in_memory.in_chunks and in_memory.dropped == leaves.dropped
    with pytest.raises(InputError, match="max_memory: found 1G, but this needs the whole scene in memory"):
        st.clean_file(tmp_path / "tree.splatree", tmp_path / "b.hier", ALL, max_memory="1G")


def test_nothing_is_written_where_that_is_asked_or_nothing_would_be_left(scene, tmp_path):
    st.write(scene, tmp_path / "in.ply")
    cameras = scene.gaussians.means[:30].astype(np.float64)
    options = st.CleanOptions(max_distance=1.5)
    done = st.clean_file(tmp_path / "in.ply", None, options, cameras=cameras)
    assert done.path is None and done.dropped == st.clean(scene, options, cameras=cameras).dropped
    with pytest.raises(InputError, match="drop all 960 Gaussians"):
        st.clean_file(tmp_path / "in.ply", tmp_path / "out.ply", st.CleanOptions(max_size=1e-9))
    assert [path.name for path in tmp_path.iterdir()] == ["in.ply"]
