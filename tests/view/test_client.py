"""The worker of a page, without a network."""

import io
import json
import struct
import threading
import time

import numpy as np
import pytest
from PIL import Image

from splatree.clusters.build import build_clusters
from splatree.errors import InputError
from splatree.lod.select import count_nested, select
from splatree.render.moving import guarded_by
from splatree.render.pipeline import render
from splatree.scene.cameras import Camera
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.view import client as module
from splatree.view import pace, slots
from splatree.view.client import Client
from splatree.view.exhibit import Exhibit, exhibit
from splatree.view.messages import parse

from .scenes import gaussians, on_show, scene


class FakePage:
    """Keeps what is sent, and acknowledges it unless it has stopped reading."""

    def __init__(self, shown=None, capacity=1 << 16, reads=True):
        self.exhibit = shown or on_show()
        self.messages, self.reads, self.taken = [], reads, 0
        self.arrived = threading.Condition()
        self.client = Client(self.exhibit, self.send, capacity)
        self.failed = None
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        try:
            self.client.run()
        except TimeoutError as error:
            self.failed = error

    def send(self, data):
        (length,) = struct.unpack("<I", data[:4])
        header, payload = json.loads(data[4 : 4 + length]), data[4 + length :]
        with self.arrived:
            self.messages.append((header, payload))
            self.arrived.notify_all()
        if header["kind"] in ("cut", "frame") and self.reads:
            self.taken += 1
            self.client.receive(json.dumps({"ack": self.taken}))

    def wait_for(self, kind, seq=None):
        def found():
            return next(
                (m for m in self.messages if m[0]["kind"] == kind and (seq is None or m[0].get("seq") == seq)
                 and m[0].get("last", True)),
                None,
            )  # fmt: skip

        with self.arrived:
            assert self.arrived.wait_for(lambda: found() is not None, 20), [m[0] for m in self.messages]
        return found()

    def ask(self, camera=None, **more):
        camera = camera or self.exhibit.framing.camera(160, 90)
        pose = np.linalg.inv(camera.camera_from_world)
        pose[:3, 3] -= self.exhibit.centre
        view = {"want": "cut", "seq": 1, "c2w": pose[:3].ravel().tolist(), "f": camera.K[0, 0], "w": camera.width}
        view |= {"h": camera.height, "near": camera.near, "tau": 1.0, "budget": 1000}
        self.client.receive(json.dumps({**view, **more}))

    def close(self):
        self.client.close()
        self.thread.join(10)
        assert not self.thread.is_alive()


@pytest.fixture
def page():
    made = FakePage()
    yield made
    made.close()


def test_a_page_is_told_of_the_scene_first(page):
    facts, _ = page.wait_for("scene")
    assert facts["leaves"] == 2000
    assert facts["degree"] == 3
    assert len(facts["eye"]) == 3
    assert 0.2 < facts["aspect"] < 3


def test_a_cut_is_one_of_the_tree_and_fits_the_budget(page):
    page.ask(tau=0.0)
    header, payload = page.wait_for("cut", 1)
    assert header["rows"] <= 1000
    assert header["add"] * 36 == len(payload)
    assert count_nested(page.exhibit.scene.tree, page.client._slots.rows) == 0


def test_a_cut_without_a_limit_is_that_of_select(page):
    camera = page.exhibit.framing.camera(160, 90)
    page.ask(camera, tau=4.0, budget=50_000)
    page.wait_for("cut", 1)
    expected = select(page.exhibit.scene, camera, SelectOptions(pixel_error=4.0))
    np.testing.assert_array_equal(page.client._slots.rows, expected.rows)


def test_a_cut_of_a_quality_is_that_of_select():
    page = FakePage()
    camera = page.exhibit.framing.camera(160, 90)
    page.ask(camera, db=38, budget=50_000)
    header, _ = page.wait_for("cut", 1)
    expected = select(page.exhibit.scene, camera, SelectOptions(budget=50_000, quality=38))
    assert 0.25 < expected.pixel_error < 32
    assert header["tau"] == expected.pixel_error
    np.testing.assert_array_equal(page.client._slots.rows, expected.rows)
    page.ask(camera, db=38, budget=50_000, want="frame", seq=2, packing="png")
    picture, _ = page.wait_for("frame", 2)
    assert picture["rows"] > 0
    page.close()


