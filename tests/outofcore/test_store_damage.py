"""Stores whose files were damaged, replaced or made up: an error that names the file, or the same picture; never another one."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.io.formats.folder.manifest import stored_file
from splatree.io.formats.splatree.container import header_bytes, open_container, placed

from .conftest import small_pages
from .test_store import CAMERAS

ALL = st.SelectOptions(pixel_error=0, view_test="none")
"""All leaves: every page is read."""


@pytest.fixture
def copy(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy.splatree")


def flip(path, place):
    data = bytearray(path.read_bytes())
    data[place] ^= 0x10
    path.write_bytes(data)


def draw_all(path):
    with st.open_store(path) as store:
        return [st.render(store, camera, select=ALL).image.tobytes() for camera in CAMERAS[:2]]


@settings(max_examples=60, deadline=None)
@given(hs.sampled_from(["crown.splatree", "parts/00000.splatree", "parts/00002.splatree"]), hs.floats(0, 1))
def test_no_flipped_bit_changes_the_picture(tmp_path_factory, folder, scene, name, share):
    path = shutil.copytree(folder, tmp_path_factory.mktemp("flipped") / "copy.splatree")
    file = path / name
    flip(file, min(int(share * file.stat().st_size), file.stat().st_size - 1))
    wanted = [st.render(scene, camera, select=ALL).image.tobytes() for camera in CAMERAS[:2]]
    try:
        found = draw_all(path)
    except st.InputError as error:
        assert file.name in str(error) or "copy.splatree" in str(error)
    else:
        assert found == wanted
    shutil.rmtree(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "manifest.json: not found, but .* holds parts of a scene"),
        ("", "manifest.json: is empty: found 0 bytes; a download"),
        ("[]", "manifest.json: found a list, wanted an object"),
        ("[" * 100_000, "manifest.json: not valid JSON"),
        ('{"format": "other"}', "manifest.json: found format 'other'"),
    ],
)
def test_the_crown_never_passes_for_the_scene(copy, text, message):
    """Without the pages' index nothing else in the folder would be refused."""
    (copy / "pages.index").unlink()
    (copy / "manifest.json").unlink()
    if text is not None:
        (copy / "manifest.json").write_text(text)
    for use in (st.read, st.check, st.open_store):
        with pytest.raises(st.FormatError, match=message):
            use(copy)


def test_a_damaged_page_is_named(copy):
    flip(copy / "parts" / "00001.splatree", -100)  # the last columns: ids, depths
    damaged = pytest.raises(st.FormatError, match=r"00001\.splatree: rows \d+ to \d+: found checksum")
    with st.open_store(copy) as store, damaged:
        store.select(CAMERAS[0], ALL)


