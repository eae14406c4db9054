"""Stores that lie elsewhere: built there, and drawn from there by the ranges that a view needs."""

from dataclasses import fields

import fsspec
import numpy as np
import pytest

import splatree as st
from splatree.cli.main import main
from splatree.io.formats.splatree import container

from ..ranged_server import served
from .conftest import small_pages


@pytest.fixture(scope="module")
def folder(ply, tmp_path_factory):
    """A folder of a few parts and pages: a request to a server takes longer than a page of this machine."""
    with small_pages(400):
        options, running = st.BuildOptions(radius=0.1, max_roots=4, follow=False), st.FolderOptions(part_rows=500)
        return st.build_folder(ply, tmp_path_factory.mktemp("elsewhere") / "city.splatree", options, running).path


@pytest.fixture(scope="module")
def scene(folder):
    return st.read(folder)


def cameras_of(scene):
    centre = np.median(scene.gaussians.means, axis=0)
    for distance, fov in ((1.0, 5.0), (8.0, 60.0)):
        yield st.Camera.look_at(centre + [0, 0, -distance], centre, width=48, height=32, fov_y_deg=fov)


def check_is_drawn_alike(store, scene):
    for camera in cameras_of(scene):
        found, wanted = st.render(store, camera), st.render(scene, camera)
        assert found.image.tobytes() == wanted.image.tobytes()


def test_a_store_of_a_server_is_drawn_from_its_ranges(folder, scene):
    with served(folder.parent) as server:
        address, sent = server.address, server.sent
        for named in (folder.name, f"{folder.name}/manifest.json"):
            with st.open_store(f"{address}/{named}") as store:
                opened = sum(sent)
                near = next(cameras_of(scene))
                st.render(store, near)
                few = len({store.index.table.begin[number] for number in store._pages})
                assert sum(sent) - opened > 0 and few < len(store.index.table)
                check_is_drawn_alike(store, scene)
        assert (st.read(f"{address}/{folder.name}").ids == scene.ids).all()


def test_a_store_is_opened_and_drawn_by_few_requests_over_connections_that_stay(folder, scene):
    with served(folder.parent) as server, st.open_store(f"{server.address}/{folder.name}") as store:
        num_files = len(store.index.file_start) - 1
        # The head of each file, of the manifest and of the index; what merging must know of the roots of each file.
        assert (num_files, len(server.sent)) == (3, 2 * num_files + 2)
        st.render(store, list(cameras_of(scene))[-1])
        assert store.num_loaded == len(store.index.table) == 2 * num_files  # all pages
        assert (
            len(server.sent) == 3 * num_files + 2
        )  # the rows of each file, whose pages and columns lie near each other
        assert len(server.opened) <= num_files


def test_pages_of_an_object_are_counted_with_their_harmonics_and_kept_within_the_limit(bucket, scene, tmp_path):
    st.write(scene, f"{bucket}/one.splatree")
    st.write(scene, tmp_path / "one.splatree")
    with (
        small_pages(200),
        st.open_store(f"{bucket}/one.splatree") as there,
        st.open_store(tmp_path / "one.splatree") as here,
    ):
        row_bytes = scene.gaussians.nbytes / len(scene)
        for number in range(len(there.index.table)):
            there.page(number, len(there.index.table))
            here.page(number, len(here.index.table))
        assert there.resident_bytes > row_bytes * len(scene) > here.resident_bytes
    with small_pages(100), st.open_store(f"{bucket}/one.splatree", max_memory="60k") as store:
        num_pages = len(store.index.table)
        for number in range(num_pages):
            store.page(number, num_pages)
            assert store.resident_bytes <= 60_000
        assert store.num_loaded == num_pages and row_bytes * len(scene) > 1.5 * 60_000


