"""The server of streams: what it answers, and what it does not."""

import gzip
import http.client
import os
import socket
import threading
from urllib.parse import parse_qs, quote, urlsplit

import numpy as np
import pytest

import splatree as st
from splatree.stream.serve import StreamServer, streams_in

from ..scenes import random_gaussians
from .conftest import forest


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("served")
    st.stream(forest(200, seed=1), path / "city", options=st.StreamOptions(levels=2))
    st.stream(forest(200, seed=1), path / "city.rad", "rad")
    (path / "secret.txt").write_text("secret")
    (path.parent / "outside.json").write_text("{}")
    (path / "link.json").symlink_to(path.parent / "outside.json")
    return path


@pytest.fixture(scope="module")
def server(folder):
    server = st.serve(folder, st.ServeOptions(port=0))
    yield server
    server.stop()


def ask(server, path, method="GET", **headers):
    parts = urlsplit(server.address)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=10)
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, headers=sent)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}, body


def test_files_are_served_whole_and_by_ranges(server, folder):
    data = (folder / "city.rad").read_bytes()
    size = len(data)
    status, headers, body = ask(server, "/city.rad")
    assert (status, body) == (200, data)
    assert headers["accept-ranges"] == "bytes"
    for text, begin, end in (("0-0", 0, 1), ("5-9", 5, 10), (f"{size - 3}-", size - 3, size), ("-4", size - 4, size)):
        status, headers, body = ask(server, "/city.rad", Range=f"bytes={text}", Origin="https://example.org")
        assert (status, body) == (206, data[begin:end]), text
        assert headers["content-range"] == f"bytes {begin}-{end - 1}/{size}"
        assert headers["access-control-allow-origin"] == "*"
    status, headers, _ = ask(server, "/city.rad", Range=f"bytes={size}-")
    assert status == 416 and headers["content-range"].endswith(f"*/{size}")
    assert ask(server, "/city.rad", Range="bytes=9-5")[0] in (400, 416)
    status, headers, body = ask(server, "/city.rad", "HEAD")
    assert (status, body, headers["content-length"]) == (200, b"", str(size))


def test_units_are_kept_for_ever_and_manifests_are_asked_for_again(server, folder):
    unit = next((folder / "city").glob("0_0-*/meta.json")).relative_to(folder)
    status, headers, _ = ask(server, f"/{unit}")
    assert status == 200 and "immutable" in headers["cache-control"]
    assert headers["content-type"].startswith("application/json")
    status, headers, _ = ask(server, "/city/lod-meta.json")
    assert headers["cache-control"] == "no-cache"
    status, _, body = ask(server, "/city/lod-meta.json", If_None_Match=headers["etag"])
    assert (status, body) == (304, b"")


def test_manifests_are_packed_for_whoever_takes_that(server, folder):
    data = (folder / "city" / "lod-meta.json").read_bytes()
    for method in ("GET", "HEAD"):
        status, headers, body = ask(server, "/city/lod-meta.json", method, Accept_Encoding="br, gzip;q=0.8")
        assert (status, headers["content-encoding"]) == (200, "gzip")
        assert "accept-encoding" in headers["vary"].lower()
        assert int(headers["content-length"]) < len(data)
        assert method == "HEAD" or gzip.decompress(body) == data
    assert ask(server, "/city/lod-meta.json", Accept_Encoding="gzip", If_None_Match=headers["etag"])[0] == 304
    for more in ({"Accept_Encoding": "gzip;q=0"}, {"Accept_Encoding": "br"}, {"If_None_Match": headers["etag"]}):
        status, plain, body = ask(server, "/city/lod-meta.json", **more)
        assert (status, body) == (200, data) and "content-encoding" not in plain
        assert plain["etag"] != headers["etag"] and "accept-encoding" in plain["vary"].lower()
    status, _, body = ask(server, "/city/lod-meta.json", Accept_Encoding="gzip", Range="bytes=0-9")
    assert (status, body) == (206, data[:10])
    _, headers, body = ask(server, "/city.rad", Accept_Encoding="gzip")
    assert "content-encoding" not in headers and body == (folder / "city.rad").read_bytes()


def test_names_in_any_script_and_many_ranges_are_served(folder, tmp_path):
    name = "Straße 都市.rad"
    data = (folder / "city.rad").read_bytes()
    (tmp_path / name).write_bytes(data)
    with st.serve(tmp_path, st.ServeOptions(port=0)) as server:
        path = f"/{quote(name)}"
        assert ask(server, path)[2] == data
        assert quote(name) in ask(server, "/")[2].decode()
        status, headers, body = ask(server, path, Range="bytes=0-3,8-9")
        assert status == 206 and headers["content-type"].startswith("multipart/byteranges")
        assert data[:4] in body and data[8:10] in body and len(body) < 400
        status, _, body = ask(server, path, Range="bytes=" + ",".join(["0-"] * 3000))
        assert len(body) == len(data)  # ranges that overlap are sent once