def test_a_cut_with_occlusion_is_that_of_select_and_its_picture_that_of_the_cut(page):
    camera = page.exhibit.framing.camera(160, 90)
    page.ask(camera, tau=0.0, budget=1200, occlusion=True, guard=0.1)
    header, _ = page.wait_for("cut", 1)
    guarded = guarded_by(camera, 0.1)
    expected = select(page.exhibit.scene, guarded, SelectOptions(0.0, 1200, occlusion=True))
    np.testing.assert_array_equal(page.client._slots.rows, expected.rows)
    assert not np.array_equal(expected.rows, select(page.exhibit.scene, guarded, SelectOptions(0.0, 1200)).rows)
    page.ask(camera, want="frame", held=True, packing="png", seq=2, tau=0.0, budget=1 << 16)
    found, data = page.wait_for("frame", 2)
    assert (found["rows"], found["tau"]) == (header["rows"], header["tau"])
    chosen = render(page.exhibit.scene, camera, select=lambda view, *, threads=0: expected)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))), np.rint(255 * np.clip(chosen.image, 0, 1)))


def test_a_picture_of_a_cut_that_is_forgotten_is_not_sent(page):
    page.ask(want="frame", held=True)
    page.ask(want="frame", seq=2)
    page.wait_for("frame", 2)
    assert [header["seq"] for header, _ in page.messages if header["kind"] == "frame"] == [2]


def test_a_first_cut_comes_in_steps(monkeypatch):
    monkeypatch.setattr(module, "LADDER", (1000, 1500))
    page = FakePage()
    page.ask(tau=0.0, budget=3000)
    page.wait_for("cut", 1)
    page.close()
    sizes = [header["rows"] for header, _ in page.messages if header["kind"] == "cut"]
    assert len(sizes) == 3
    assert sizes[0] <= 1000 < sizes[1] <= 1500 < sizes[2] <= 3000
    assert [header["last"] for header, _ in page.messages if header["kind"] == "cut"] == [False, False, True]


def sizes_of(page):
    return [header["rows"] for header, _ in page.messages if header["kind"] == "cut"]


def looking(page, side):
    """A view of the left or the right end of the cloud alone."""
    camera = page.exhibit.framing.camera(160, 90)
    middle = page.exhibit.centre + side * page.exhibit.framing.radius * camera.camera_from_world[0, :3]
    return Camera.look_at(camera.position, middle, fov_y_deg=12, width=160, height=90)


def test_over_a_slow_line_a_cut_comes_in_more_steps_each_of_what_the_line_carries(monkeypatch):
    monkeypatch.setattr(module, "LADDER", (800,))
    page = FakePage()
    page.client._pace._rate = 300 * module.NODE_BYTES / pace.STEP_S  # 300 nodes a step
    page.ask(tau=0.0, budget=2500)
    page.wait_for("cut", 1)
    page.close()
    sizes = sizes_of(page)
    assert len(sizes) > 6 and sizes == sorted(sizes) and 1800 < sizes[-1] <= 2500
    added = [header["add"] for header, _ in page.messages if header["kind"] == "cut"]
    assert max(added[1:]) <= 2 * 300
    assert [header["last"] for header, _ in page.messages if header["kind"] == "cut"] == (len(sizes) - 1) * [False] + [
        True
    ]


def test_over_a_slow_line_another_view_begins_with_fewer_nodes(monkeypatch):
    monkeypatch.setattr(module, "LADDER", (100,))
    page = FakePage()
    page.ask(looking(page, -0.5), tau=0.0, budget=2500)
    first, _ = page.wait_for("cut", 1)
    page.client._pace._rate = 20 * module.NODE_BYTES / pace.STEP_S
    num_before = len(sizes_of(page))
    page.ask(looking(page, 0.5), tau=0.0, budget=2500, seq=2)
    last, _ = page.wait_for("cut", 2)
    page.close()
    sizes = sizes_of(page)[num_before:]
    assert sizes[0] <= 100 < 0.8 * last["rows"] and sizes[-1] == last["rows"]
    expected = select(page.exhibit.scene, looking(page, 0.5), SelectOptions(pixel_error=0.0))
    np.testing.assert_array_equal(page.client._slots.rows, expected.rows)
    assert first["rows"] > 100


