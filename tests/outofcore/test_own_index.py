"""The index of pages in one `.splatree`: written with the file, read instead of the rows, and held against them."""

import json
import shutil
from dataclasses import fields, replace
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as hs

import splatree as st
from splatree.clusters.build import build_clusters
from splatree.io.formats.splatree.container import append_bytes, container_in, header_bytes, open_container, placed
from splatree.io.pages import index_file

from ..ranged_server import served
from .conftest import small_pages
from .test_store import CAMERAS, check_boxes_hold, check_is_drawn_as
from .test_store_damage import ALL, draw_all, flip, put


def indexed():
    """Every file with levels has an index as long as the context lasts."""
    return mock.patch.object(index_file, "INDEXED_ROWS", 1)


@pytest.fixture(scope="module")
def path(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("indexed") / "one.splatree"
    with small_pages(60), indexed():
        st.write(scene, path)
    return path


@pytest.fixture
def copy(path, tmp_path):
    return shutil.copy(path, tmp_path / "copy.splatree")


def test_a_file_is_opened_without_a_look_at_its_rows_and_drawn_as_in_memory(path, scene, monkeypatch):
    monkeypatch.setattr("splatree.outofcore.opened.table_of", None)
    with st.open_store(path) as store:
        assert (len(store), store.index.num_leaves, store.num_loaded) == (len(scene), scene.tree.num_leaves, 0)
        assert store.index.num_levels == scene.tree.num_levels
        for camera in CAMERAS[:3]:
            check_is_drawn_as(store, scene, camera, st.SelectOptions())
        assert 0 < store.num_loaded < len(store.index.table)
        check_boxes_hold(store)


def test_the_index_is_that_which_opening_makes(path, scene, tmp_path):
    with small_pages(60):
        st.write(scene, tmp_path / "plain.splatree")
        with st.open_store(path) as stored, st.open_store(tmp_path / "plain.splatree") as made:
            for f in fields(made.index.table):
                assert getattr(stored.index.table, f.name).tobytes() == getattr(made.index.table, f.name).tobytes()
        assert st.check(path)[0].num_nodes == len(scene)


def test_a_file_that_is_written_by_runs_has_the_same_bytes(path, scene, tmp_path):
    with small_pages(60), indexed():
        with st.create_scene(tmp_path / "runs.splatree", st.SceneHead.of(scene)) as writer:
            for begin in range(0, len(scene), 700):
                writer.append(st.SceneRows.of(scene).part(begin, min(begin + 700, len(scene))))
        st.convert(path, tmp_path / "converted.splatree")
        assert st.check(tmp_path / "converted.splatree")[0].num_nodes == len(scene)
    assert (tmp_path / "runs.splatree").read_bytes() == path.read_bytes()
    assert "pages" in open_container(tmp_path / "converted.splatree").columns


def test_others_read_the_file_and_pass_over_the_index(path, scene):
    from safetensors.numpy import load_file

    read = st.read(path)
    assert load_file(path)["gaussians.sh"].tobytes() == read.gaussians.sh.tobytes() == scene.gaussians.sh.tobytes()
    assert (read.tree.subtree_end == scene.tree.subtree_end).all() and read.ids.tobytes() == scene.ids.tobytes()


def test_small_flat_and_compact_files_and_parts_have_none(scene, folder, tmp_path):
    st.write(scene, tmp_path / "small.splatree")
    with indexed():
        st.write(st.Scene.flat(scene.gaussians), tmp_path / "flat.splatree")
        st.write(scene, tmp_path / "compact.splatree", options=st.WriteOptions(compact=True))
        with st.create_scene(tmp_path / "asked.splatree", st.SceneHead.of(scene), pages=False) as writer:
            writer.append(scene)
        ply = tmp_path / "in.ply"
        st.write(st.Scene.flat(scene.gaussians.take(np.arange(300))), ply)
        built = st.build_folder(ply, tmp_path / "city.splatree", running=st.FolderOptions(part_rows=100)).path
    for file in [*tmp_path.glob("*.splatree"), *built.rglob("*.splatree")]:
        if file.is_file():
            assert "pages" not in open_container(file).columns
    assert st.check(built)[0].by_pages


def test_clusters_and_an_index_stand_side_by_side(scene, tmp_path):
    with indexed(), small_pages(60):
        st.write(build_clusters(scene), tmp_path / "one.splatree")
        assert len(st.read(tmp_path / "one.splatree").clusters) > 1
        with st.open_store(tmp_path / "one.splatree") as store:
            check_is_drawn_as(store, scene, CAMERAS[1], st.SelectOptions())


def test_a_file_of_a_server_is_opened_by_its_index(path, scene):
    with served(path.parent) as server, st.open_store(f"{server.address}/one.splatree") as store:
        place = open_container(path).columns["pages"]
        assert (
            sum(server.sent) < place.num_bytes + 60_000
        )  # the head of the file, and what merging must know of its roots
        check_is_drawn_as(store, scene, CAMERAS[2], st.SelectOptions())


def rewritten(path, change):
    """The file with an index that says something else."""
    place, stored = open_container(path).columns["pages"], open_container(path).rows("pages")
    container = container_in(stored, path)
    columns = {name: container.rows(name).copy() for name in container.columns}
    numbers = json.loads(container.values["numbers"])
    change(columns, numbers)
    values = {key: text for key, text in container.values.items() if key not in ("format", "version")}
    values["numbers"] = json.dumps(numbers)
    places = placed({name: (column.dtype, column.shape) for name, column in columns.items()})
    data = b"".join(columns[name].tobytes() for name in places)
    values["checksum"] = index_file._checksum(values["numbers"], data)
    data = header_bytes(values, places) + data
    path.write_bytes(path.read_bytes()[: place.start])
    append_bytes(path, "pages", data)


def number(name, value):
    """Put a value into the numbers of an index."""
    return lambda columns, numbers: numbers.update({name: value})


def steps(num_steps):
    """Give the blocks of an index so many steps."""

    def change(columns, numbers):
        for name in index_file.STEPS:
            columns[name] = np.repeat(columns[name][:, :1], num_steps, axis=1)

    return change


HOSTILE = {
    "a page beyond the file": (put("table.end", -1, 10**6), "follow each other|checksums"),
    "files": (put("file_start", 1, 0), "files with|follow each other"),
    "an ancestor that is not there": (put("table.ancestors", 0, 10**6), "ancestors that are not there"),
    "an ancestor behind": (put("table.rows", slice(None), 10**6), "do not hold their page"),
    "other rows": (number("num_rows", 5), "num_rows: found 5, wanted [0-9]+ as in the rows"),
    "roots of parts": (number("num_roots", 7), "num_roots: found 7 in a file without parts, wanted 0"),
    "no leaves": (number("num_leaves", 0), "num_leaves: found 0, wanted [0-9]{2,} to "),
    "too few leaves": (number("num_leaves", 5), "num_leaves: found 5, wanted [0-9]{2,} to "),
    "more leaves than rows": (number("num_leaves", 10**6), "num_leaves: found 1000000, wanted [0-9]{2,} to "),
    "no levels": (number("num_levels", 0), "num_levels: found 0, wanted 1 to "),
    "fewer levels than ancestors": (number("num_levels", 1), "num_levels: found 1, wanted more than the [0-9]+ above"),
    "no steps": (steps(0), "block_step_extents: found 0 steps of a block, wanted"),
    "one step": (steps(1), "block_step_extents: found 1 steps of a block, wanted"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_index_is_refused(copy, what):
    change, message = HOSTILE[what]
    rewritten(copy, change)
    with pytest.raises(st.FormatError, match=rf"copy\.splatree/pages: .*({message})"):
        st.open_store(copy)


@pytest.mark.parametrize("at", [0, 3, 30])
def test_a_damaged_head_of_the_index_is_named_with_what_to_do(copy, path, tmp_path, at):
    flip(copy, open_container(copy).columns["pages"].start + at)
    said = r"copy\.splatree: column pages: .*: splatree convert .*copy\.splatree whole\.splatree makes the index anew$"
    with pytest.raises(st.FormatError, match=said):
        st.open_store(copy)
    with indexed(), small_pages(60):
        st.convert(copy, tmp_path / "whole.splatree")
    assert (tmp_path / "whole.splatree").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", ["table.lower", "table.block_step_scales", "table.leaf_scales", "largest_id"])
def test_an_index_of_other_rows_is_found_by_check(copy, name):
    rewritten(copy, number(name, 3) if name == "largest_id" else put(name, -1, 3))
    said = f"found another {name.removeprefix('table.')} than that of the rows; splatree convert"
    with small_pages(60), pytest.raises(st.FormatError, match=said):
        st.check(copy)


@pytest.mark.parametrize("page_rows", [60, 90])
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("gaussians.means", "found checksum"),
        ("gaussians.sh", "found harmonics and curves of checksum"),
        ("tree.curves", "found harmonics and curves of checksum"),
    ],
)
def test_check_names_damaged_rows_and_not_their_index(copy, name, said, page_rows):
    column = open_container(copy).columns[name]
    flip(copy, column.start + column.num_bytes // 2)
    wanted = rf"copy\.splatree: rows \d+ to \d+: {said} .*; the file is damaged"
    with small_pages(page_rows), pytest.raises(st.FormatError, match=wanted):
        st.check(copy)


def test_any_flipped_byte_of_the_index_is_found_when_the_file_is_opened(copy):
    place = open_container(copy).columns["pages"]
    for at in np.random.default_rng(0).integers(place.start, place.start + place.num_bytes, 30):
        flip(copy, int(at))
        with pytest.raises(st.FormatError, match=r"copy\.splatree"):
            st.open_store(copy)
        flip(copy, int(at))
    st.open_store(copy).close()


def test_a_file_whose_rows_were_changed_is_refused_where_they_are_read(copy, scene):
    place = open_container(copy).columns["gaussians.means"]
    data = bytearray(copy.read_bytes())
    moved = scene.gaussians.means + np.float32(0.25)
    data[place.start : place.start + place.num_bytes] = moved.tobytes()
    copy.write_bytes(data)
    with (
        st.open_store(copy) as store,
        pytest.raises(st.FormatError, match=r"copy\.splatree: rows \d+ to \d+: found checksum"),
    ):
        store.select(CAMERAS[0])


@settings(max_examples=40, deadline=None)
@given(share=hs.floats(0, 1))
def test_no_flipped_bit_changes_the_picture(tmp_path_factory, path, scene, share):
    copy = shutil.copy(path, tmp_path_factory.mktemp("flipped") / "copy.splatree")
    flip(copy, min(int(share * copy.stat().st_size), copy.stat().st_size - 1))
    wanted = [st.render(scene, camera, select=ALL).image.tobytes() for camera in CAMERAS[:2]]
    try:
        found = draw_all(copy)
    except st.InputError as error:
        assert "copy.splatree" in str(error)
    else:
        assert found == wanted


def test_rows_that_are_no_tree_are_refused_when_they_are_written(scene, tmp_path):
    rows = st.SceneRows.of(scene)
    wrong = replace(rows, depth=rows.depth[::-1].copy())
    with (
        indexed(),
        pytest.raises(st.FormatError, match="found subtrees and depths"),
        st.create_scene(tmp_path / "one.splatree", st.SceneHead.of(scene)) as writer,
    ):
        writer.append(wrong)
    assert not list(tmp_path.iterdir())
