"""Scenes on object stores and servers: what is read and written there is what is read and written here."""

import builtins
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import fsspec
import pytest

import splatree as st
from splatree.cli.main import main
from splatree.errors import FormatError, InputError, MissingExtraError, OutputError
from splatree.io import http, objects, sources
from splatree.io.objects import ObjectPath, located
from splatree.io.registry import stored_bytes
from splatree.scene.scene import Source

from ..ranged_server import (
    Busy,
    Closing,
    Cutting,
    Down,
    Forbidding,
    Leading,
    Mirrored,
    Proxy,
    Ranges,
    Refusing,
    Shifted,
    Sizeless,
    Stamped,
    Unpacked,
    Unsaid,
    served,
)
from ..scenes import random_gaussians

SUFFIXES = (".ply", ".compressed.ply", ".spz", ".splat", ".sog", ".ksplat", ".glb", ".rad", ".splatree", ".hier")


@pytest.fixture(scope="module")
def scene():
    return st.build_lod(st.Scene.flat(random_gaussians(3000, degree=1)), st.BuildOptions(method="radius", follow=False))


def check_are_equal(found, wanted):
    for field in fields(st.Gaussians):
        assert getattr(found.gaussians, field.name).tobytes() == getattr(wanted.gaussians, field.name).tobytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_is_written_to_a_store_and_read_from_there(bucket, scene, tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(objects, "FIRST_BYTES", 1000)  # so that files are of many ranges
    address, here = f"{bucket}/deep/scene{suffix}", tmp_path / f"scene{suffix}"
    assert st.write(scene, address) == st.write(scene, here)
    assert fsspec.filesystem("memory").cat_file(f"/bucket/deep/scene{suffix}") == here.read_bytes()
    found = st.read(address)
    check_are_equal(found, st.read(here))
    assert found.source.paths == (address,)
    done = st.convert(address, f"{bucket}/again.ply")
    assert st.convert(here, tmp_path / "again.ply").num_written == done.num_written
    assert fsspec.filesystem("memory").cat_file("/bucket/again.ply") == (tmp_path / "again.ply").read_bytes()


def test_folders_and_patterns_of_a_store_are_read(bucket, scene, tmp_path):
    for number in (2, 10):
        st.write(scene, f"{bucket}/chunks/chunk_{number}.splat")
        st.write(scene, tmp_path / f"chunk_{number}.splat")
    for named in ("chunks", "chunks/*.splat"):
        check_are_equal(st.read(f"{bucket}/{named}"), st.read(tmp_path))
    with pytest.raises(InputError, match=r"memory://bucket/\*\.spz: no file matches this pattern"):
        st.read(f"{bucket}/*.spz")
    with pytest.raises(InputError, match=r"memory://bucket/gone.ply: not found; wanted a scene"):
        st.read(f"{bucket}/gone.ply")


def test_a_ply_of_doubles_has_the_origin_that_it_has_here(bucket, tmp_path):
    far = st.Scene.flat(random_gaussians(500, degree=0), source=Source(origin=(4.5e5, 5.4e6, 100.0)))
    st.write(far, tmp_path / "far.ply")
    st.write(far, f"{bucket}/far.ply")
    found, wanted = st.read(f"{bucket}/far.ply"), st.read(tmp_path / "far.ply")
    check_are_equal(found, wanted)
    assert found.source.origin == wanted.source.origin != (0, 0, 0)


def test_an_object_is_replaced_only_if_that_is_asked(bucket, scene):
    st.write(scene, f"{bucket}/a.spz")
    with pytest.raises(OutputError, match=r"memory://bucket/a.spz: exists already"):
        st.write(scene, f"{bucket}/a.spz")
    st.write(scene, f"{bucket}/a.spz", force=True)


def test_a_folder_of_sog_is_written_to_a_store_whole_or_not_at_all(bucket, scene, tmp_path, monkeypatch):
    st.write(scene, tmp_path / "sog" / "meta.json")
    st.write(scene, f"{bucket}/sog/meta.json")
    files = fsspec.filesystem("memory")
    wanted = {f"/bucket/sog/{path.name}": path.read_bytes() for path in (tmp_path / "sog").iterdir()}
    assert {name: files.cat_file(name) for name in files.find("/bucket/sog")} == wanted and len(wanted) > 5
    check_are_equal(st.read(f"{bucket}/sog/meta.json"), st.read(tmp_path / "sog"))
    with pytest.raises(OutputError, match=r"memory://bucket/sog/meta\.json: exists already"):
        st.write(scene, f"{bucket}/sog/meta.json")
    put = sources._Fsspec.put

    def refuse_the_last(self, local, url):
        if url.endswith("meta.json"):
            raise OutputError(f"{url}: could not be written (full)")
        put(self, local, url)

    monkeypatch.setattr(sources._Fsspec, "put", refuse_the_last)
    with pytest.raises(OutputError, match=r"memory://bucket/new/meta\.json: could not be written \(full\)"):
        st.write(scene, f"{bucket}/new/meta.json")
    with pytest.raises(OutputError, match="full"):
        st.write(scene, f"{bucket}/sog/meta.json", force=True)
    assert sorted(files.find("/bucket")) == sorted(wanted)  # what was there before stays


def test_nothing_is_sent_of_a_file_that_could_not_be_written(bucket, scene):
    with pytest.raises(InputError, match=r"^memory://bucket/a\.spz: found version 9"):
        st.write(scene, f"{bucket}/a.spz", options=st.WriteOptions(format_version=9))
    assert not located(f"{bucket}/a.spz").exists()


def test_an_address_of_a_file_is_the_file(scene, tmp_path):
    st.write(scene, tmp_path / "a b.ply")
    assert located((tmp_path / "a b.ply").as_uri()) == tmp_path / "a b.ply"
    check_are_equal(st.read((tmp_path / "a b.ply").as_uri()), st.read(tmp_path / "a b.ply"))


def test_paths_of_addresses_are_joined_like_others():
    path = located(Path("S3://bucket/city/a.ply"))  # a path loses a slash
    assert isinstance(path, ObjectPath) and str(path) == "s3://bucket/city/a.ply"
    assert (str(path.parent / "b.ply"), path.suffix) == ("s3://bucket/city/b.ply", ".ply")
    assert path == located("s3://bucket/city/a.ply") != located("gs://bucket/city/a.ply")


def test_what_a_store_lacks_is_said(bucket, scene, monkeypatch):
    with pytest.raises(InputError, match=r"s3://b/a\.ply: found no package for s3:// .*install it: s3fs"):
        st.read("s3://b/a.ply")
    with pytest.raises(InputError, match=r"gopher://b/a\.ply: found an address of gopher, wanted https, file, or"):
        st.read("gopher://b/a.ply")
    with pytest.raises(OutputError, match=r"http://b/a\.ply: cannot be written, https is only read"):
        st.write(scene, "http://b/a.ply")
    imported = builtins.__import__

    def without_fsspec(name, *rest):
        if name == "fsspec":
            raise ImportError(name)
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_fsspec)
    with pytest.raises(MissingExtraError, match=r"s3://b/a\.ply: reading and writing s3:// needs .*splatree\[cloud\]"):
        st.read("s3://b/a.ply")