def test_a_range_of_a_file_that_has_changed_is_the_whole_file(folder, tmp_path):
    """A page goes on with the file that it began with, or begins again (If-Range)."""
    path = tmp_path / "city.rad"
    data = (folder / "city.rad").read_bytes()
    path.write_bytes(data)
    with st.serve(tmp_path, st.ServeOptions(port=0)) as server:
        tag = ask(server, "/city.rad")[1]["etag"]
        assert ask(server, "/city.rad", Range="bytes=0-9", If_Range=tag)[0] == 206
        path.write_bytes(data[::-1] + b"0")
        status, headers, body = ask(server, "/city.rad", Range="bytes=0-9", If_Range=tag)
        assert (status, body) == (200, data[::-1] + b"0") and headers["etag"] != tag


def test_other_sites_may_ask_before_they_fetch(server):
    asked = {"Origin": "https://example.org", "Access_Control_Request_Method": "GET"}
    asked |= {"Access_Control_Request_Headers": "range", "Access_Control_Request_Private_Network": "true"}
    status, headers, _ = ask(server, "/city.rad", "OPTIONS", **asked)
    assert (status, headers["access-control-allow-origin"]) == (200, "*")
    assert "range" in headers["access-control-allow-headers"]
    assert headers["access-control-allow-private-network"] == "true"
    assert ask(server, "/city.rad", "POST")[0] == 405


def test_idle_connections_hold_nobody_up(server):
    parts = urlsplit(server.address)
    idle = [socket.create_connection((parts.hostname, parts.port), timeout=10) for _ in range(200)]
    idle[0].sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n")  # and never more
    try:
        assert ask(server, "/")[0] == 200
    finally:
        for connection in idle:
            connection.close()


def test_the_address_lists_what_there_is(server):
    status, _, body = ask(server, "/")
    assert status == 200
    assert b'href="open/playcanvas?stream=city/lod-meta.json"' in body and b'href="open/spark?stream=city.rad"' in body
    for viewer, package in (("playcanvas", b"/playcanvas@2."), ("spark", b"/spark@2."), ("cesium", b"/cesium@1.")):
        status, headers, body = ask(server, f"/open/{viewer}")
        assert status == 200 and package in body and b"{{" not in body
        status, headers, _ = ask(server, f"/page/{viewer}.js")
        assert status == 200 and headers["content-type"].startswith("text/javascript")


@pytest.mark.parametrize("stream", ["city/lod-meta.json", "city.rad"])
def test_a_page_opens_with_the_first_view_of_its_stream(server, stream):
    status, headers, _ = ask(server, f"/open/spark?stream={stream}&budget=5")
    assert status == 307
    query = parse_qs(urlsplit(headers["location"]).query)
    assert query["stream"] == [stream] and query["budget"] == ["5"] and query["turn"] == ["1"]
    assert query["mode"] == ["classic"]
    eye, target = (np.array(query[name][0].split(","), float) for name in ("pos", "target"))
    assert 0.5 < np.linalg.norm(eye - target) < 50  # of a scene of a few units
    assert ask(server, f"/open/spark{headers['location']}")[0] == 200


@pytest.mark.parametrize(
    ("asked", "mode", "others"),
    [
        ("pos=0,0,-4", "antialiased", {"pos": ["0,0,-4"]}),  # the camera is its own, the mode that of the stream
        ("mode=classic", "classic", {}),
        ("mode=classic&fov=30", "classic", {"fov": ["30"]}),
        ("pos=0,0,-4&mode=classic", None, {}),
    ],
)
def test_an_address_says_how_its_stream_is_drawn_and_what_is_asked_for_stays(tmp_path, asked, mode, others):
    scene = st.Scene.flat(random_gaussians(50, seed=1), mode="antialiased")
    st.stream(st.build_lod(scene, st.BuildOptions("radius")), tmp_path / "a.rad", "rad")
    with st.serve(tmp_path, st.ServeOptions(port=0)) as server:
        status, headers, _ = ask(server, f"/open/spark?stream=a.rad&{asked}")
        assert status == (200 if mode is None else 307)
        if mode is not None:
            query = parse_qs(urlsplit(headers["location"]).query)
            assert query["mode"] == [mode] and query | others == query
            assert ask(server, f"/open/spark{headers['location']}")[0] == 200


def test_a_stream_that_cannot_be_read_here_still_has_a_page(folder, tmp_path):
    (tmp_path / "lod-meta.json").write_text("{}")
    with st.serve(tmp_path, st.ServeOptions(port=0)) as server:
        assert ask(server, "/open/playcanvas?stream=lod-meta.json")[0] == 200
        assert ask(server, "/open/playcanvas?stream=../city.rad")[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        "/secret.txt",
        "/link.json",
        "/../outside.json",
        "/..%2foutside.json",
        "/city/../../outside.json",
        "/city/%2e%2e/%2e%2e/outside.json",
        "//etc/passwd",
        "/city",
        "/city/",
        "/nothing.json",
        "/a%00.json",
        "/open/evil",
        "/page/../serve.py",
        "/page/serve.py",
        "/packages/three/build/three.module.js",
    ],
)
def test_nothing_else_is_served(server, path):
    assert ask(server, path)[0] == 404