def test_a_single_file_of_a_server_is_drawn_from_its_ranges(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(container, "NEAR_BYTES", 0)  # columns of a large file lie far from each other
    path = tmp_path / "one.splatree"
    st.write(scene, path)
    with small_pages(100), served(tmp_path) as server, st.open_store(f"{server.address}/one.splatree") as store:
        # The index is made of all columns but the harmonics, of which the first 16 kB of the file have some.
        assert sum(server.sent) < path.stat().st_size - scene.gaussians.sh.nbytes + 16384
        num_columns, num_roots = 8, 5
        assert len(store.index.table) == 12
        assert len(server.sent) <= 2 + num_roots + num_columns  # all pages by one request a column
        check_is_drawn_alike(store, scene)
    with small_pages(100), st.open_store(path) as here:
        assert all(
            getattr(store.index.table, f.name).tobytes() == getattr(here.index.table, f.name).tobytes()
            for f in fields(here.index.table)
        )


def test_a_single_file_of_a_server_is_drawn_by_the_command_from_its_ranges(scene, tmp_path, monkeypatch, capsys):
    st.write(scene, tmp_path / "one.splatree")
    monkeypatch.setattr("splatree.cli.opening.read_scene", None)
    with served(tmp_path) as server:
        line = (
            f"render {server.address}/one.splatree -o {tmp_path}/picture.png --width 32 --height 24 --max-memory 300M"
        )
        assert main(line.split()) == 0, capsys.readouterr().err


def test_a_scene_of_a_store_is_built_into_it(bucket, ply, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fsspec.filesystem("memory").put_file(str(ply), "/bucket/in.ply")
    running = st.FolderOptions(part_rows=200)
    for force in (False, True):
        built = st.build_folder(f"{bucket}/in.ply", f"{bucket}/city.splatree", running=running, force=force)
    here = st.build_folder(ply, tmp_path / "city.splatree", running=running)
    files = fsspec.filesystem("memory")
    listed = sorted(path.relative_to(here.path).as_posix() for path in here.path.rglob("*") if path.is_file())
    assert sorted(name.removeprefix("/bucket/city.splatree/") for name in files.find("/bucket/city.splatree")) == listed
    assert str(built.path) == f"{bucket}/city.splatree" and not list(tmp_path.glob("*.work"))
    found, wanted = st.read(f"{bucket}/city.splatree"), st.read(here.path)
    assert found.gaussians.means.tobytes() == wanted.gaussians.means.tobytes()
    with st.open_store(f"{bucket}/city.splatree") as store:
        check_is_drawn_alike(store, wanted)
    with pytest.raises(st.OutputError, match=r"memory://bucket/city\.splatree: exists already"):
        st.build_folder(f"{bucket}/in.ply", f"{bucket}/city.splatree", running=running)


def test_a_thinned_scene_is_sent(bucket, ply, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    st.thin_file(ply, f"{bucket}/thin.ply", st.ThinOptions(radius=0.1))
    st.thin_file(ply, tmp_path / "thin.ply", st.ThinOptions(radius=0.1))
    assert fsspec.filesystem("memory").cat_file("/bucket/thin.ply") == (tmp_path / "thin.ply").read_bytes()


def test_a_folder_of_sog_is_thinned_to_where_there_is_one_already(bucket, ply, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sog").mkdir()
    fsspec.filesystem("memory").pipe_file("/bucket/sog/notes.txt", b"kept")
    for folder in (tmp_path / "sog", f"{bucket}/sog"):
        st.thin_file(ply, f"{folder}/meta.json", st.ThinOptions(radius=0.1))
    here, there = st.read(tmp_path / "sog"), st.read(f"{bucket}/sog/meta.json")
    assert here.gaussians.means.tobytes() == there.gaussians.means.tobytes()


def test_verbs_take_addresses(bucket, ply, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    fsspec.filesystem("memory").put_file(str(ply), "/bucket/in.ply")
    for line in (
        f"convert {bucket}/in.ply {bucket}/out.spz",
        f"build {bucket}/in.ply {bucket}/city.splatree --part-rows 300",
        f"info {bucket}/city.splatree",
        f"render {bucket}/city.splatree -o pictures --views 1 --width 32 --height 24",
    ):
        assert main(line.split()) == 0, capsys.readouterr().err
    assert f"wrote {bucket}/city.splatree" in capsys.readouterr().out
    assert list((tmp_path / "pictures").glob("*.png"))
    assert main(["convert", f"{bucket}/in.ply", f"{bucket}/out.spz"]) != 0
    assert f"{bucket}/out.spz: exists already" in capsys.readouterr().err