@pytest.mark.parametrize("error", [PermissionError("Forbidden"), RuntimeError("no credentials")])
def test_what_a_store_refuses_is_said_with_the_address(bucket, scene, monkeypatch, error):
    def refuse(*_, **__):
        raise error

    st.write(scene, f"{bucket}/a.ply")
    files = type(fsspec.filesystem("memory"))
    monkeypatch.setattr(files, "cat_file", refuse)
    with pytest.raises(InputError, match=rf"memory://bucket/a\.ply: cannot be read \({error}\)"):
        st.read(f"{bucket}/a.ply")
    monkeypatch.setattr(files, "put_file", refuse)
    with pytest.raises(OutputError, match=rf"memory://bucket/b\.ply: could not be written \({error}\)"):
        st.write(scene, f"{bucket}/b.ply")


def test_an_object_that_shrinks_while_it_is_read_is_not_believed(bucket, scene, monkeypatch):
    st.write(scene, f"{bucket}/a.ply")
    read = sources._Fsspec.read
    monkeypatch.setattr(sources._Fsspec, "read", lambda self, url, begin, end, _: read(self, url, begin, end)[:-1])
    with pytest.raises(InputError, match=r"a\.ply: found [\d,]+ of [\d,]+ bytes from byte 0 on; the connection broke"):
        st.read(f"{bucket}/a.ply")


def test_folders_of_a_server_are_read_by_ranges(scene, tmp_path):
    st.write(scene, tmp_path / "sog" / "meta.json")
    with served(tmp_path) as server:
        check_are_equal(st.read(f"{server.address}/sog/meta.json"), st.read(tmp_path / "sog"))
        assert len(server.sent) > 5 and len(server.opened) == 1


