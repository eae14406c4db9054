"""Trees edited in runs of rows: the file of the same edit in memory, byte for byte."""

import numpy as np
import pytest

import splatree as st
from splatree.errors import FormatError
from splatree.io import tree_runs
from splatree.io.formats.folder import whole
from splatree.io.memory import Scratch

from ..laws.hard_scenes import hard_scene

EDITS = {
    "kept": {},
    "moved": {"scale": 0.3, "rotate": (20, 30, 40), "translate": (1e4, -2, 3)},
    "cut": {"sh_degree": 0},
    "cropped": {"crop_sphere": (4e5 + 5, 5, 0, 4)},
    "faint": {"min_opacity": 0.2, "sh_degree": 1},
    "all": {"scale": 2, "rotate": (90, 0, 0), "crop_box": (8e5, -9, 0, 8e5 + 12, 9, 30), "min_opacity": 0.1},
    "leaves alone": {"min_opacity": 0.9, "translate": (0, 0, 1)},
    "nothing is left": {"crop_sphere": (1e6, 0, 0, 1)},
}


@pytest.fixture(scope="module")
def trees(tmp_path_factory):
    """The same levels as a folder of parts and as a file, and by pairs with all that a file can keep."""
    place = tmp_path_factory.mktemp("trees")
    flat = st.Scene.flat(hard_scene(900, "surface", 3, degree=2), source=st.scene.scene.Source(origin=(4e5, 0, 0)))
    st.write(flat, place / "in.ply")
    options, running = st.BuildOptions(method="radius", radius=0.1, max_roots=4), st.FolderOptions(part_rows=300)
    folder = st.build_folder(place / "in.ply", place / "parts.splatree", options, running).path
    st.write(st.read(folder), place / "file.splatree")
    st.write(st.build_lod(flat, st.BuildOptions(method="pairs")), place / "pairs.splatree")
    return place


@pytest.fixture(autouse=True)
def short_runs(monkeypatch):
    monkeypatch.setattr(tree_runs, "ROWS_PER_CHUNK", 83)
    monkeypatch.setattr(whole, "ROWS_PER_CHUNK", 97)


@pytest.mark.parametrize("name", ["parts", "file", "pairs"])
@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_tree_has_the_bytes_of_the_edit_in_memory(trees, tmp_path, monkeypatch, name, edit):
    options, path = st.EditOptions(**EDITS[edit]), trees / f"{name}.splatree"
    monkeypatch.setattr(Scratch, "beside", lambda *_: Scratch(0, tmp_path))  # what counts rows lies in a file
    done = st.convert(path, tmp_path / "runs.splatree", st.ConvertOptions(edit=options))
    scene = st.read(path)
    wanted = st.edit(scene, options)
    assert done.in_chunks
    assert (done.num_read, done.num_written) == (scene.tree.num_leaves, wanted.tree.num_leaves)
    assert done.lost == tuple(st.io.notes.sentences_in(wanted.source.metadata, "lost"))
    st.write(wanted, tmp_path / "memory.splatree")
    assert (tmp_path / "runs.splatree").read_bytes() == (tmp_path / "memory.splatree").read_bytes()
    if edit in ("cropped", "faint", "all"):
        assert 0 < done.num_written < done.num_read and wanted.tree.num_levels > 1
        assert "merged nodes: Gaussians below them were dropped" in done.lost[0]


