"""The server over real sockets: what it answers, and whom it refuses."""

import json
import socket
import struct
import sys
import time
import urllib.error
import urllib.request
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from splatree.errors import InputError, OutputError
from splatree.scene.cameras import Camera, Cameras
from splatree.view import client as client_module
from splatree.view import connection
from splatree.view import server as module
from splatree.view.files import page_files
from splatree.view.options import ViewOptions
from splatree.view.viewer import Viewer, view

from .scenes import scene

VIEW = {"want": "cut", "seq": 1, "c2w": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, -6], "f": 100, "w": 160, "h": 90}
VIEW |= {"tau": 2, "budget": 2000}


@pytest.fixture(scope="module")
def viewer():
    camera = Camera.look_at([0, 0, -6], [0, 0, 0], width=160, height=90)
    named = Cameras(tuple(Camera(camera.camera_from_world, camera.K, 160, 90, name=name) for name in ("a", "b")))
    photos = {"b": np.full((90, 160, 3), 0.5, np.float32)}
    with Viewer(scene(), cameras=named, photos=photos) as made:
        yield made


def get(viewer, path, **headers):
    """Status, headers and body of an answer."""
    with socket.create_connection(("127.0.0.1", viewer.port)) as raw:
        lines = {"Host": f"127.0.0.1:{viewer.port}", "Connection": "close"} | {k.title(): v for k, v in headers.items()}
        text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        raw.sendall(f"GET {path} HTTP/1.1\r\n{text}\r\n".encode())
        data = b""
        while part := raw.recv(65_536):
            data += part
    head, _, body = data.partition(b"\r\n\r\n")
    first, *rest = head.decode().split("\r\n")
    return int(first.split()[1]), {line.split(": ")[0].lower(): line.split(": ", 1)[1] for line in rest}, body


def join(viewer, query="?scene=0", **headers):
    return connect(f"ws://127.0.0.1:{viewer.port}/ws{query}", additional_headers=headers, max_size=None)


def next_of(page, kind):
    """The next message of a kind: header and payload; what comes is acknowledged."""
    while True:
        data = page.recv(timeout=30)
        (length,) = struct.unpack("<I", data[:4])
        header = json.loads(data[4 : 4 + length])
        if header["kind"] == kind:
            return header, data[4 + length :]


def test_the_page_and_all_that_it_names_are_there(viewer):
    status, headers, body = get(viewer, "/")
    assert status == 200
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert b"http" not in body.replace(b"http-equiv", b"")  # nothing from another host
    for name, kind in (("main.js", "text/javascript"), ("style.css", "text/css"), ("icon.svg", "image/svg+xml")):
        status, headers, _ = get(viewer, f"/page/{name}")
        assert (status, headers["content-type"].split(";")[0]) == (200, kind)


def test_all_modules_that_are_imported_are_served():
    import re

    files = page_files()
    for name, (data, _) in files.items():
        for found in re.findall(r"(?:from|URL\()\s*'\./([\w.]+)'", data.decode()):
            assert found in files, f"{name} imports {found}"


@pytest.mark.parametrize(
    "path",
    [
        "/page/../server.py",
        "/page/..%2fserver.py",
        "/page/%2e%2e/%2e%2e/__init__.py",
        "//etc/passwd",
        "/page//etc/passwd",
        "/page/..%5cserver.py",
        "/page/main.js%00.css",
        "/page/",
        "/photo/-1",
        "/photo/99",
        "/photo/0",
        "/photo/1/../../../etc/passwd",
        "/favicon.ico",
        "/ws/../page",
    ],
)
def test_nothing_else_is_found(viewer, path):
    status, _, body = get(viewer, path)
    assert status == 404
    assert b"import" not in body


def test_cameras_and_photographs_are_listed(viewer):
    _, _, body = get(viewer, "/cameras.json")
    views = json.loads(body)
    assert [(view["name"], view["photo"]) for view in views] == [("a", False), ("b", True)]
    status, headers, body = get(viewer, "/photo/1")
    assert (status, headers["content-type"], body[:2]) == (200, "image/jpeg", b"\xff\xd8")


