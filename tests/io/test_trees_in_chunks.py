"""Files with levels that are larger than memory: the Gaussians of reading them whole, whatever the chunks."""

import weakref
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.cli.info import describe
from splatree.io import outline as outlines
from splatree.io import rows
from splatree.io.formats.hier import format as hier
from splatree.io.formats.sog import reader as sog
from splatree.io.formats.streamed_sog import format as streamed_sog
from splatree.io.options import ReadOptions
from splatree.io.outline import outline_of, read_outline
from splatree.scene.scene import Source

from ..laws.hard_scenes import hard_scene

NAMES = ("full.hier", "half.hier", "compact.splatree", "exact.splatree", "parts.splatree")


@pytest.fixture(scope="module")
def trees(tmp_path_factory):
    """The same levels in every form that keeps them."""
    place = tmp_path_factory.mktemp("trees")
    flat = st.Scene.flat(hard_scene(900, "surface", 3, degree=2), source=Source(origin=(4e5, 0, 0)))
    st.write(flat, place / "in.ply")
    options, running = st.BuildOptions(method="radius", radius=0.1, max_roots=4), st.FolderOptions(part_rows=300)
    folder = st.build_folder(place / "in.ply", place / "parts.splatree", options, running).path
    tree = st.read(folder)
    st.write(tree, place / "exact.splatree")
    st.write(tree, place / "compact.splatree", options=st.WriteOptions(compact=True))
    for name, compression in (("full.hier", 0), ("half.hier", 1)):
        st.write(tree, place / name, options=st.WriteOptions(compression=compression))
    return place


@pytest.fixture(autouse=True)
def short_runs(monkeypatch):
    monkeypatch.setattr(rows, "ROWS_PER_CHUNK", 83)
    monkeypatch.setattr(hier, "ROWS_PER_CHUNK", 61)
    monkeypatch.setattr(hier, "_ROWS_AT_ONCE", 97)


