"""Clusters made through files: the file of clusters made in memory, byte for byte."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.clusters import build, kmeans
from splatree.io import rows, tree_runs
from splatree.io.formats.folder import whole
from splatree.io.memory import Scratch
from splatree.io.objects import located
from splatree.kernels import reference
from splatree.outofcore import clustering

from ..laws.hard_scenes import hard_scene, hard_scenes


@pytest.fixture(autouse=True)
def short_runs(monkeypatch):
    for module in (rows, tree_runs, clustering, whole):
        monkeypatch.setattr(module, "ROWS_PER_CHUNK", 61)
    for module in (kmeans, build):
        monkeypatch.setattr(module, "ROWS_AT_ONCE", 47)


def with_room(monkeypatch, num_bytes, folder):
    """Room for so many bytes beside what K-means holds for its centres."""
    monkeypatch.setattr(Scratch, "beside", lambda *_: Scratch(num_bytes, folder))
    monkeypatch.setattr(clustering, "_take_room_of_centers", lambda *_: None)


def bytes_of_memory(paths, count, options=None, mode=None):
    """What `build_clusters` and `write` make of files."""
    scene = st.read(paths)
    made = st.build_clusters(scene if mode is None else replace(scene, mode=mode), count, options)
    first = paths[0] if isinstance(paths, list) else paths
    st.write(made, first.with_name("memory.splatree"), force=True)
    return first.with_name("memory.splatree").read_bytes(), made


@settings(max_examples=40, deadline=None)
@given(
    gaussians=hard_scenes(most=300, degree=1),
    share=hs.sampled_from([1, 3, 20, 1000]),
    size_classes=hs.booleans(),
    room=hs.sampled_from([0, 4000, 10**9]),
    mode=hs.sampled_from(["classic", "antialiased"]),
)
def test_the_file_is_that_of_clusters_in_memory(tmp_path_factory, gaussians, share, size_classes, room, mode):
    folder = tmp_path_factory.mktemp("scene")
    path, count = folder / "in.ply", max(1, len(gaussians) // share)
    st.write(st.Scene.flat(gaussians), path)
    options = st.ClusterOptions(size_classes=size_classes, seed=3)
    with pytest.MonkeyPatch.context() as patch:
        with_room(patch, room, folder)
        if len(gaussians) == 0:
            with pytest.raises(st.InputError, match="without Gaussians"):
                st.cluster_file(path, folder / "out.splatree", count, options)
            return
        wanted, made = bytes_of_memory(path, count, options, mode)
        done = st.cluster_file(path, folder / "out.splatree", count, options, mode=mode)
    assert (folder / "out.splatree").read_bytes() == wanted
    assert (done.num_gaussians, done.num_rows, done.num_clusters) == (len(made), len(made), len(made.clusters))
    assert sorted(path.name for path in folder.iterdir()) == ["in.ply", "memory.splatree", "out.splatree"]


@pytest.mark.parametrize("room", [0, 10**9])
def test_every_gaussian_lies_in_the_spheres_and_the_box_of_its_cluster(tmp_path, ply, monkeypatch, room):
    with_room(monkeypatch, room, tmp_path)
    st.cluster_file(ply, tmp_path / "out.splatree", 3)  # clusters are longer than a run
    with (tmp_path / "out.splatree").open("rb") as file:
        head = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    scene = st.read(tmp_path / "out.splatree")  # bounds are made anew
    data, stored = (tmp_path / "out.splatree").read_bytes(), {}
    first = len(data) - max(place["data_offsets"][1] for name, place in head.items() if name != "__metadata__")
    for name in ("radii", "mean_radii", "footprint_radii", "box_low", "box_high"):
        place = head[f"clusters.{name}"]
        begin, end = place["data_offsets"]
        stored[name] = np.frombuffer(data[first + begin : first + end], np.float32).reshape(place["shape"])
        assert stored[name].tobytes() == getattr(scene.clusters, name).tobytes()
    exact = reference.spheres.bound_clusters(scene.gaussians, scene.clusters.start, scene.clusters.centers)
    assert np.all(stored["radii"] >= exact.radii) and np.all(stored["mean_radii"] >= exact.mean_radii)
    assert np.all(stored["footprint_radii"] >= exact.footprint_radii)
    slack = 1e-6 * (np.abs(exact.box_low) + np.abs(exact.box_high))  # the rounding of float32
    assert np.all(stored["box_low"] <= exact.box_low + slack) and np.all(stored["box_high"] >= exact.box_high - slack)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Levels in a folder and in a file, and a flat file with identities of its own; each by its name."""
    place = tmp_path_factory.mktemp("scenes")
    flat = st.Scene.flat(hard_scene(900, "surface", 3, degree=2), source=st.scene.scene.Source(origin=(4e5, 0, 0)))
    st.write(flat, place / "in.ply")
    levels = st.BuildOptions(method="radius", radius=0.1, max_roots=4)
    st.build_folder(place / "in.ply", place / "parts.splatree", levels, st.FolderOptions(part_rows=300))
    pairs = st.build_lod(flat, st.BuildOptions(method="pairs"))
    st.write(pairs, place / "pairs.splatree")
    st.write(st.build_clusters(pairs, 8), place / "pairs with clusters.splatree")
    ids = np.random.default_rng(1).permutation(900).astype(np.uint32)
    st.write(replace(flat, ids=ids, threshold=0.02, tile_rule="3sigma"), place / "flat.splatree")
    st.write(st.build_clusters(flat, 20), place / "flat with clusters.splatree")
    return place


