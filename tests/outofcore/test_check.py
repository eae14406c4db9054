"""`check` touches everything: whatever is damaged in a scene on disk is named, and what is whole passes in little memory."""

import gzip
import json
import shutil

import numpy as np
import pytest

import splatree as st
from splatree.clusters.build import build_clusters
from splatree.io.formats.splatree.container import open_container

from .conftest import small_pages
from .test_store_damage import flip, put, rewritten


@pytest.fixture
def copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy.splatree")


def test_what_is_whole_passes(folder, scene, ply, tmp_path):
    st.write(scene, tmp_path / "one.splatree")
    with small_pages(60):
        checked = st.check([folder, tmp_path / "one.splatree"])
    for each, name in zip(checked, ("splatree-folder", "splatree"), strict=True):
        assert (each.format, each.by_pages) == (name, True)
        assert (each.num_gaussians, each.num_nodes) == (scene.tree.num_leaves, len(scene))
    (flat,) = st.check(ply)
    assert (flat.format, flat.num_gaussians, flat.by_pages) == ("ply", 700, True)
    (tmp_path / "in.ply.gz").write_bytes(gzip.compress(ply.read_bytes()))
    (packed,) = st.check(tmp_path / "in.ply.gz")
    assert (packed.path, packed.num_gaussians) == (str(tmp_path / "in.ply.gz"), 700)  # not where it was unpacked
    st.write(build_clusters(scene), tmp_path / "clustered.splatree")
    assert not st.check(tmp_path / "clustered.splatree")[0].by_pages


@pytest.mark.parametrize("name", ["crown.splatree", "parts/00001.splatree", "pages.index"])
def test_a_flipped_byte_anywhere_in_a_folder_is_found(copy, name):
    rng = np.random.default_rng(0)
    for place in rng.integers(0, (copy / name).stat().st_size, 5):
        flip(copy / name, int(place))
        with small_pages(60), pytest.raises(st.InputError, match=r"copy\.splatree"):
            st.check(copy)
        flip(copy / name, int(place))
    with small_pages(60):
        st.check(copy)


@pytest.mark.parametrize(
    "name", ["table.lower", "table.block_upper", "table.leaf_scales", "drawn_checksums", "table.means"]
)
def test_an_index_that_is_not_that_of_the_files_is_found(copy, name):
    rewritten(copy, put(name, -1, 3))
    said = name.removeprefix("table.")
    with (
        small_pages(60),
        pytest.raises(st.FormatError, match=rf"pages\.index: found another {said} than that of the files"),
    ):
        st.check(copy)


@pytest.mark.parametrize("column", ["gaussians.sh", "gaussians.means", "gaussians.quats", "tree.extents"])
def test_a_value_that_cannot_be_used_is_found_in_any_row_of_a_file(scene, tmp_path, column):
    path = tmp_path / "one.splatree"
    st.write(scene, path)
    place = open_container(path).columns[column]
    data = bytearray(path.read_bytes())
    for row in (0, len(scene) // 2, len(scene) - 1):
        at = place.start + row * place.bytes_per_row
        whole, data[at : at + 4] = bytes(data[at : at + 4]), np.float32(np.nan).tobytes()
        path.write_bytes(data)
        with small_pages(60), pytest.raises(st.FormatError, match=rf"one\.splatree: row {row}\b"):
            st.check(path)
        data[at : at + 4] = whole


def test_a_file_that_is_missing_or_of_no_format_is_told(tmp_path):
    (tmp_path / "in.txt").write_text("nothing")
    for path in (tmp_path / "in.txt", tmp_path / "missing.ply"):
        with pytest.raises(st.InputError, match=path.name):
            st.check(path)


@pytest.fixture
def tiles(scene, tmp_path):
    """A stream of many tiles, some of which finer ones stand for."""
    st.stream(scene, tmp_path / "tiles", "3dtiles", st.StreamOptions(tile_nodes=300))
    return tmp_path / "tiles"


def uris_of(tile):
    """The file of a tile, whether finer ones stand for it, and those below it."""
    yield tile["content"]["uri"], "children" in tile
    for child in tile.get("children", []):
        yield from uris_of(child)


def test_every_tile_is_read_and_each_damaged_one_is_named(tiles, scene):
    (whole,) = st.check(tiles)
    assert (whole.format, whole.by_pages, whole.num_gaussians) == ("3d-tiles", True, scene.tree.num_leaves)
    assert whole.num_nodes > whole.num_gaussians
    assert whole.num_bytes == sum(path.stat().st_size for path in tiles.iterdir())
    uris = list(uris_of(json.loads((tiles / "tileset.json").read_text())["root"]))
    coarse, finest = ([uri for uri, is_coarse in uris if is_coarse is wanted] for wanted in (True, False))
    cut_off, missing, wrong = (tiles / name for name in (*coarse[:2], coarse[-1]))
    assert len({cut_off, missing, wrong}) == 3 and finest
    read = st.read(tiles)
    cut_off.write_bytes(cut_off.read_bytes()[:-40])
    missing.unlink()
    data = bytearray(wrong.read_bytes())
    place = 28 + int.from_bytes(data[12:16], "little")
    data[place : place + 4] = np.float32(np.nan).tobytes()
    wrong.write_bytes(data)
    # A reader takes the finest tiles alone.
    assert st.read(tiles).gaussians.means.tobytes() == read.gaussians.means.tobytes()
    with pytest.raises(st.FormatError, match=r"found 3 of its tiles damaged or missing, wanted all whole") as found:
        st.check(tiles)
    for path, words in ((cut_off, "cut off"), (missing, "No such file"), (wrong, "this is no .spz")):
        (sentence,) = (part for part in str(found.value).splitlines() if path.name in part)
        assert words in sentence
    (tiles / finest[0]).write_bytes(b"glTF")
    (tiles / finest[1]).unlink()
    with pytest.raises(st.FormatError, match="found 5 of its tiles") as found:
        st.check(tiles)
    assert finest[0] in str(found.value) and finest[1] in str(found.value)


def test_tiles_that_name_one_file_again_or_none_are_counted(tiles, tmp_path):
    name = next(tiles.glob("*.glb")).name
    count = len(st.read(tiles / name))
    again = {"root": {"content": {"uri": name}, "children": [{"content": {"uri": name}}, {"content": {"uri": name}}]}}
    (tiles / "tileset.json").write_text(json.dumps({"asset": {"version": "1.1"}, **again}))
    (checked,) = st.check(tiles)
    assert (checked.num_gaussians, checked.num_nodes) == (2 * count, 3 * count)
    (tiles / "tileset.json").write_text(json.dumps({"asset": {"version": "1.1"}, "root": {}}))
    with pytest.raises(st.FormatError, match="found no glTF in its tiles"):
        st.check(tiles)