def test_a_tree_of_a_store_is_edited_too(bucket, trees, tmp_path):
    options = st.ConvertOptions(edit=st.EditOptions(**EDITS["all"]))
    st.write(st.read(trees / "pairs.splatree"), f"{bucket}/pairs.splatree")
    done = st.convert(f"{bucket}/pairs.splatree", f"{bucket}/edited.splatree", options)
    st.convert(trees / "pairs.splatree", tmp_path / "edited.splatree", options)
    wanted, found = st.read(tmp_path / "edited.splatree"), st.read(f"{bucket}/edited.splatree")
    assert done.in_chunks and len(found) == len(wanted) > 0
    assert found.gaussians.sh.tobytes() == wanted.gaussians.sh.tobytes()
    assert found.tree.subtree_end.tobytes() == wanted.tree.subtree_end.tobytes()


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".sog", ".glb"])
@pytest.mark.parametrize(("name", "edit"), [("parts", "kept"), ("pairs", "moved"), ("file", "all")])
def test_a_cut_at_a_depth_has_the_bytes_of_the_cut_in_memory(trees, tmp_path, name, edit, suffix):
    options, path = st.EditOptions(**EDITS[edit]), trees / f"{name}.splatree"
    for depth in (0, 2):
        found = st.convert(path, tmp_path / f"a{suffix}", st.ConvertOptions(edit=options, depth=depth), force=True)
        wanted = st.edit(st.read(path), options)
        lost = st.write(wanted, tmp_path / f"b{suffix}", depth=depth, force=True)
        assert found.in_chunks and found.lost[-len(lost) or len(found.lost) :] == lost
        assert (found.num_read, found.num_written) == (
            st.read(path).tree.num_leaves,
            len(st.read(tmp_path / f"a{suffix}")),
        )
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    assert len(st.read(tmp_path / f"a{suffix}")) < wanted.tree.num_leaves


@pytest.mark.parametrize("name", ["parts", "pairs"])
def test_a_cleaned_tree_has_the_bytes_of_cleaning_in_memory(trees, tmp_path, name):
    options, path = st.CleanOptions(max_distance=1.2, floaters=True, cell=0.1), trees / f"{name}.splatree"
    done = st.clean_file(path, tmp_path / "runs.splatree", options)
    cleaned = st.clean(st.read(path), options)
    st.write(cleaned.scene, tmp_path / "memory.splatree")
    assert done.in_chunks and done.dropped == cleaned.dropped and cleaned.num_dropped > 0
    assert (tmp_path / "runs.splatree").read_bytes() == (tmp_path / "memory.splatree").read_bytes()
    assert cleaned.scene.tree.num_levels > 1


def test_a_tree_is_not_put_into_another_order(trees, tmp_path):
    with pytest.raises(st.InputError, match="order morton: found a scene with levels"):
        st.convert(
            trees / "parts.splatree", tmp_path / "a.splatree", st.ConvertOptions(edit=st.EditOptions(order="morton"))
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["parts", "file"])
@pytest.mark.parametrize("suffix", [".ply", ".splat", ".compressed.ply"])
def test_a_cut_that_is_moved_beyond_what_is_read_is_not_written(trees, tmp_path, name, suffix):
    large, out = tmp_path / f"{name}.splatree", tmp_path / "out"
    st.convert(trees / f"{name}.splatree", large, st.ConvertOptions(edit=st.EditOptions(scale=100)))
    out.mkdir()
    options = st.ConvertOptions(edit=st.EditOptions(scale=1e12), depth=2)
    with pytest.raises(
        FormatError, match=r"^the scene after the edits: row \d+, log_scales\[0\]: found .*, wanted between −30 and 30"
    ):
        st.convert(large, out / f"a{suffix}", options)
    assert list(out.iterdir()) == []


def test_files_that_are_no_tree_or_have_more_than_one_are_not_taken_for_one(trees, tmp_path):
    scene = st.read(trees / "pairs.splatree")
    st.write(st.build_clusters(scene, 8), tmp_path / "clusters.splatree")
    st.write(scene, tmp_path / "compact.splatree", options=st.WriteOptions(compact=True))
    st.write(st.Scene.flat(scene.gaussians), tmp_path / "flat.splatree")
    for name in ("clusters", "compact", "flat"):
        assert tree_runs.open_runs(tmp_path / f"{name}.splatree") is None
        options = st.ConvertOptions(edit=st.EditOptions(min_opacity=0.2))
        done = st.convert(tmp_path / f"{name}.splatree", tmp_path / f"{name}_cropped.splatree", options)
        assert not done.in_chunks and 0 < done.num_written < done.num_read
    data = bytearray((trees / "pairs.splatree").read_bytes())
    stored = st.open_scene(trees / "pairs.splatree")
    place = stored.file.columns["tree.subtree_end"].start
    data[place : place + 4] = np.int32(len(scene) - 1).tobytes()
    (tmp_path / "damaged.splatree").write_bytes(data)
    with pytest.raises(FormatError, match=r"damaged\.splatree: .*the file is damaged"):
        st.convert(tmp_path / "damaged.splatree", tmp_path / "out.splatree")