def test_over_a_slow_line_new_nodes_come_before_what_has_changed_of_others_and_not_twice_in_turn(monkeypatch):
    for name in ("LONG_STEP", "LONGEST_STEP"):
        monkeypatch.setattr(module, name, 1e9)  # a view comes in one message
    shown, sent = on_show(), []
    client = Client(
        shown, lambda data: sent.append(json.loads(data[4 : 4 + struct.unpack("<I", data[:4])[0]])), 1 << 16
    )
    framing, page, away = shown.framing, FakePage(shown), shown.framing.eye - shown.framing.target
    page.close()
    eyes = [(1.0, 0.0), (0.5, 0.5), (0.25, 1.0)]
    requests = []
    monkeypatch.setattr(page.client, "receive", lambda text: requests.append(parse(text, shown.centre)))
    for seq, (share, side) in enumerate(eyes):
        eye = framing.target + share * away + side * np.cross(framing.up, away)
        page.ask(Camera.look_at(eye, framing.target, up=framing.up, width=160, height=90), tau=0.0, seq=seq)
    for request in requests:
        client._cut(request)
        client._pace._rate = 20 * module.NODE_BYTES / pace.STEP_S
    changes = [(header["add"] > 20, header["shape"] + header["tint"] > 0, header["last"]) for header in sent]
    assert changes == [(True, False, True), (True, False, False), (True, True, True)]


def test_over_a_slow_line_what_the_page_holds_of_another_view_is_kept(monkeypatch):
    monkeypatch.setattr(module, "LADDER", (50,))
    page = FakePage()
    page.ask(looking(page, -0.1), tau=0.0, budget=2500)
    page.wait_for("cut", 1)
    before = page.client._slots.rows
    page.client._pace._rate = 10 * module.NODE_BYTES / pace.STEP_S
    held = []
    move = page.client._slots.move

    def moved(rows, *args, **more):
        held.append(rows)
        return move(rows, *args, **more)

    page.client._slots.move = moved
    num_messages = len(page.messages)
    page.ask(looking(page, 0.1), tau=0.0, budget=2500, seq=2)
    page.wait_for("cut", 2)
    page.close()
    expected = select(page.exhibit.scene, looking(page, 0.1), SelectOptions(pixel_error=0.0)).rows
    kept, new = np.intersect1d(before, expected), np.setdiff1d(expected, before)
    assert len(kept) > 2 * len(new) > 150
    assert len(held) > 5 and np.array_equal(held[-1], expected)
    for rows in held:
        assert count_nested(page.exhibit.scene.tree, rows) == 0
    assert min(len(np.intersect1d(rows, kept)) for rows in held) > 0.25 * len(kept)
    added = sum(header["add"] for header, _ in page.messages[num_messages:] if header["kind"] == "cut")
    assert len(new) <= added < len(expected)  # beginning anew sends all of them, and what is coarser


def test_over_a_slow_line_the_middle_of_a_picture_becomes_fine_first():
    camera = Camera.look_at(np.zeros(3), np.array([0, 0, 5.0]), width=100, height=100)
    means = np.float32([[3, 0, 5], [0, 0, 5], [0, -1, 5], [0, 0, -5]])
    assert np.argsort(module._off_axis(camera, means)).tolist() == [1, 2, 0, 3]


def test_over_a_slow_line_an_exact_picture_is_a_jpeg(page):
    page.ask(want="frame", packing="png", quality=95)
    assert page.wait_for("frame", 1)[0]["type"] == "image/png"
    page.client._pace._rate = 160 * 90 * module.PNG_BYTES / pace.STEP_S / 2
    page.ask(want="frame", packing="png", quality=95, seq=2)
    assert page.wait_for("frame", 2)[0]["type"] == "image/jpeg"


def test_a_view_is_taken_when_it_can_be_answered(monkeypatch):
    """While a message is on its way, cameras move on: the next answer is of the newest, and none is chosen in vain."""
    page = FakePage(reads=False)
    page.ask(seq=1)
    page.wait_for("cut", 1)
    for seq in range(2, 50):
        page.ask(seq=seq)
    time.sleep(0.05)
    assert len(sizes_of(page)) == 1
    page.client.receive('{"ack": 1}')
    page.wait_for("cut", 49)
    assert len(sizes_of(page)) == 2
    page.client.receive('{"ack": 2}')
    page.close()


def test_of_a_thousand_views_only_the_newest_are_answered(page):
    page.wait_for("scene")
    with page.exhibit.session._turns.working():  # the worker waits here, while views come in
        for seq in range(1, 1001):
            page.ask(seq=seq)
        time.sleep(0.02)
    page.wait_for("cut", 1000)
    assert sum(header["kind"] == "cut" for header, _ in page.messages) <= 3