@pytest.mark.parametrize(
    ("handler", "message"),
    [
        (Unsaid, r"found '\*' as its size, wanted a number"),
        (Sizeless, "found '' as its size, wanted a number"),
        (Shifted, r"answers with the range 'bytes 70-7\d+/\d+', wanted"),
    ],
)
def test_servers_that_do_not_say_what_they_give_are_refused_where_ranges_are_needed(scene, tmp_path, handler, message):
    st.write(scene, tmp_path / "sog" / "meta.json")
    st.write(scene, tmp_path / "a.ply")
    with served(tmp_path, handler) as server:
        with pytest.raises(InputError, match=rf"^{server.address}/sog/meta.json: .*{message}"):
            st.read(f"{server.address}/sog/meta.json")
        check_are_equal(st.read(f"{server.address}/a.ply"), st.read(tmp_path / "a.ply"))
        assert stored_bytes(Path(f"{server.address}/a.ply")) == 0  # it does not say


def test_what_is_no_address_is_told():
    with pytest.raises(InputError, match=r"https://\[::1/a.ply: found an address that is none"):
        st.read("https://[::1/a.ply")


@pytest.mark.parametrize("handler, place", [(Closing, ""), (Leading, "/old"), (Proxy, "")])
def test_servers_that_close_lead_on_or_stand_between_are_read(scene, tmp_path, monkeypatch, handler, place):
    st.write(scene, tmp_path / "sog" / "meta.json")
    with served(tmp_path, handler) as server:
        address = server.address
        if handler is Proxy:
            monkeypatch.setenv("http_proxy", address.replace("//", "//u:p@"))
            http.close_connections()  # and proxies are looked up
            address = "http://elsewhere.invalid"
        check_are_equal(st.read(f"{address}{place}/sog/meta.json"), st.read(tmp_path / "sog"))
        assert len(server.opened) == (len(server.sent) if handler is Closing else 1)


def test_a_connection_that_waited_long_or_has_too_many_beside_it_is_closed(tmp_path, monkeypatch):
    (tmp_path / "a.bin").write_bytes(bytes(range(100)))
    with served(tmp_path) as server:
        url = f"{server.address}/a.bin"

        def read(_):
            return sources.source_of(url).read(url, 10, 90)

        with ThreadPoolExecutor(8) as pool:
            assert set(pool.map(read, range(64))) == {bytes(range(10, 90))}
        assert len(server.opened) <= 8
        before = len(server.opened)
        read(0)
        assert len(server.opened) == before
        monkeypatch.setattr(http, "IDLE_S", 0.0)
        read(0)
        assert len(server.opened) == before + 1
        monkeypatch.setattr(http, "IDLE_S", 20.0)
        monkeypatch.setattr(http, "MOST_IDLE", 0)
        read(0)  # over the one that waits, which then is closed
        read(0)
        assert len(server.opened) == before + 2


def test_an_error_of_a_server_leaves_the_connection_open(tmp_path):
    with served(tmp_path, Refusing) as server:
        for _ in range(3):
            assert not located(f"{server.address}/gone.ply").exists()
        assert len(server.opened) == 1


def test_servers_without_ranges_or_bytes_are_refused(scene, tmp_path, capsys):
    from http.server import SimpleHTTPRequestHandler

    class Whole(SimpleHTTPRequestHandler):
        sent: list

        def log_message(self, *_):
            pass

    path = tmp_path / "a.splatree"
    st.write(scene, path)
    (tmp_path / "empty.splatree").write_bytes(b"")
    with served(tmp_path, Whole) as server:
        address = server.address
        with pytest.raises(
            InputError, match=r"a\.splatree: found a server that answers with the whole file \(status 200\)"
        ):
            st.open_store(f"{address}/a.splatree")
        assert len(st.read(f"{address}/a.splatree")) == len(scene)  # one file is fetched
    with (
        served(tmp_path, Cutting) as server,
        pytest.raises(InputError, match=r"a\.splatree: found 65,535 of 65,536 bytes from byte 0 on"),
    ):
        st.open_store(f"{server.address}/a.splatree")
    with served(tmp_path) as server:
        address = server.address
        with pytest.raises(FormatError, match="found a header of 0 bytes in a file of 0"):
            st.open_store(f"{address}/empty.splatree")
        with pytest.raises(InputError, match=r"gone\.splatree: cannot be read \(No such object\)"):
            st.open_store(f"{address}/gone.splatree")
        assert main(["render", f"{address}/gone.splatree", "-o", str(tmp_path / "x"), "--max-memory", "250M"]) == 1
        assert "gone.splatree: not found; wanted a scene" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"a\.splatree.*: cannot be fetched \(.*refused"):
        st.open_store(f"{address}/a.splatree")