NAMES = ["parts", "pairs", "pairs with clusters", "flat", "flat with clusters"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("room", [0, 10**9])
@pytest.mark.parametrize("count", [1, 30])
def test_levels_and_identities_are_kept(scenes, tmp_path, monkeypatch, name, room, count):
    with_room(monkeypatch, room, tmp_path)
    done = st.cluster_file(scenes / f"{name}.splatree", tmp_path / "out.splatree", count)
    wanted, made = bytes_of_memory(scenes / f"{name}.splatree", count)
    assert (tmp_path / "out.splatree").read_bytes() == wanted
    assert (done.num_gaussians, done.num_rows) == (made.tree.num_leaves, len(made))
    assert list(tmp_path.iterdir()) == [tmp_path / "out.splatree"]


def test_several_inputs_are_one_scene(tmp_path, ply):
    copy = tmp_path / "copy.ply"
    copy.write_bytes(ply.read_bytes())
    done = st.cluster_file([copy, ply], tmp_path / "out.splatree")
    wanted, made = bytes_of_memory([copy, ply], "auto")
    assert (tmp_path / "out.splatree").read_bytes() == wanted and len(made) == 1400
    assert any("2 inputs were joined" in note for note in done.notes)


def test_scenes_of_a_store_go_there_too(bucket, scenes, tmp_path):
    for name in ("pairs", "flat"):
        located(f"{bucket}/{name}.splatree").put(scenes / f"{name}.splatree")
        st.cluster_file(f"{bucket}/{name}.splatree", f"{bucket}/out.splatree", 30, force=True)
        st.cluster_file(scenes / f"{name}.splatree", tmp_path / "out.splatree", 30, force=True)
        assert located(f"{bucket}/out.splatree").read_bytes() == (tmp_path / "out.splatree").read_bytes()


def test_repairs_are_made_on_the_way(tmp_path):
    path = tmp_path / "in.ply"
    st.write(st.Scene.flat(hard_scene(300, "surface", 4)), path)
    data, place = bytearray(path.read_bytes()), path.read_bytes().index(b"end_header\n") + 11
    row = (len(data) - place) // 300
    data[place + 7 * row : place + 7 * row + 4] = np.float32(np.nan).tobytes()
    path.write_bytes(data)
    with pytest.raises(st.FormatError, match="row 7"):
        st.cluster_file(path, tmp_path / "out.splatree", 9)
    done = st.cluster_file(path, tmp_path / "out.splatree", 9, reading=st.ReadOptions(repair=True))
    assert done.num_rows == 299 and sum(done.repairs.values()) == 1


def test_what_cannot_be_done_is_refused_before_anything_is_written(tmp_path, ply, scenes):
    def refused(message, *arguments, error=st.InputError, **options):
        with pytest.raises(error, match=message):
            st.cluster_file(*arguments, **options)

    out = tmp_path / "out.splatree"
    refused(r"found a format without clusters, wanted a name that ends in \.splatree", ply, tmp_path / "out.ply")
    refused("found 701 for 700 Gaussians", ply, out, 701)
    st.write(st.read(scenes / "pairs.splatree"), tmp_path / "compact.splatree", options=st.WriteOptions(compact=True))
    refused("compact, to be repaired or one of several; convert it", tmp_path / "compact.splatree", out)
    refused("to be repaired", scenes / "pairs.splatree", out, reading=st.ReadOptions(repair=True))
    refused("one of several", [ply, scenes / "pairs.splatree"], out)
    refused(r"wanted a number of bytes", ply, out, max_memory="much")
    refused(
        r"found 700 clusters of 700 Gaussians, for whose centres about 0 MB are needed beside the program, wanted at most 0 MB",
        *(ply, out, 700),
        max_memory="130M",
    )
    out.write_bytes(b"mine")
    refused("exists", ply, out, error=st.OutputError)
    assert out.read_bytes() == b"mine"