def test_a_page_that_stops_reading_is_given_up_and_others_go_on(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE_S", 0.3)
    stuck = FakePage(reads=False)
    for seq in range(1, 6):
        stuck.ask(seq=seq)
        time.sleep(0.03)
    stuck.thread.join(20)
    assert isinstance(stuck.failed, TimeoutError)
    assert sum(header["kind"] == "cut" for header, _ in stuck.messages) <= 1  # how fast it reads is not known
    other = FakePage()
    other.ask(seq=9)
    other.wait_for("cut", 9)
    other.close()


def test_a_picture_is_that_of_render(page):

    camera = page.exhibit.framing.camera(160, 90)
    page.ask(camera, want="frame", packing="png", tau=2.0, budget=50_000, background=[0, 0, 0])
    header, payload = page.wait_for("frame", 1)
    found = np.asarray(Image.open(io.BytesIO(payload)))
    image = render(page.exhibit.scene, camera, select=SelectOptions(pixel_error=2.0)).image
    # The camera goes through JSON and back: the last bits of its pose may differ.
    assert np.abs(found.astype(int) - np.rint(255 * np.clip(image, 0, 1))).max() <= 1
    assert (header["width"], header["height"], header["type"]) == (160, 90, "image/png")


def test_a_picture_of_a_moving_camera_keeps_the_cut(page):

    camera = page.exhibit.framing.camera(160, 90)
    visited = []
    for seq in (1, 2):
        page.ask(camera, want="frame", packing="png", tau=2.0, budget=50_000, moving=True, seq=seq)
        header, payload = page.wait_for("frame", seq)
        visited.append(header["rows"])
    assert visited[0] == visited[1] > len(select(page.exhibit.scene, camera, SelectOptions(pixel_error=2.0)))
    found = np.asarray(Image.open(io.BytesIO(payload))) / 255
    image = render(page.exhibit.scene, camera, select=SelectOptions(pixel_error=2.0)).image
    assert np.abs(found - np.clip(image, 0, 1)).max() < 3 / 255  # the last 1/255 of the light is not drawn, and 8 bits
    page.ask(camera, want="frame", packing="png", tau=2.0, budget=50_000, moving=True, layer="depth", seq=3)
    assert page.wait_for("frame", 3)[0]["rows"] < visited[0]  # a depth is that of an exact picture


@pytest.mark.parametrize("layer", ["depth", "alpha"])
def test_depth_and_alpha_are_pictures_too(page, layer):
    page.ask(want="frame", layer=layer, quality=90)
    header, payload = page.wait_for("frame", 1)
    assert header["type"] == "image/jpeg"
    assert payload[:2] == b"\xff\xd8"


def test_a_box_hides_what_lies_outside(page):
    camera = page.exhibit.framing.camera(160, 90)
    _, chosen = page.exhibit.draw(
        camera, SelectOptions(pixel_error=0.0), (0, 0, 0), box=np.array([[-0.5] * 3, [0.5] * 3])
    )
    inside = page.exhibit.scene.gaussians.means[chosen.rows]
    assert len(inside) > 0
    assert np.abs(inside).max() <= 0.5


def test_the_point_behind_a_pixel_is_on_its_ray(page):
    camera = Camera.look_at([0, 0, -6], [0, 0, 0], width=160, height=90)
    page.ask(camera, want="point", at=[90.0, 40.0], tau=0.0, budget=50_000)
    header, _ = page.wait_for("point")
    x, y, z = np.array(header["point"]) + page.exhibit.centre - [0, 0, -6]
    u, v = camera.K[0, 0] * x / z + 80, camera.K[1, 1] * y / z + 45
    assert (u, v) == (pytest.approx(90, abs=1e-3), pytest.approx(40, abs=1e-3))
    assert 3 < z < 9


@pytest.mark.parametrize("kind", ["blocks", "chunks", "clusters"])
def test_boxes_hold_the_nodes_of_the_cut(kind):
    made = build_clusters(scene(), 30)
    page = FakePage(exhibit(made, framing=on_show().framing))
    page.ask(tau=0.0, budget=50_000)
    page.wait_for("cut", 1)
    page.ask(want="boxes", boxes=kind, seq=2)
    header, payload = page.wait_for("boxes", 2)
    boxes = np.frombuffer(payload, "<f4").reshape(-1, 2, 3) + page.exhibit.centre
    assert header["count"] == len(boxes) > 0
    means = page.exhibit.scene.gaussians.means[page.client._slots.rows]
    held = ((means[:, None] >= boxes[:, 0] - 1e-4) & (means[:, None] <= boxes[:, 1] + 1e-4)).all(-1).any(-1)
    assert held.all()
    page.close()


def test_a_scene_without_clusters_has_no_boxes_of_them(page):
    page.ask(want="boxes", boxes="clusters", seq=2)
    assert page.wait_for("boxes", 2)[0]["count"] == 0


def test_a_step_that_the_roots_do_not_fit_is_left_out(monkeypatch):
    monkeypatch.setattr(module, "LADDER", (1000, 1500))
    page = FakePage(exhibit(Scene.flat(gaussians(2000)), framing=on_show().framing))
    page.ask(tau=0.0, budget=3000)
    assert page.wait_for("cut", 1)[0]["rows"] > 1500
    page.close()
    assert sum(header["kind"] == "cut" for header, _ in page.messages) == 1


def test_another_scene_begins_anew(page):
    page.ask()
    page.wait_for("cut", 1)
    page.client.show(on_show(degree=0))
    with page.arrived:
        assert page.arrived.wait_for(lambda: sum(h["kind"] == "scene" for h, _ in page.messages) == 2, 20)
    page.ask(seq=2)
    header, _ = page.wait_for("cut", 2)
    assert header["add"] == header["rows"]


def test_an_error_is_told_and_the_page_lives_on(page, monkeypatch):
    def refuse(*_):
        raise InputError("budget: found too many roots")

    monkeypatch.setattr(module.Exhibit, "cut", refuse)
    page.ask(seq=1)
    header, _ = page.wait_for("error", 1)
    assert header["text"] == "budget: found too many roots"
    monkeypatch.undo()
    page.ask(seq=2)
    page.wait_for("cut", 2)


def test_a_guard_adds_the_same_to_all_sides():
    camera = Camera.look_at([0, 0, -6], [0, 0, 0], width=200, height=100)
    wide = guarded_by(camera, 0.1)
    assert (wide.width, wide.height, wide.K[0, 2], wide.K[1, 2]) == (240, 120, 120, 60)
    assert wide.K[0, 0] == camera.K[0, 0]
    assert guarded_by(camera, 0.0) is camera


def test_the_rest_of_the_colours_comes_without_another_selection(page, monkeypatch):
    monkeypatch.setattr(slots, "TINTS", 100)
    chosen = []
    monkeypatch.setattr(Exhibit, "cut", lambda self, *more, cut=Exhibit.cut: chosen.append(1) or cut(self, *more))
    framing = page.exhibit.framing
    page.ask(framing.camera(160, 90), budget=50_000)
    page.wait_for("cut", 1)
    offset = np.cross(framing.up, framing.eye - framing.target)  # a quarter round
    camera = Camera.look_at(framing.target + offset, framing.target, up=framing.up, width=160, height=90)
    with page.arrived:
        page.messages.clear()
    chosen.clear()
    page.ask(camera, budget=50_000, seq=2)
    page.wait_for("cut", 2)
    headers = [header for header, _ in page.messages if header["kind"] == "cut"]
    assert len(headers) > 2 and len(chosen) == 1
    assert [header["add"] + header["drop"] for header in headers[1:]] == [0] * (len(headers) - 1)
    assert all(header["rows"] == headers[0]["rows"] for header in headers)
    assert all(header["tint"] == 100 for header in headers[:-1])


@pytest.mark.parametrize("column", ["means", "quats", "log_scales", "logit_opacities", "sh"])
def test_a_scene_of_the_program_that_is_not_finite_is_refused_by_its_row(column):
    shown = gaussians(20, 1)
    getattr(shown, column)[3] = np.nan
    with pytest.raises(InputError, match=rf"{column}\[3\]: found .*nan"):
        exhibit(Scene.flat(shown))


@pytest.mark.parametrize("case", ["one", "all in one place", "a million from the origin"])
def test_odd_scenes_are_shown(case):
    shown = gaussians(1 if case == "one" else 30, 1)
    if case == "all in one place":
        shown.means[:] = shown.means[0]
    if case == "a million from the origin":
        shown.means[:] += np.float32([1e6, -1e6, 1e6])
    odd = FakePage(exhibit(Scene.flat(shown)))
    odd.ask()
    assert odd.wait_for("cut", 1)[0]["rows"] == len(shown)
    odd.ask(want="frame", seq=2)
    assert odd.wait_for("frame", 2)[0]["rows"] == len(shown)
    odd.ask(want="point", at=[80, 45], seq=3)
    odd.wait_for("point", 3)
    odd.close()