def test_a_server_that_is_busy_or_breaks_off_is_asked_again(scene, tmp_path):
    st.write(scene, tmp_path / "sog" / "meta.json")
    st.write(scene, tmp_path / "a.ply")
    Busy.asked = 0
    with served(tmp_path, Busy) as server:
        check_are_equal(st.read(f"{server.address}/sog/meta.json"), st.read(tmp_path / "sog"))
    with served(tmp_path, Down) as server:
        for name in ("sog/meta.json", "a.ply"):
            server.sent.clear()
            with pytest.raises(InputError, match=rf"{name}: cannot be fetched \(status 503, Service Unavailable\)$"):
                st.read(f"{server.address}/{name}")
            assert len(server.sent) == 3


def test_an_object_that_is_replaced_while_it_is_read_is_not_mixed_with_the_one_before(scene, tmp_path, monkeypatch):
    path = tmp_path / "a.splatree"
    st.write(scene, path)
    camera = st.Camera.look_at([0, 0, -5], [0, 0, 0], width=32, height=24)
    for handler in (Stamped, Mirrored):
        monkeypatch.setattr(handler, "is_replaced", False)
        with served(tmp_path, handler) as server, st.open_store(f"{server.address}/a.splatree") as store:
            monkeypatch.setattr(
                handler, "is_replaced", True
            )  # the index is of the first state, what is drawn of the second
            if handler is Stamped:
                with pytest.raises(
                    InputError, match=r"a\.splatree: was replaced while it was read; read it again from "
                ):
                    st.render(store, camera)
            else:
                assert st.render(store, camera).image.tobytes() == st.render(st.read(path), camera).image.tobytes()


def test_what_says_nothing_of_a_state_does_not_tell_two_states_apart():
    def said(**stamps):
        return sources._said_of("https://a.example/b.ply", 206, {"Content-Range": "bytes 0-9/20", **stamps})

    now, then = "Tue, 01 Dec 2026 12:00:00 GMT", "Tue, 01 Dec 2026 12:00:09 GMT"
    assert said(ETag='"a"').is_of(said(ETag='W/"a"')) and not said(ETag='"a"').is_of(said(ETag='W/"b"'))
    assert said(**{"Last-Modified": now, "Date": now}).is_of(said(**{"Last-Modified": then, "Date": then}))
    assert not said(**{"Last-Modified": now, "Date": then}).is_of(said(**{"Last-Modified": then, "Date": "later"}))


def test_an_object_that_is_shorter_by_now_was_replaced(scene, tmp_path):
    path = tmp_path / "a.splatree"
    st.write(scene, path)
    with served(tmp_path, Ranges) as server:
        url = f"{server.address}/a.splatree"
        known = sources.source_of(url).info(url)
        path.write_bytes(path.read_bytes()[:100])
        with pytest.raises(InputError, match=r"a\.splatree: was replaced while it was read"):
            sources.source_of(url).read(url, 200, 300, known)


def test_an_address_that_is_none_is_not_asked_again(monkeypatch):
    monkeypatch.setattr(http, "WAITS_S", ())
    with pytest.raises(InputError, match="cannot be fetched"):
        st.read("http://127.0.0.1:1/a b.ply")
    monkeypatch.setattr(http.time, "sleep", None)
    monkeypatch.setattr(http, "WAITS_S", (1.0,))
    with pytest.raises(http.InvalidURL):
        http.open_range("http://127.0.0.1:1/a b.ply", 0, 10)


def test_a_server_may_answer_as_it_likes_for_a_manifest_that_is_not_there(scene, tmp_path):
    path = tmp_path / "a.splatree"
    st.write(scene, path)
    with served(tmp_path, Forbidding) as server:
        assert (st.read(f"{server.address}/a.splatree").ids == scene.ids).all()
        with st.open_store(f"{server.address}/a.splatree") as store:
            assert store.index.num_rows == len(scene)
        with pytest.raises(InputError, match=r"/gone\.splatree: cannot be fetched \(status 403, Forbidden\)"):
            st.read(f"{server.address}/gone.splatree")


def test_errors_of_what_a_server_packs_name_the_address(scene, tmp_path):
    st.write(scene, tmp_path / "a.ply")
    with (
        served(tmp_path, Unpacked) as server,
        pytest.raises(FormatError, match=rf"^{server.address}/a\.ply: not a whole"),
    ):
        st.read(f"{server.address}/a.ply")


def test_a_reason_is_one_line_that_no_terminal_obeys():
    assert http.reason_of(ValueError("a\x1b[2J\nsecond line")) == "a?[2J"
    assert http.reason_of(ValueError("")) == "ValueError"