@pytest.mark.parametrize("host", ["localhost:1234", "127.0.0.1", "LOCALHOST", "[::1]:80"])
def test_names_of_this_machine_are_answered_whatever_the_port(viewer, host):
    assert get(viewer, "/", host=host)[0] == 200  # a tunnel of SSH has a port of its own


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:80", "", "[::1"])
def test_other_names_are_refused(viewer, host):
    assert get(viewer, "/", host=host)[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        raw_join(viewer, host)


def raw_join(viewer, host):
    """A WebSocket under another name, as DNS rebinding makes it."""
    raw = socket.create_connection(("127.0.0.1", viewer.port))
    raw.sendall(
        f"GET /ws HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    status = raw.recv(4096).split()[1]
    raw.close()
    assert status in (b"403", b"400")
    raise InvalidStatus(type("Response", (), {"status_code": 403})())


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://localhost"])
def test_pages_of_other_addresses_are_refused(viewer, origin):
    assert get(viewer, "/cameras.json", origin=origin)[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        join(viewer, Origin=origin)


def test_the_own_page_and_programs_may_connect(viewer):
    with join(viewer, Origin=f"http://127.0.0.1:{viewer.port}") as page:
        assert next_of(page, "scene")[0]["leaves"] == 2000
    with join(viewer) as page:
        assert next_of(page, "scene")[0]["leaves"] == 2000


def test_an_address_that_is_allowed_may_connect():
    with (
        Viewer(scene(), ViewOptions(allow_origin=("https://hub.example",))) as made,
        join(made, Origin="https://hub.example") as page,
    ):
        assert next_of(page, "scene")


def test_other_hosts_need_the_token():
    with Viewer(scene(), ViewOptions(host="0.0.0.0")) as made:
        assert "?token=" in made.url
        token = made.url.split("token=")[1]
        assert len(token) >= 20
        for path in ("/", "/cameras.json", "/?token=wrong", "/?token=", f"/?token={token[:-1]}"):
            assert get(made, path, host="machine.example")[0] == 403
        assert get(made, f"/?token={token}", host="machine.example")[0] == 200
        for query in ("", "?token=wrong"):
            with pytest.raises(InvalidStatus, match="403"):
                join(made, query)
        with join(made, f"?token={token}") as page:
            assert next_of(page, "scene")


def test_by_default_only_this_machine_can_connect(viewer):
    assert viewer._server._http._socket.getsockname()[0] == "127.0.0.1"
    assert "token" not in viewer.url


@pytest.mark.parametrize("query", ["?scene=7", "?scene=x", "?scene=-1", "?capacity=5", "?capacity=99999999999"])
def test_a_connection_to_what_is_not_there_is_refused(viewer, query):
    with pytest.raises(InvalidStatus, match="403"):
        join(viewer, query)


@pytest.mark.parametrize("text", ["{}", "nonsense", '{"want": "cut"}', "x" * 65_000])
def test_a_bad_message_closes_the_connection_with_a_reason(viewer, text):
    with join(viewer) as page:
        next_of(page, "scene")
        page.send(text)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                page.recv(timeout=30)
        assert closed.value.rcvd.code == 1008
        assert "message" in closed.value.rcvd.reason


@pytest.mark.parametrize("data", ["x" * 70_000, b"bytes"])
def test_what_is_too_long_or_no_text_closes_the_connection(viewer, data):
    with join(viewer) as page:
        next_of(page, "scene")
        page.send(data)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                page.recv(timeout=30)
        assert closed.value.rcvd.code in (1008, 1009)


def test_two_pages_have_cuts_of_their_own(viewer):
    with join(viewer) as one, join(viewer) as two:
        one.send(json.dumps({**VIEW, "budget": 1000, "tau": 0}))
        two.send(json.dumps({**VIEW, "seq": 2, "tau": 50}))
        first, second = next_of(one, "cut")[0], next_of(two, "cut")[0]
        assert (first["seq"], second["seq"]) == (1, 2)
        assert first["rows"] > second["rows"] > 0
        one.send('{"ack": 1}')


def test_there_are_at_most_sixteen_pages(viewer, monkeypatch):
    monkeypatch.setattr(module, "CLIENTS_MAX", 2)
    deadline = time.monotonic() + 10
    while viewer._server.clients() and time.monotonic() < deadline:
        time.sleep(0.02)  # those of other tests leave
    made = []
    with join(viewer) as one, join(viewer) as two:
        next_of(one, "scene"), next_of(two, "scene")
        monkeypatch.setattr(module, "Client", lambda *more: made.append(more))  # one that is refused costs nothing
        late = join(viewer)
        with late, pytest.raises(ConnectionClosed) as closed:
            late.recv(timeout=30)
        assert closed.value.rcvd.code == 1013 and made == []
        for page in (one, two):
            page.send(json.dumps(VIEW))
            assert next_of(page, "cut")


def test_a_page_that_stops_reading_harms_nobody(viewer):
    picture = {**VIEW, "tau": 0, "want": "frame", "packing": "png", "w": 640, "h": 360}
    with join(viewer) as stuck, join(viewer) as page:
        for seq in range(1, 30):
            stuck.send(json.dumps({**picture, "seq": seq}))
        for seq in range(1, 6):
            page.send(json.dumps({**VIEW, "seq": seq}))
            assert next_of(page, "cut")[0]["seq"] == seq
            page.send(json.dumps({"ack": seq}))


def test_a_page_that_says_nothing_is_let_go(viewer, monkeypatch):
    monkeypatch.setattr(connection, "IDLE_S", 0.2)
    with join(viewer) as page:
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                page.recv(timeout=30)
        assert closed.value.rcvd.code == 4000
        assert "idle" in closed.value.rcvd.reason


def test_another_scene_and_another_camera_reach_the_page(viewer):
    with join(viewer) as page:
        next_of(page, "scene")
        page.send(json.dumps(VIEW))
        next_of(page, "cut")
        page.send('{"ack": 1}')
        position = viewer.camera.position - viewer._server.exhibits[0].centre
        np.testing.assert_allclose(position, [0, 0, -6], atol=1e-9)
        viewer.camera = Camera.look_at([1, 2, -3], [0, 0, 0])
        look, _ = next_of(page, "look")
        np.testing.assert_allclose(
            np.array(look["c2w"])[[3, 7, 11]] + viewer._server.exhibits[0].centre, [1, 2, -3], atol=1e-9
        )
        viewer.set_scene(scene(degree=0))
        assert next_of(page, "scene")[0]["degree"] == 0
        viewer.set_scene(scene())
        assert next_of(page, "scene")[0]["degree"] == 3


def test_a_worker_that_fails_is_logged_and_closes_the_connection(viewer, monkeypatch, caplog):
    def fail(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(client_module.Client, "_cut", fail)
    with join(viewer) as page:
        next_of(page, "scene")
        page.send(json.dumps(VIEW))
        with pytest.raises(ConnectionClosed) as closed:
            page.recv(timeout=30)
    assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1011, "the server failed: a bug")
    assert "the worker of a page failed" in caplog.text


def test_there_is_no_scene_beside_the_first(viewer):
    with pytest.raises(InputError, match="found no scene beside"):
        viewer.set_scene(scene(), beside=True)


def test_a_notebook_shows_the_page_in_a_frame(viewer):
    assert f'<iframe src="{viewer.url}"' in viewer._repr_html_()


@pytest.mark.parametrize(("shell", "waits"), [({"kernel": object()}, False), ({}, True)])
def test_a_cell_of_a_notebook_does_not_wait(monkeypatch, shell, waits):
    """Its viewer is shown when the cell has ended; the terminal of IPython has no kernel and waits as any other."""
    ipython = SimpleNamespace(get_ipython=lambda: SimpleNamespace(**shell))
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    waited = []
    monkeypatch.setattr(Viewer, "wait", lambda self: waited.append(self))
    with view(scene(), open_browser=False) as shown:
        assert bool(waited) == waits
        assert waits or urllib.request.urlopen(shown.url).status == 200


def test_a_port_that_is_taken_is_an_error(viewer):
    with pytest.raises(OutputError, match=f"127.0.0.1:{viewer.port}: cannot be listened on"):
        Viewer(scene(), ViewOptions(port=viewer.port))


def test_a_closed_viewer_does_not_listen():
    made = Viewer(scene())
    made.close()
    with pytest.raises((ConnectionError, urllib.error.URLError)):
        urllib.request.urlopen(made.url, timeout=5)
