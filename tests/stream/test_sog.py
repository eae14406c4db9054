"""Streamed SOG: what is in the files is what the levels say, the boxes hold, and a stream that stopped goes on."""

import dataclasses
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

import splatree as st
from splatree.io.formats.sog import reader as sog
from splatree.io.options import ReadOptions
from splatree.maths.covariance import covariances_from_gaussians
from splatree.stream import sog as module
from splatree.stream.chunks import chunks_of_tree
from splatree.stream.levels import levels_of_tree
from splatree.stream.parts import Folder
from splatree.stream.stream import stream

from .conftest import forest

OPTIONS = st.StreamOptions(ratio=2, chunk_leaves=40, unit_rows=150, levels=4)


@pytest.fixture(scope="module")
def scene():
    return forest(900, seed=5, sh_degree=1)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("stream") / "out"
    stream(scene, path, options=OPTIONS)
    return path


def manifest_of(folder):
    return json.loads((folder / "lod-meta.json").read_text())


def leaves_of(node):
    return [node] if "lods" in node else [leaf for child in node["children"] for leaf in leaves_of(child)]


def bytes_of(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_each_range_holds_the_rows_of_its_chunk_and_level_in_order(scene, folder):
    manifest = manifest_of(folder)
    chunks = chunks_of_tree(scene, OPTIONS.chunk_leaves)
    levels = levels_of_tree(scene.tree, chunks, ratio=OPTIONS.ratio, num_levels=OPTIONS.levels)
    units = [sog.open_rows(folder / name, ReadOptions()).unchecked_scene().gaussians for name in manifest["filenames"]]
    leaves = leaves_of(manifest["tree"])
    assert len(leaves) == len(chunks) and manifest["lodLevels"] == len(levels) == 4
    ranges = set()
    for chunk, leaf in enumerate(leaves):
        assert list(leaf["lods"]) == ["0", "1", "2", "3"]  # a level that is missing would be a hole
        for index, level in enumerate(levels):
            entry = leaf["lods"][str(index)]
            ranges.add((entry["file"], index))
            found = units[entry["file"]].means[entry["offset"] : entry["offset"] + entry["count"]]
            wanted = scene.gaussians.means[level.of_chunk(chunk)]
            # 16 bits of sign(x) ln(1 + |x|) over the unit: less than 1e-3 in this scene of a few units.
            np.testing.assert_allclose(found, wanted, atol=1e-3)
    assert len(ranges) == len(units)  # a file has one level only
    assert manifest["counts"] == [len(level) for level in levels] and manifest["count"] == sum(manifest["counts"])
    assert all(len(unit) <= 300 for unit in units)


def test_level_0_is_the_leaves_and_every_level_reads_back(scene, folder):
    manifest = manifest_of(folder)
    leaves = scene.gaussians.take(scene.tree.is_leaf)
    back = st.read(folder)
    np.testing.assert_allclose(back.gaussians.means, leaves.means, atol=1e-3)
    assert back.gaussians.sh_degree == 1
    for level, count in enumerate(manifest["counts"]):
        assert len(st.read(folder, level=level)) == count


def test_boxes_hold_the_ellipsoids_of_all_levels(scene, folder):
    chunks = chunks_of_tree(scene, OPTIONS.chunk_leaves)
    levels = levels_of_tree(scene.tree, chunks, ratio=OPTIONS.ratio, num_levels=OPTIONS.levels)
    manifest = manifest_of(folder)
    covariances = covariances_from_gaussians(scene.gaussians.quats, scene.gaussians.log_scales)
    reach = np.sqrt(np.einsum("nii->ni", covariances))
    for chunk, leaf in enumerate(leaves_of(manifest["tree"])):
        rows = np.concatenate([level.of_chunk(chunk) for level in levels])
        means = scene.gaussians.means[rows].astype(float)
        low, high = (np.array(leaf["bound"][end]) for end in ("min", "max"))
        assert np.all(low <= (means - reach[rows]).min(axis=0) + 1e-12)
        assert np.all(high >= (means + reach[rows]).max(axis=0) - 1e-12)

    def check(node):
        for child in node.get("children", ()):
            assert np.all(np.array(node["bound"]["min"]) <= child["bound"]["min"])
            assert np.all(np.array(node["bound"]["max"]) >= child["bound"]["max"])
            check(child)

    check(manifest["tree"])


def test_the_bytes_do_not_depend_on_threads(scene, folder, tmp_path):
    for threads in (1, 3):
        stream(scene, tmp_path / str(threads), options=OPTIONS, threads=threads)
        assert bytes_of(tmp_path / str(threads)) == bytes_of(folder)


def test_no_name_leads_out_of_the_folder(folder):
    for name in manifest_of(folder)["filenames"]:
        assert not Path(name).is_absolute() and ".." not in Path(name).parts and (folder / name).is_file()


def test_an_interrupted_stream_goes_on_where_it_stopped(scene, folder, tmp_path, monkeypatch):
    written = []

    def some(self, name, write, make=Folder.make):
        if len(written) == 5:
            raise KeyboardInterrupt
        written.append(name)
        return make(self, name, write)

    with monkeypatch.context() as patched:
        patched.setattr(Folder, "make", some)
        with pytest.raises(KeyboardInterrupt):
            stream(scene, tmp_path / "out", options=OPTIONS, threads=1)
    assert not (tmp_path / "out" / "lod-meta.json").exists()
    (tmp_path / "out" / ".0_9-0123456789ab.0badcafe.tmp").mkdir()  # what a crash leaves
    done = stream(scene, tmp_path / "out", options=OPTIONS)
    assert (done.num_parts_kept, done.num_parts) == (5, 7)
    assert bytes_of(tmp_path / "out") == bytes_of(folder)


def test_a_new_stream_replaces_the_old_one_and_nothing_else(scene, tmp_path):
    out = tmp_path / "out"
    stream(scene, out, options=OPTIONS)
    with pytest.raises(st.OutputError, match="holds a stream already; choose another folder or replace it with force"):
        stream(scene, out, options=OPTIONS)
    (out / "licence.txt").write_text("mine")
    (out / "photo").mkdir()
    again = stream(scene, out, options=st.StreamOptions(ratio=2, chunk_leaves=40, unit_rows=150, levels=2), force=True)
    assert again.num_parts_kept == again.num_parts == 5  # levels 0 and 1 are as they were
    names = {name.split("/")[0] for name in manifest_of(out)["filenames"]}
    assert {path.name for path in out.iterdir()} == names | {"lod-meta.json", "licence.txt", "photo"}


def test_a_folder_of_something_else_is_refused(scene, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("")
    with pytest.raises(st.OutputError, match=r"holds thesis\.tex, wanted a new or an empty folder"):
        stream(scene, tmp_path / "out")
    (tmp_path / "file").write_text("")
    with pytest.raises(st.OutputError, match="is a file, wanted a folder"):
        stream(scene, tmp_path / "file")
    with pytest.raises(st.OutputError, match="there is no folder"):
        stream(scene, tmp_path / "a" / "b")


def test_a_stream_cut_short_is_refused_by_the_name_of_the_file(scene, tmp_path):
    out = tmp_path / "out"
    stream(scene, out, options=OPTIONS)
    manifest = out / "lod-meta.json"
    whole = manifest.read_bytes()
    for cut in (1, len(whole) // 2, len(whole) - 1):
        manifest.write_bytes(whole[:cut])
        with pytest.raises(st.FormatError, match=r"lod-meta\.json"):
            st.read(manifest)
    manifest.write_bytes(whole)
    picture = next(out.glob("0_0-*/means_l.webp"))
    picture.write_bytes(picture.read_bytes()[:40])
    with pytest.raises(st.FormatError, match=r"means_l\.webp"):
        st.read(manifest)


def test_harmonics_are_cut_off(scene, tmp_path):
    stream(scene, tmp_path / "out", options=st.StreamOptions(sh_degree=0))
    assert st.read(tmp_path / "out").gaussians.sh_degree == 0


def test_a_scene_without_levels_gets_them(tmp_path):
    flat = forest(400, seed=1, num_roots=400)
    done = stream(flat, tmp_path / "out", options=st.StreamOptions(levels=3))
    assert done.levels[0].num_nodes == 400 and len(done.levels) > 1


def test_the_mode_of_the_scene_is_named(tmp_path):
    scene = forest(100, seed=1)
    stream(st.Scene(scene.gaussians, scene.tree, mode="antialiased"), tmp_path / "out")
    assert st.read(tmp_path / "out").mode == "antialiased"


def test_units_have_whole_chunks_of_one_level():
    scene = forest(900, seed=5)
    levels = levels_of_tree(scene.tree, chunks_of_tree(scene, 40), ratio=OPTIONS.ratio, num_levels=4)
    units = list(module._units(levels, 150))
    for index, level in enumerate(levels):
        own = [unit for unit in units if unit.level == index]
        assert [unit.first_chunk for unit in own] == [0, *(unit.end_chunk for unit in own[:-1])]
        assert own[-1].end_chunk == len(level.offsets) - 1
        for unit in own:
            count = level.offsets[unit.end_chunk] - level.offsets[unit.first_chunk]
            assert count <= (150 if index < 2 else 300) or unit.end_chunk == unit.first_chunk + 1


def test_a_zipped_stream_is_one_file_with_the_same_entries(scene, folder, tmp_path):
    options = dataclasses.replace(OPTIONS, zip=True)
    done = stream(scene, tmp_path / "city.ssog", options=options)
    again = stream(scene, tmp_path / "again.ssog", options=options, threads=1)
    assert done.output.read_bytes() == again.output.read_bytes() and done.bytes == done.output.stat().st_size
    with zipfile.ZipFile(done.output) as bundle:
        assert bundle.namelist()[0] == "lod-meta.json" and bundle.testzip() is None
        assert {name: bundle.read(name) for name in bundle.namelist()} == bytes_of(folder)
    assert {path.name for path in tmp_path.iterdir()} == {"city.ssog", "again.ssog"}
    for level in (0, 2):
        one, other = st.read(done.output, level=level), st.read(folder, level=level)
        np.testing.assert_array_equal(one.gaussians.means, other.gaussians.means)
    with pytest.raises(st.OutputError, match="exists"):
        stream(scene, tmp_path / "city.ssog", options=options)
    with pytest.raises(st.InputError, match=r"wanted one that ends in \.ssog"):
        stream(scene, tmp_path / "city", options=options)


def test_a_zipped_stream_is_judged_like_its_folder(scene, folder, tmp_path):
    camera = st.Camera.look_at([0.5, 0.5, -3.0], [0.5, 0.5, 0.5], width=96, height=64)
    found = [
        st.report_stream(scene, stream(scene, tmp_path / name, options=options), [camera], budgets=[300])
        for name, options in (("city", OPTIONS), ("city.ssog", dataclasses.replace(OPTIONS, zip=True)))
    ]
    assert found[0] == found[1]


def test_a_zip_that_leads_out_of_its_folder_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "evil.ssog", "w") as bundle:
        bundle.writestr("lod-meta.json", "{}")
        bundle.writestr("../evil.txt", "")
    with pytest.raises(st.FormatError, match=r"\.\./evil\.txt"):
        st.read(tmp_path / "evil.ssog")
