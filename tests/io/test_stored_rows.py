"""Some rows of a .splatree are read and nothing else; a .splatree is written part by part."""

from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.splatree.container import open_container

from ..scenes import random_gaussians, surface
from .conftest import COLUMNS, same_bits
from .test_store import rewrite, set_in, tree_scene

TREE = ("subtree_end", "depth", "extents")


def built(n=700, seed=0, **changes):
    scene = st.build_lod(st.Scene.flat(surface(n, seed=seed, degree=1)), st.BuildOptions(radius=0.2))
    return replace(scene, **changes)


def check_same_scene(found, wanted):
    assert all(same_bits(getattr(found.gaussians, c), getattr(wanted.gaussians, c)) for c in COLUMNS)
    assert all(same_bits(getattr(found.tree, c), getattr(wanted.tree, c)) for c in TREE)
    assert (found.mode, found.threshold, found.tile_rule) == (wanted.mode, wanted.threshold, wanted.tile_rule)
    assert found.tree.record == wanted.tree.record


@pytest.mark.parametrize(("begin", "end"), [(0, 0), (0, 9), (5, 6), (130, 800), (0, None)])
def test_rows_are_those_of_the_scene(tmp_path, begin, end):
    scene = built()
    st.write(scene, tmp_path / "a.splatree")
    stored = st.open_scene(tmp_path / "a.splatree")
    end = len(stored) if end is None else end
    rows = stored.rows(begin, end)
    assert len(stored) == len(scene) and len(rows) == end - begin
    assert all(same_bits(getattr(rows.gaussians, c), getattr(scene.gaussians, c)[begin:end]) for c in COLUMNS)
    assert all(same_bits(getattr(rows, c), getattr(scene.tree, c)[begin:end]) for c in TREE)
    assert same_bits(rows.ids, scene.ids[begin:end])
    head = stored.head
    assert (head.mode, head.threshold, head.sh_degree, head.record) == (
        "classic",
        scene.threshold,
        1,
        scene.tree.record,
    )


def test_nothing_but_the_rows_is_read(tmp_path):
    """Values beyond the rows may be of no use: nobody looks at them."""
    scene = built()
    st.write(scene, tmp_path / "a.splatree")
    place = open_container(tmp_path / "a.splatree").columns["gaussians.means"]
    data = bytearray((tmp_path / "a.splatree").read_bytes())
    data[place.start + 12 * 500 : place.start + 12 * 500 + 4] = np.float32(np.nan).tobytes()
    (tmp_path / "a.splatree").write_bytes(data)
    stored = st.open_scene(tmp_path / "a.splatree")
    assert same_bits(stored.rows(100, 500).gaussians.means, scene.gaussians.means[100:500])
    with pytest.raises(st.FormatError, match=r"row 500, means\[0\]: found nan"):
        stored.rows(400, 600)
    assert not stored.rows(0, 10).gaussians.means.flags.owndata


def test_clusters_are_written_after_the_rows_as_announced(tmp_path):
    scene = st.build_clusters(built(), 20)
    head, clusters = st.SceneHead.of(scene), scene.clusters
    with st.create_scene(tmp_path / "a.splatree", head, num_clusters=len(clusters)) as writer:
        writer.append(scene)
        writer.append_clusters(clusters)
    st.write(scene, tmp_path / "b.splatree")
    assert (tmp_path / "a.splatree").read_bytes() == (tmp_path / "b.splatree").read_bytes()
    for number, appended, message in (
        (len(clusters), None, f"found no clusters appended, wanted the {len(clusters)} announced"),
        (0, clusters, f"found {len(clusters)} of {len(scene)} rows, wanted the 0 announced"),
    ):
        with (
            pytest.raises(st.InputError, match=message),
            st.create_scene(tmp_path / "c.splatree", head, num_clusters=number) as writer,
        ):
            writer.append(scene)
            if appended is not None:
                writer.append_clusters(appended)
    assert not (tmp_path / "c.splatree").exists()


def test_a_subtree_is_a_scene_of_its_own(tmp_path):
    scene = built()
    st.write(scene, tmp_path / "a.splatree")
    stored = st.open_scene(tmp_path / "a.splatree")
    root = int(np.flatnonzero(~scene.tree.is_leaf & (scene.tree.depth == 1))[3])
    part = stored.rows(root, int(scene.tree.subtree_end[root])).scene(stored.head)
    assert part.tree.depth[0] == 0 and int(part.tree.subtree_end[0]) == len(part)
    assert part.tree.record == scene.tree.record and part.blocks is not None
    with pytest.raises(st.InputError, match="whole subtrees"):
        stored.rows(root, root + 1).scene(stored.head)
    with pytest.raises(st.InputError, match="whole subtrees"):
        stored.rows(root + 1, root + 1 + len(part)).scene(stored.head)