@pytest.mark.parametrize("name", NAMES)
def test_leaves_go_through_in_chunks_and_are_those_of_the_tree(trees, tmp_path, name):
    done = st.convert(trees / name, tmp_path / "chunks.ply")
    tree = st.read(trees / name)
    lost = st.write(tree, tmp_path / "whole.ply")
    assert done.in_chunks and done.lost == lost and done.num_written == 900
    assert (tmp_path / "chunks.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize("name", ["full.hier", "half.hier"])
def test_a_hier_goes_through_with_its_levels(trees, tmp_path, name):
    done = st.convert(trees / name, tmp_path / "runs.splatree")
    st.write(st.read(trees / name), tmp_path / "whole.splatree")
    assert done.in_chunks
    assert (tmp_path / "runs.splatree").read_bytes() == (tmp_path / "whole.splatree").read_bytes()
    cleaned = st.clean_file(trees / name, tmp_path / "clean.splatree", st.CleanOptions(max_size=0.05))
    wanted = st.clean(st.read(trees / name), st.CleanOptions(max_size=0.05)).scene
    assert cleaned.in_chunks and 0 < cleaned.num_written < 900
    found = st.read(tmp_path / "clean.splatree")
    assert found.gaussians.means.tobytes() == wanted.gaussians.means.tobytes()
    assert np.array_equal(found.tree.subtree_end, wanted.tree.subtree_end)


def test_a_hier_without_levels_can_be_put_into_clusters_through_files(trees, tmp_path):
    st.write(st.Scene.flat(hard_scene(400, "surface", 5, degree=1)), tmp_path / "flat.hier")
    st.cluster_file(tmp_path / "flat.hier", tmp_path / "files.splatree", 4, max_memory="300M")
    st.write(st.build_clusters(st.read(tmp_path / "flat.hier"), 4), tmp_path / "memory.splatree")
    assert (tmp_path / "files.splatree").read_bytes() == (tmp_path / "memory.splatree").read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_a_tree_is_built_anew_from_its_leaves_through_files(trees, tmp_path, name):
    """The tree is that of the leaves in a flat file."""
    options, running = st.BuildOptions(method="radius", radius=0.1, follow=False), st.FolderOptions(part_rows=300)
    found = st.read(st.build_folder(trees / name, tmp_path / "parts.splatree", options, running).path)
    tree = st.read(trees / name)
    leaves = st.Scene.flat(tree.gaussians.take(tree.tree.is_leaf), source=replace(tree.source, metadata={}))
    wanted = st.build_lod(leaves, options)
    for column in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert getattr(found.gaussians, column).tobytes() == getattr(wanted.gaussians, column).tobytes(), column
    assert np.array_equal(found.tree.subtree_end, wanted.tree.subtree_end)
    assert found.source.origin == tree.source.origin


@pytest.mark.parametrize("name", NAMES)
def test_all_of_a_tree_is_checked(trees, name):
    (found,) = st.check(trees / name)
    tree = st.read(trees / name)
    assert (found.num_gaussians, found.num_nodes) == (900, len(tree))
    assert found.by_pages == (name != "compact.splatree")  # which has to be decoded as a whole


def test_a_bad_value_of_a_hier_is_named_by_its_row_in_the_tree(trees, tmp_path):
    path = tmp_path / "bad.hier"
    data = bytearray((trees / "full.hier").read_bytes())
    n = int.from_bytes(data[:4], "little")
    data[4 + n * 28 + 4 * 3 * 700 : 4 + n * 28 + 4 * 3 * 700 + 4] = np.float32(np.nan).tobytes()
    path.write_bytes(data)
    for verb in (st.read, st.check, lambda path: st.convert(path, tmp_path / "out.splatree")):
        with pytest.raises(st.FormatError, match=r"bad\.hier: row 700, log_scales\[0\]: found nan"):
            verb(path)
    assert not (tmp_path / "out.splatree").exists()


@pytest.mark.parametrize("name", ["full.hier", "exact.splatree"])
def test_a_tree_that_takes_much_memory_is_described_from_its_rows(trees, monkeypatch, name):
    wanted = describe(outline_of(st.read(trees / name)))
    assert not read_outline([trees / name], ReadOptions()).in_chunks
    monkeypatch.setattr(outlines, "free_bytes", lambda: 1000)
    found = describe(read_outline([trees / name], ReadOptions()))
    assert found.in_chunks
    assert replace(found, in_chunks=False) == wanted
    monkeypatch.setattr(outlines, "FOLDER_SAMPLE", 300)
    monkeypatch.setattr(outlines, "SAMPLE", 50)
    few = read_outline([trees / name], ReadOptions())
    tree = st.read(trees / name)
    leaves = tree.gaussians.take(tree.tree.is_leaf)
    assert few.scene.gaussians.means.tobytes() == leaves.means[::3].tobytes()
    assert few.sample.gaussians.sh.tobytes() == leaves.sh[::18].tobytes()
    assert (describe(few).nodes_per_depth, describe(few).box_max) == (wanted.nodes_per_depth, wanted.box_max)


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    """A streamed SOG of several units and levels."""
    scene = st.build_lod(st.Scene.flat(hard_scene(3000, "surface", 3, degree=1)), st.BuildOptions(method="radius"))
    path = tmp_path_factory.mktemp("stream") / "sog"
    st.stream(scene, path, options=st.StreamOptions(chunk_leaves=300, unit_rows=700))
    return path


def test_levels_of_a_stream_go_through_in_chunks(stream, tmp_path, monkeypatch):
    wanted = st.read_levels(stream)
    monkeypatch.setattr(streamed_sog, "ROWS_PER_CHUNK", 83)
    for level, scene in enumerate(wanted):
        options = st.ConvertOptions(read=ReadOptions(level=level))
        assert st.convert(stream, tmp_path / "chunks.ply", options, force=True).in_chunks
        st.write(scene, tmp_path / "whole.ply", force=True)
        assert (tmp_path / "chunks.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    (found,) = st.check(stream)
    assert found.by_pages
    assert (found.num_gaussians, found.num_nodes) == (len(wanted[0]), sum(map(len, wanted)))


def test_one_unit_of_a_stream_is_held_at_a_time(stream, tmp_path, monkeypatch):
    """Its ranges follow each other, so no unit is decoded twice, and none stays."""
    opened, alive, most = sog.open_rows, [], []

    def watched(path, options):
        rows = opened(path, options)
        most.append(sum(one() is not None for one in alive))
        alive.append(weakref.ref(rows))
        return rows

    monkeypatch.setattr(sog, "open_rows", watched)
    st.convert(stream, tmp_path / "out.ply")
    assert len(most) > 3 and not any(most)


def test_a_level_is_refused_where_there_are_none(trees, tmp_path):
    for verb in (
        lambda: st.convert(trees / "in.ply", tmp_path / "a.ply", st.ConvertOptions(read=ReadOptions(level=1))),
        lambda: read_outline([trees / "in.ply"], ReadOptions(level=1)),
    ):
        with pytest.raises(
            st.InputError, match="found level 1 for a file of format ply, which has no levels to choose"
        ):
            verb()
