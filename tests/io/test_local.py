"""Inputs from elsewhere: addresses, standard input, compressed files; and their limits."""

import errno
import gzip
import io
import json
import sys
import threading
import time
import zipfile
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import pytest

import splatree as st
from splatree import FormatError, InputError, Scene
from splatree.io import copying, download, http, local
from splatree.io.registry import stored_bytes

from ..scenes import random_gaussians
from .conftest import same_bits

GAUSSIANS = random_gaussians(20, degree=0)


@pytest.fixture
def ply(tmp_path):
    st.write(Scene.flat(GAUSSIANS), tmp_path / "a.ply")
    return tmp_path / "a.ply"


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


class _Odd(BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(302)
        self.send_header("Location", "ftp://127.0.0.1/a.ply")
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture
def serve():
    servers = []

    def start(handler):
        server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        servers.append(server)
        return f"http://127.0.0.1:{server.server_port}"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def test_an_address_is_read_and_named(serve, ply, tmp_path):
    address = serve(partial(_Quiet, directory=str(tmp_path))) + "/a.ply"
    for named in (address, Path(address)):  # a path loses a slash
        scene = st.read(named)
        assert same_bits(scene.gaussians.means, GAUSSIANS.means) and scene.source.paths == (address,)
    assert st.convert(address, tmp_path / "b.ply").num_read == 20
    (tmp_path / "c.ply.gz").write_bytes(gzip.compress(ply.read_bytes()))
    assert len(st.read(address.replace("a.ply", "c.ply.gz"))) == 20
    assert stored_bytes(Path(address)) == ply.stat().st_size  # though the server gives no ranges
    with pytest.raises(InputError, match=r"gone.ply: cannot be fetched \(.*[Nn]ot [Ff]ound"):
        st.read(address.replace("a.ply", "gone.ply"))


def test_addresses_of_other_kinds_are_refused_by_name(serve, tmp_path):
    with pytest.raises(
        InputError, match=r"^gopher://example\.org/a\.ply: found an address of gopher, wanted https, file, or"
    ):
        st.read("gopher://example.org/a.ply")
    with pytest.raises(InputError, match=r"cannot be fetched|leads to"):
        st.read(serve(_Odd) + "/a.ply")


class _Broken(BaseHTTPRequestHandler):
    """Says that a chunk of 1000 bytes comes, and sends 10; or answers with no HTTP at all."""

    def do_GET(self):
        if self.path == "/none.ply":
            self.connection.sendall(b"hello\r\n\r\n")
            return
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        self.wfile.write(b"3e8\r\n0123456789")

    def log_message(self, *_):
        pass


@pytest.mark.parametrize("name", ["chunk.ply", "none.ply"])
def test_a_connection_that_breaks_off_within_a_chunk_is_told(serve, name):
    with pytest.raises(InputError, match=rf"^http://127.0.0.1:\d+/{name}: cannot be fetched \("):
        st.read(f"{serve(_Broken)}/{name}")


class _Breaking(BaseHTTPRequestHandler):
    """Closes each connection after some bytes of what it has announced."""

    data = b""
    most = 700
    """Bytes that a connection gets."""
    says = "bytes {begin}-{last}/{size}"
    stamps = ({"ETag": "one", "Last-Modified": "today"},) * 100
    """What its answers say of the state, in their order."""
    says_more: ClassVar[dict[str, str]] = {}
    """What ranges say besides."""
    gives_ranges = True
    is_silent = False
    """Whether it leaves connections open that get no more."""
    begins: list[int]

    def do_GET(self):
        asked = self.headers["Range"] if self.gives_ranges else None
        begin = int(asked.removeprefix("bytes=").rstrip("-")) if asked else 0
        self.send_response(206 if asked else 200)
        for name, stamp in self.stamps[len(self.begins)].items():
            self.send_header(name, stamp)
        self.begins.append(begin)
        if asked:
            says = self.says.format(begin=begin, last=len(self.data) - 1, size=len(self.data))
            self.send_header("Content-Range", says)
            for name, said in self.says_more.items():
                self.send_header(name, said)
        self.send_header("Content-Length", str(len(self.data) - begin))
        self.end_headers()
        self.wfile.write(self.data[begin : begin + self.most])
        if self.is_silent and begin + self.most < len(self.data):
            time.sleep(5)

    def log_message(self, *_):
        pass


@pytest.fixture
def breaking(serve, ply, monkeypatch):
    monkeypatch.setattr(http, "WAITS_S", (0.0, 0.0))
    monkeypatch.setattr(download, "ENOUGH_BYTES", 500)

    def start(**changed):
        begins = []
        handler = type("Breaking", (_Breaking,), {"data": ply.read_bytes(), "begins": begins, **changed})
        return serve(handler) + "/a.ply", begins

    return start


def test_a_download_goes_on_where_the_connection_broke_off(breaking, ply):
    address, begins = breaking()
    assert same_bits(st.read(address).gaussians.means, GAUSSIANS.means)
    assert begins == list(range(0, ply.stat().st_size, 700)) and len(begins) > 2


def test_a_download_goes_on_where_the_connection_fell_silent(breaking, ply, monkeypatch):
    monkeypatch.setattr(http, "TIMEOUT_S", 1.0)
    monkeypatch.setattr(copying, "_PIECE", 100)  # what came of a piece that never ends is lost
    address, begins = breaking(is_silent=True)
    assert same_bits(st.read(address).gaussians.means, GAUSSIANS.means)
    assert sorted(set(begins)) == list(range(0, ply.stat().st_size, 700))


@pytest.mark.parametrize(
    ("changed", "asked"),
    [
        ({"stamps": ({"ETag": "one"}, {"ETag": "two"})}, 2),  # replaced meanwhile
        ({"stamps": ({"ETag": "one", "Last-Modified": "today"}, {"ETag": "two", "Last-Modified": "today"})}, 2),
        ({"stamps": ({"ETag": "one"}, {})}, 2),
        ({"stamps": ({}, {})}, 1),  # nobody knows
        ({"stamps": ({"ETag": "W/one"}, {"ETag": "W/one"})}, 1),
        ({"says": "bytes {begin}-{last}/1"}, 2),
        ({"says": "bytes {begin}-{last}/*"}, 2),
        ({"says": "bytes 0-{last}/{size}"}, 2),
        ({"says_more": {"Content-Encoding": "gzip"}}, 2),
        ({"gives_ranges": False}, 2),
        ({"most": 0}, 3),
        ({"most": 400}, 3),  # less than is worth asking for
    ],
)
def test_a_download_does_not_go_on_with_other_bytes_or_without_end(breaking, changed, asked):
    address, begins = breaking(**changed)
    with pytest.raises(InputError, match=r"a.ply: found [\d,]+ of \d,\d+ bytes; the connection broke off, try again"):
        st.read(address)
    assert len(begins) == asked


def test_errors_name_what_the_user_named(serve, ply, tmp_path):
    ply.write_bytes(b"<!DOCTYPE html><html></html>")
    address = serve(partial(_Quiet, directory=str(tmp_path))) + "/a.ply"
    with pytest.raises(InputError, match=rf"^{address}: is a web page"):
        st.read(address)
    (tmp_path / "c.ply.gz").write_bytes(gzip.compress(b"ply\nformat ascii 1.0\n"))
    with pytest.raises(FormatError, match=rf"^{tmp_path}/c.ply.gz: found no end_header"):
        st.read(tmp_path / "c.ply.gz")


def test_a_server_cannot_send_without_end(serve, ply, tmp_path, monkeypatch):
    monkeypatch.setattr(download, "TAKEN_MAX", 1000)
    with pytest.raises(InputError, match=r"found 1,\d\d\d bytes, wanted at most 1,000"):
        st.read(serve(partial(_Quiet, directory=str(tmp_path))) + "/a.ply")


@pytest.mark.parametrize("suffix", ["ply", "spz"])
def test_standard_input_is_read(ply, tmp_path, monkeypatch, suffix):
    st.convert(ply, tmp_path / f"b.{suffix}")
    data = (tmp_path / f"b.{suffix}").read_bytes()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    scene = st.read("-")
    assert len(scene) == 20 and scene.source.paths == ("-",)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"hello")))
    with pytest.raises(InputError, match=r"wanted a \.ply or an \.spz"):
        st.read("-")