@pytest.mark.parametrize("rows", [(-1, 3), (3, 2), (0, 10**6)])
def test_rows_that_are_not_there_are_refused(tmp_path, rows):
    st.write(tree_scene(), tmp_path / "a.splatree")
    with pytest.raises(st.InputError, match=f"found rows {rows[0]} to {rows[1]}, wanted some of the 7"):
        st.open_scene(tmp_path / "a.splatree").rows(*rows)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_in("gaussians.means", "shape", value=[3, 7]), r"means: found float32 of shape \(3, 7\), wanted float32"),
        (set_in("gaussians.sh", "shape", value=[7, 27, 1]), r"gaussians.sh: found \(7, 27, 1\)"),
        (set_in("tree.extents", "dtype", value="I32"), "tree.extents: found int32"),
        (set_in("__metadata__", "mode", value='"blurry"'), "mode: found 'blurry'"),
        (set_in("__metadata__", "threshold", value="2"), "threshold: found 2"),
        (set_in("__metadata__", "threshold", value='"x"'), "threshold: found 'x', wanted a number"),
        (set_in("__metadata__", "version", value="3"), "newer splatree"),
        (set_in("__metadata__", "tree.record", value="{}"), "level record"),
    ],
)
def test_lying_headers_are_refused(tmp_path, change, message):
    st.write(tree_scene(), tmp_path / "a.splatree")
    rewrite(tmp_path / "a.splatree", change)
    with pytest.raises(st.FormatError, match=message):
        st.open_scene(tmp_path / "a.splatree")


def test_a_tree_that_leads_nowhere_is_refused(tmp_path):
    scene = tree_scene()
    st.write(scene, tmp_path / "a.splatree")
    place = open_container(tmp_path / "a.splatree").columns["tree.subtree_end"]
    data = bytearray((tmp_path / "a.splatree").read_bytes())
    data[place.start + 8 : place.start + 12] = np.int32(99).tobytes()
    (tmp_path / "a.splatree").write_bytes(data)
    with pytest.raises(st.FormatError, match=r"row 2, tree.subtree_end: found 99, wanted 3 to 7"):
        st.open_scene(tmp_path / "a.splatree").rows(1, 4)
    (tmp_path / "b.ply").write_text("ply\n")
    with pytest.raises(st.FormatError, match=r"b\.ply"):
        st.open_scene(tmp_path / "b.ply")
    with pytest.raises(st.InputError, match="cannot be read"):
        st.open_scene(tmp_path / "none.splatree")


def test_parts_written_one_by_one_are_the_scenes_joined(tmp_path):
    from splatree.io.joined import joined

    parts = [built(300, seed=1), built(200, seed=2), st.Scene.flat(random_gaussians(5, 0))]
    paths = [tmp_path / f"{i}.splatree" for i in range(len(parts))]
    for part, path in zip(parts, paths, strict=True):
        st.write(part, path)
    stored = [st.open_scene(path) for path in paths]
    head = st.common_head([s.head for s in stored])
    with st.create_scene(tmp_path / "all.splatree", head) as writer:
        for s in stored:
            for begin in range(0, len(s), 90):  # runs that cut subtrees
                writer.append(s.rows(begin, min(begin + 90, len(s))))
    found, wanted = st.read(tmp_path / "all.splatree"), joined(parts)
    check_same_scene(found, wanted)
    assert found.source.metadata["levels"] == wanted.source.metadata["levels"]


def test_a_scene_written_in_one_part_is_the_scene(tmp_path):
    scene = built(300, mode="antialiased", threshold=0.01, tile_rule="balanced")
    with st.create_scene(tmp_path / "a.splatree", st.SceneHead.of(scene)) as writer:
        writer.append(scene)
    found = st.read(tmp_path / "a.splatree")
    check_same_scene(found, scene)
    assert same_bits(found.ids, scene.ids)


def test_too_few_rows_too_many_or_of_too_high_a_degree_are_refused_and_leave_no_file(tmp_path):
    scene, path = st.Scene.flat(random_gaussians(5, 1)), tmp_path / "a.splatree"
    head = st.SceneHead.of(scene)
    for wrong, message in (
        (replace(head, num_rows=6), "found 5 rows appended, wanted the 6 announced"),
        (replace(head, num_rows=4), "found 5 rows with those before it, wanted at most the 4"),
        (replace(head, sh_degree=0), "found harmonics of degree 1, wanted at most the degree 0"),
    ):
        with pytest.raises(st.InputError, match=message), st.create_scene(path, wrong) as writer:
            writer.append(scene)
    assert not list(tmp_path.iterdir())
    with pytest.raises(st.InputError, match="num_rows: found -1"):
        replace(head, num_rows=-1)
    with pytest.raises(st.InputError, match="sh_degree: found 7"):
        replace(head, sh_degree=7)
    with pytest.raises(st.InputError, match="part 1: found mode antialiased"):
        st.common_head([head, replace(head, mode="antialiased")])
    with pytest.raises(st.InputError, match="no heads"):
        st.common_head([])