@pytest.mark.parametrize("name", ["gaussians.sh", "tree.curves"])
def test_what_drawing_alone_reads_is_checked_where_it_is_drawn(copy, name):
    part = copy / "parts" / "00001.splatree"
    column = open_container(part).columns[name]
    flip(part, column.start + column.num_bytes // 2)
    with st.open_store(copy) as store:
        store.select(CAMERAS[0], ALL)  # looks at neither
        with pytest.raises(
            st.FormatError, match=r"00001\.splatree: rows \d+ to \d+: found harmonics and curves of checksum"
        ):
            st.render(store, CAMERAS[0], select=ALL)


def test_parts_that_changed_places_are_refused(copy):
    a, b = copy / "parts" / "00001.splatree", copy / "parts" / "00002.splatree"
    data = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(data)
    with pytest.raises(st.FormatError, match=r"wanted .* as manifest\.json says"):
        st.open_store(copy)


def rewritten(folder_path, change):
    """The folder with an index that says something else, and a manifest that agrees."""
    path = folder_path / "pages.index"
    container = open_container(path)
    columns = {name: container.rows(name).copy() for name in container.columns}
    values = {key: text for key, text in container.values.items() if key not in ("format", "version")}
    numbers = json.loads(values["numbers"])
    change(columns, numbers)
    values["numbers"] = json.dumps(numbers)
    del container
    places = placed({name: (column.dtype, column.shape) for name, column in columns.items()})
    path.write_bytes(header_bytes(values, places) + b"".join(columns[name].tobytes() for name in places))
    manifest = json.loads((folder_path / "manifest.json").read_text())
    manifest["index"] = vars(stored_file(folder_path, "pages.index"))
    (folder_path / "manifest.json").write_text(json.dumps(manifest))


def put(name, place, value):
    return lambda columns, numbers: columns[name].__setitem__(place, value)


def shorter(columns):
    return {name: column[:1] for name, column in columns.items() if name.startswith("table.block_")}


HOSTILE = {
    "a page beyond its file": (put("table.end", -1, 10**6), "follow each other|checksums"),
    "a page before its file": (put("table.begin", 0, -5), "follow each other"),
    "a gap": (put("table.begin", 1, 3), "follow each other|checksums"),
    "files": (put("file_start", 1, 0), "follow each other|files with"),
    "no such ancestor": (put("table.ancestors", 0, 10**6), "ancestors that are not there"),
    "starts of ancestors": (put("table.ancestor_start", 1, -1), "ancestors that are not there"),
    "an ancestor behind": (put("table.rows", slice(None), 10**6), "do not hold their page"),
    "roots": (put("table.first_root", -1, 10**9), "roots that are not numbered"),
    "rows of the whole": (put("whole_rows", 1, 0), "no ascending rows"),
    "a row beyond the whole": (put("whole_rows", -1, 2**31 - 1), "wanted less than"),
    "identities": (lambda columns, numbers: numbers.update(largest_id=2**32 - 1), "no room"),
    "a negative number": (lambda columns, numbers: numbers.update(num_rows=-1), "num_rows"),
    "too few rows": (lambda columns, numbers: numbers.update(num_rows=7), "whole_rows|num_rows|rows and"),
    "no such column": (lambda columns, numbers: columns.pop("whole_rows"), "found no column 'whole_rows'"),
    "blocks": (lambda columns, numbers: columns.update(shorter(columns)), "table: found 1 blocks"),
    "a type": (lambda columns, numbers: columns.update(whole_rows=np.zeros(3, np.float32)), "found dtype float32"),
    "starts of pages above": (put("above_start", -1, 0), "above_start: found no ascending places"),
    "a page above that is none of the crown": (put("above", 0, 10**6), "pages that are not among"),
    "checksums": (lambda columns, numbers: columns.update(drawn_checksums=np.zeros(3, np.uint32)), "found 3 checksums"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_index_is_refused(copy, what):
    change, message = HOSTILE[what]
    rewritten(copy, change)
    with pytest.raises(st.InputError, match=message) as error:
        st.open_store(copy)
    assert "copy.splatree" in str(error.value)


@settings(max_examples=60, deadline=None)
@given(data=hs.data())
def test_made_up_numbers_in_the_index_give_an_error_or_a_picture(tmp_path_factory, folder, data):
    path = shutil.copytree(folder, tmp_path_factory.mktemp("made-up") / "copy.splatree")
    rng = np.random.default_rng(data.draw(hs.integers(0, 2**32 - 1)))

    def change(columns, numbers):
        column = columns[data.draw(hs.sampled_from(sorted(columns)))].reshape(-1)
        for _ in range(data.draw(hs.integers(1, 4))):
            bits = rng.integers(0, 256, column.itemsize, np.uint8).tobytes()
            column[rng.integers(len(column))] = np.frombuffer(bits, column.dtype)[0]

    rewritten(path, change)
    try:
        draw_all(path)
    except st.InputError as error:
        assert "copy.splatree" in str(error)
    shutil.rmtree(path)


def test_a_file_that_is_cut_off_is_refused(tmp_path, scene):
    path = tmp_path / "one.splatree"
    st.write(scene, path)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(st.FormatError, match=r"one\.splatree: .*cut off"):
        st.open_store(path)


def test_trees_that_are_none_are_refused(tmp_path, scene):
    path = tmp_path / "one.splatree"
    st.write(scene, path)
    column = open_container(path).columns["tree.subtree_end"]
    is_inner = np.flatnonzero(~scene.tree.is_leaf)
    data = bytearray(path.read_bytes())
    for row in is_inner[5::40]:
        end = int(scene.tree.subtree_end[row])
        data[column.start + 4 * row : column.start + 4 * row + 4] = (end - 1).to_bytes(4, "little")
        path.write_bytes(data)
        with small_pages(60), pytest.raises(st.FormatError, match=r"one\.splatree"):
            st.open_store(path)
        data[column.start + 4 * row : column.start + 4 * row + 4] = end.to_bytes(4, "little")


def test_other_files_are_refused(tmp_path):
    st.write(st.Scene.flat(st.Gaussians.empty()), tmp_path / "in.ply")
    with pytest.raises(st.FormatError, match=r"in\.ply"):
        st.open_store(tmp_path / "in.ply")
    with pytest.raises(st.InputError, match="missing"):
        st.open_store(tmp_path / "missing.splatree")
    with pytest.raises(st.InputError, match="manifest"):
        st.open_store(tmp_path)
    with pytest.raises(st.InputError, match="memory: found 'much'"):
        st.open_store(tmp_path / "in.ply", max_memory="much")