def test_gz_and_a_zip_of_one_file_are_read(ply, tmp_path):
    (tmp_path / "b.ply.gz").write_bytes(gzip.compress(ply.read_bytes()))
    with zipfile.ZipFile(tmp_path / "c.zip", "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("__MACOSX/._a.ply", b"litter")
        bundle.writestr("folder/a.ply", ply.read_bytes())
        bundle.writestr("folder/.DS_Store", b"litter")
    for name in ("b.ply.gz", "c.zip"):
        scene = st.read(tmp_path / name)
        assert same_bits(scene.gaussians.means, GAUSSIANS.means) and scene.source.paths == (str(tmp_path / name),)
        assert st.convert(tmp_path / name, tmp_path / f"{name}.spz").num_written == 20
    st.write(Scene.flat(GAUSSIANS), tmp_path / "d.sog")
    (tmp_path / "d.sog").rename(tmp_path / "d.zip")  # a bundle of its own
    assert len(st.read(tmp_path / "d.zip")) == 20


def packed(folder, path, prefix=""):
    """A ZIP of a folder, as file managers make it."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                bundle.write(file, prefix + file.relative_to(folder).as_posix())
        bundle.writestr(f"__MACOSX/{prefix}._meta.json", b"litter")
    return path


@pytest.mark.parametrize("prefix", ["", "scene/", "a/b/"])
@pytest.mark.parametrize("kind", ["sog", "stream", "tiles", "gltf", "training"])
def test_a_zip_of_a_folder_is_read_as_the_folder(ply, tmp_path, kind, prefix):
    folder, named = tmp_path / "made", tmp_path / "made"
    if kind == "sog":
        st.convert(ply, folder / "meta.json")
    elif kind == "stream":
        st.stream(st.read(ply), folder)
    elif kind == "tiles":
        st.stream(st.read(ply), folder, "3dtiles")
    elif kind == "gltf":
        glb, named = folder / "a.glb", folder / "a.gltf"
        folder.mkdir()
        st.convert(ply, glb)
        size = int.from_bytes(glb.read_bytes()[12:16], "little")
        content = json.loads(glb.read_bytes()[20 : 20 + size])
        content["buffers"][0]["uri"] = "a.bin"
        (folder / "a.bin").write_bytes(glb.read_bytes()[28 + size :])
        named.write_text(json.dumps(content))
        glb.unlink()
    else:
        for state in (7000, 30000):
            (folder / f"point_cloud/iteration_{state}").mkdir(parents=True)
            (folder / f"point_cloud/iteration_{state}/point_cloud.ply").write_bytes(ply.read_bytes())
        (folder / "cameras.json").write_text("[]")
        (folder / "input.ply").write_bytes(b"ply")
    wanted = st.read(named)
    for suffix in ("zip", "3tz") if kind == "tiles" else ("zip",):
        found = st.read(packed(folder, tmp_path / f"a.{suffix}", prefix))
        assert same_bits(found.gaussians.means, wanted.gaussians.means) and len(found) == 20
        assert found.source.paths == (str(tmp_path / f"a.{suffix}"),) or kind in ("training", "gltf")


def test_a_zip_of_several_folders_is_refused(ply, tmp_path):
    (tmp_path / "made").mkdir()
    for name in ("one", "two"):
        st.convert(ply, tmp_path / "made" / name / "meta.json")
    with pytest.raises(FormatError, match="wanted one scene file, or one folder of SOG"):
        st.read(packed(tmp_path / "made", tmp_path / "a.zip"))


def test_other_archives_are_refused(ply, tmp_path):
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as bundle:
        for name in ("a.ply", "b.ply"):
            bundle.writestr(name, ply.read_bytes())
    with pytest.raises(FormatError, match=r"found 2 files in it \(a.ply, b.ply\), wanted one"):
        st.read(tmp_path / "two.zip")
    (tmp_path / "cut.ply.gz").write_bytes(gzip.compress(ply.read_bytes())[:-20])
    with pytest.raises(FormatError, match=r"cut.ply.gz: not a whole \.gz"):
        st.read(tmp_path / "cut.ply.gz")
    (tmp_path / "no.zip").write_bytes(b"PK no zip")
    with pytest.raises(FormatError, match="not a whole ZIP"):
        st.read(tmp_path / "no.zip")


def test_a_few_bytes_cannot_become_many(tmp_path, monkeypatch):
    monkeypatch.setattr(local, "INFLATED_ALWAYS", 1 << 16)
    (tmp_path / "bomb.ply.gz").write_bytes(gzip.compress(bytes(1 << 22)))
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("a.ply", bytes(1 << 22))
    for name in ("bomb.ply.gz", "bomb.zip"):
        with pytest.raises(FormatError, match="decompression bomb"):
            st.read(tmp_path / name)


def write_states(folder, *names):
    folder.mkdir(exist_ok=True)
    for i, name in enumerate(names):
        st.write(Scene.flat(GAUSSIANS.take(slice(0, i + 1))), folder / name)


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        (("splat_30000.ply", "splat_7000.ply"), 0),
        (("splat_7000.ply", "splat_30000.ply", "splat_15000.ply"), 1),
        (("point_cloud_29999.ply", "point_cloud_6999.ply"), 0),
        (("export_5000.ply", "export_30000.ply"), 1),
        (("splat_2000.ply", "splat.ply", "splat_4000.ply"), 1),
        (("point_cloud_7000.ply", "point_cloud.ply"), 1),
    ],
)
def test_of_states_of_a_training_the_newest_is_taken_and_said(tmp_path, names, taken):
    write_states(tmp_path / "out", *names)
    scene = st.read(tmp_path / "out")
    assert len(scene) == taken + 1
    assert f"holds {len(names)} states of one training" in json.loads(scene.source.metadata["notes"])[0]
    done = st.convert(tmp_path / "out", tmp_path / "b.ply")
    assert done.num_read == taken + 1 and "states of one training" in done.notes[0]


def test_one_state_of_a_training_needs_no_note(tmp_path):
    for iteration in (30000, 7000):
        folder = tmp_path / "out" / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        write_states(folder, "point_cloud.ply")
        scene = st.read(tmp_path / "out")
        assert "iteration_30000" in scene.source.paths[0]
        assert ("notes" in scene.source.metadata) == (iteration == 7000)


def test_a_file_that_is_named_twice_is_said_and_read_twice(tmp_path):
    write_states(tmp_path, "a.ply", "b.ply")
    (tmp_path / "link.ply").symlink_to(tmp_path / "a.ply")
    scene = st.read([tmp_path / "a.ply", tmp_path / "link.ply", tmp_path / "b.ply"])
    assert len(scene) == 1 + 1 + 2
    said = [note for note in json.loads(scene.source.metadata["notes"]) if "is named" in note]
    assert said == [f"{tmp_path / 'a.ply'} is named 2 times: its Gaussians stand there as often"]


def test_a_path_that_leads_out_of_a_deleted_folder_is_read(tmp_path, monkeypatch):
    write_states(tmp_path, "a.ply")
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert len(st.read("../a.ply")) == 1


@pytest.mark.parametrize(
    "names",
    [
        ("chunk_9.ply", "chunk_10.ply", "chunk_11.ply"),
        ("city.ply", "city_2.ply", "city_3.ply"),
        ("splat_700.ply", "splat_1234.ply", "x.ply"),
    ],
)
def test_pieces_are_joined_and_counted(tmp_path, names):
    write_states(tmp_path / "out", *names)
    scene = st.read(tmp_path / "out")
    assert len(scene) == 6 and json.loads(scene.source.metadata["notes"]) == ["3 inputs were joined as one scene"]
    assert st.convert(tmp_path / "out", tmp_path / "b.ply").notes == ("3 inputs were joined as one scene",)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("tile_a_1000.ply", "tile_a_2000.ply"), "like states of one training.*or like pieces"),
        (("splat_7000.ply", "splat_30000.ply", "other.ply"), "name the files to read"),
        (("city.ply", "city.spz"), "one scene in two formats"),
        (("city.ply", "city (1).ply"), r"found city \(1\).ply beside city.ply, another version"),
        (("city - Copy.ply", "city.ply"), "another version"),
        (("city_thin.ply", "city.ply"), "another version"),
        (("city.ply", "City_2_edited.ply"), "another version"),
        (("city_lod0.ply", "city_lod1.ply"), "levels of detail"),
    ],
)
def test_what_may_be_states_or_pieces_is_asked_for(tmp_path, names, message):
    write_states(tmp_path / "out", *names)
    with pytest.raises(InputError, match=message):
        st.read(tmp_path / "out")
    assert len(st.read([tmp_path / "out" / name for name in names])) > len(names)  # named, so meant


class _Encoded(SimpleHTTPRequestHandler):
    """Gives files as gzip, asked or not, as stores do with objects that were put so."""

    encoding = "gzip"

    def do_GET(self):
        data = gzip.compress(Path(self.translate_path(self.path)).read_bytes())
        self.send_response(200)
        self.send_header("Content-Encoding", self.encoding)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_):
        pass


class _Brotli(_Encoded):
    encoding = "br"


def test_what_a_server_packs_on_the_way_is_unpacked(serve, ply, tmp_path):
    st.write(Scene.flat(GAUSSIANS), tmp_path / "b.splat")
    address = serve(partial(_Encoded, directory=str(tmp_path)))
    assert same_bits(st.read(f"{address}/a.ply").gaussians.means, GAUSSIANS.means)
    assert len(st.read(f"{address}/b.splat")) == 20
    with pytest.raises(InputError, match=r"a\.ply: found it encoded as br, wanted it plain or as gzip"):
        st.read(serve(partial(_Brotli, directory=str(tmp_path))) + "/a.ply")


@pytest.mark.parametrize(
    ("name", "what"), [("b.ply", "gzip"), ("b.splat", "gzip"), ("c.ply", "a ZIP"), ("c.spz", "a ZIP")]
)
def test_compressed_files_under_another_name_are_told(ply, tmp_path, name, what):
    if what == "gzip":
        (tmp_path / name).write_bytes(gzip.compress(ply.read_bytes()))
    else:
        with zipfile.ZipFile(tmp_path / name, "w") as bundle:
            bundle.write(ply, "a.ply")
    with pytest.raises(FormatError, match=rf"{name}: is (compressed by )?{what}, which its name does not say"):
        st.read(tmp_path / name)


def test_a_full_disk_is_not_a_damaged_input(ply, tmp_path, monkeypatch):
    (tmp_path / "c.ply.gz").write_bytes(gzip.compress(ply.read_bytes()))

    class Full(io.BytesIO):
        def write(self, _):
            raise OSError(errno.ENOSPC, "No space left on device")

    opened = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, mode="r", *rest: Full() if mode == "wb" else opened(self, mode, *rest)
    )
    with pytest.raises(
        InputError, match=r"c\.ply\.gz: cannot be kept in .* \(No space left on device\); let TMPDIR name"
    ):
        st.read(tmp_path / "c.ply.gz")


@pytest.mark.parametrize(
    ("inputs", "found"),
    [
        ("", "an empty path"),
        (None, "NoneType"),
        (3, "int"),
        (b"a.ply", "bytes"),
        (["a.ply", None], "NoneType"),
        (io.BytesIO(), "BytesIO"),
    ],
)
def test_what_is_no_path_is_refused_by_its_kind(tmp_path, inputs, found):
    to, drop = tmp_path / "b.splatree", st.CleanOptions(max_size=1.0)
    writers = (
        st.convert,
        st.build_folder,
        st.thin_file,
        st.cluster_file,
        lambda named, to: st.clean_file(named, to, drop),
    )
    for use in (st.read, st.check, *(partial(lambda write, named: write(named, to), write) for write in writers)):
        with pytest.raises(InputError, match=f"^inputs: found {found}, wanted a path"):
            use(inputs)