@pytest.mark.parametrize("path", [f"/{'a' * 300}.rad", f"/{'a/' * 3000}x.rad"], ids=["name", "path"])
def test_paths_that_are_too_long_are_not_found(server, path):
    assert ask(server, path)[0] == 404


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_only_files_inside_of_the_folder_are_streams(folder, tmp_path):
    data = (folder / "city.rad").read_bytes()
    (tmp_path / "outside.rad").write_bytes(data)
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "dir.rad").mkdir()
    os.mkfifo(inside / "pipe.rad")  # who opens it would wait
    for name, target in (("link", tmp_path / "outside.rad"), ("loop", "loop.rad"), ("lost", tmp_path / "none.rad")):
        (inside / f"{name}.rad").symlink_to(target)
    with pytest.raises(st.InputError, match="links out of it not counted"):
        st.serve(inside, st.ServeOptions(port=0))
    (inside / "city.rad").write_bytes(data)
    (inside / "same.rad").symlink_to("city.rad")
    with st.serve(inside, st.ServeOptions(port=0)) as server:
        assert server.streams == ("city.rad", "same.rad")
        for name in ("dir", "pipe", "link", "loop", "lost"):
            assert ask(server, f"/{name}.rad")[0] == 404
            assert ask(server, f"/open/spark?stream={name}.rad")[0] == 200
        assert ask(server, "/same.rad")[2] == data
        (inside / "city.rad").unlink()
        assert ask(server, "/city.rad")[0] == 404
        assert ask(server, "/open/spark?stream=city.rad")[0] == 200


def test_other_names_of_this_machine_are_refused(server):
    """A site that lets a name of its own point here would read what the server has."""
    assert ask(server, "/city.rad", Host="evil.example")[0] == 403
    assert ask(server, "/city.rad", Host="localhost:1234")[0] == 200


def test_a_server_for_others_wants_the_token_of_its_address(folder):
    server = st.serve(folder, st.ServeOptions(host="0.0.0.0", port=0))
    try:
        token = urlsplit(server.address).path.strip("/")
        assert len(token) >= 20
        assert ask(server, f"/{token}/city.rad", Host="anything")[0] == 200
        for path in ("/", "/city.rad", f"/{token[:-1]}/city.rad", "/open/spark"):
            assert ask(server, path)[0] == 404
    finally:
        server.stop()


def test_nothing_but_loopback_is_listened_on_by_default(server):
    assert urlsplit(server.address).hostname == "127.0.0.1"
    assert server._http._socket.getsockname()[0] == "127.0.0.1"


def test_packages_come_from_a_folder_where_one_is_named(folder, tmp_path):
    (tmp_path / "three" / "build").mkdir(parents=True)
    (tmp_path / "three" / "build" / "three.module.js").write_text("export {}")
    server = st.serve(folder, st.ServeOptions(port=0, packages=str(tmp_path)))
    try:
        assert ask(server, "/packages/three/build/three.module.js")[2] == b"export {}"
        assert b'"/packages/three/build/three.module.js"' in ask(server, "/open/spark")[2]
    finally:
        server.stop()


def test_a_client_that_stops_reading_harms_nobody(server):
    parts = urlsplit(server.address)
    idle = socket.create_connection((parts.hostname, parts.port))
    idle.sendall(b"GET /city.rad HTTP/1.1\r\nHost: localhost\r\n\r\n")
    answers = []
    threads = [threading.Thread(target=lambda: answers.append(ask(server, "/city.rad")[0])) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    idle.close()
    assert answers == [200] * 8


def test_what_cannot_be_served_is_refused(folder, tmp_path, server):
    with pytest.raises(st.InputError, match="none: not found; wanted a folder"):
        StreamServer(tmp_path / "none", st.ServeOptions(port=0))
    for name, wanted in (
        ("city.rad", f"splatree serve {tmp_path}"),
        ("city.ply", "splatree stream .*city.ply city_stream"),
    ):
        (tmp_path / name).touch()
        with pytest.raises(st.InputError, match=f"{name}: is a file, wanted .*{wanted}"):
            StreamServer(tmp_path / name, st.ServeOptions(port=0))
    (tmp_path / "city.rad").unlink()
    with pytest.raises(st.InputError, match=r"found no lod-meta\.json, tileset\.json or \.rad in it"):
        StreamServer(tmp_path, st.ServeOptions(port=0))
    with pytest.raises(st.InputError, match="packages: found none"):
        StreamServer(folder, st.ServeOptions(port=0, packages="none"))
    port = urlsplit(server.address).port
    with pytest.raises(st.OutputError, match="cannot be listened on"):
        StreamServer(folder, st.ServeOptions(port=port))


def test_streams_are_found_one_folder_deep(folder):
    assert list(streams_in(folder)) == ["city.rad", "city/lod-meta.json"]


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(st.InputError, match=f"port: found {port}, wanted 0 to 65535"):
        st.ServeOptions(port=port)
