"""A scene on disk is shown as the scene in memory: message by message, bit for bit."""

import json

import numpy as np
import pytest

import splatree as st
from splatree.io.pages import table as pages
from splatree.view.exhibit import exhibit
from splatree.view.shown import InMemory, OnDisk
from splatree.view.slots import Slots

from .scenes import gaussians
from .test_client import FakePage

PATH = [(2.5, 0.2), (2.4, 0.25), (1.0, 0.4), (0.5, 0.9), (0.5, 0.9)]


@pytest.fixture(scope="module", params=["file", "folder"])
def stored(request, tmp_path_factory):
    """A scene on disk of many pages; in a file its merged nodes follow the pixel."""
    path = tmp_path_factory.mktemp("shown") / "in.ply"
    st.write(st.Scene.flat(gaussians(3000)), path)
    out = path.with_name("out.splatree")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "PAGE_BYTES", 20_000)
        if request.param == "folder":
            st.build_folder(path, out, st.BuildOptions(radius=0.05, max_roots=4), st.FolderOptions(part_rows=500))
        else:
            st.write(st.build_lod(st.read(path), st.BuildOptions(method="pairs")), out)
        with st.open_store(out, max_memory="200k") as store:
            assert len(store.index.table) > 20
            yield store, st.read(out)


def asked(framing, want, seq, distance, height, **more):
    """A request of a page that looks at the scene from a distance."""
    eye = np.array([distance * 3, -height * 3, 0.3])
    camera = st.Camera.look_at(eye, np.zeros(3), up=(0, -1, 0), width=160, height=90, fov_y_deg=50)
    pose = np.linalg.inv(camera.camera_from_world)[:3]
    record = {"want": want, "seq": seq, "c2w": pose.ravel().tolist(), "w": 160, "h": 90, "f": float(camera.K[0, 0])}
    return json.dumps({**record, "tau": 3.0, "budget": 5000, "packing": "png", **more})


def answers(shown, **more):
    """What a page gets that moves along the path."""
    page = FakePage(shown)
    for seq, (distance, height) in enumerate(PATH):
        for want in ("cut", "frame", "point"):
            page.client.receive(asked(shown.framing, want, seq, distance, height, **more))
            page.wait_for(want, seq)
    page.client.close()
    # Times differ, how many rows were looked at, the window, which follows from a sample, and what stores do not offer.
    drops = {"occlusion", "select_ms", "pack_ms", "draw_ms", "encode_ms", "measured", "visited", "aspect"}
    return [({k: v for k, v in head.items() if k not in drops}, payload) for head, payload in page.messages]


@pytest.mark.parametrize("more", [{}, {"box": [-0.5, -0.5, -0.5, 0.5, 0.5, 0.5]}])
def test_a_page_gets_the_messages_of_the_scene_in_memory(stored, more):
    store, scene = stored
    framing = st.frame_scene(scene)
    found, wanted = (answers(exhibit(each, framing=framing), **more) for each in (store, scene))
    assert len(found) == len(wanted)
    for (head, payload), (wanted_head, wanted_payload) in zip(found, wanted, strict=True):
        assert head == wanted_head
        assert payload == wanted_payload


def test_a_store_is_not_shown_with_occlusion(stored):
    store, scene = stored
    assert not exhibit(store).facts["occlusion"] and exhibit(scene).facts["occlusion"]
    for scenes in ({"scene": store}, {"scene": scene, "beside": store}):
        with pytest.raises(st.InputError, match=r"^occlusion: found \w+ read page by page, wanted a scene in memory"):
            st.view(**scenes, options=st.ViewOptions(occlusion=True), block=False)


def test_nodes_of_any_rows_are_packed_alike(stored):
    store, scene = stored
    rng, eye = np.random.default_rng(1), np.array([2.0, -1.0, 0.5])
    on_disk, in_memory = (Slots(shown, np.zeros(3), 4096) for shown in (OnDisk(store), InMemory(scene)))
    view = st.open_session(scene).view(
        st.Camera.look_at(eye, np.zeros(3), up=(0, -1, 0), width=160, height=90, fov_y_deg=50)
    )
    for count in (0, 1, 700, 300):
        rows = np.sort(rng.choice(len(scene), count, replace=False)).astype(np.int32)
        assert on_disk.move(rows, eye, view).payload == in_memory.move(rows, eye, view).payload
        eye = eye + 0.3


def test_boxes_are_those_of_pages(stored):
    store, scene = stored
    rows = np.arange(0, len(scene), 50, dtype=np.int32)
    shown = OnDisk(store)
    boxes = shown.boxes("blocks", rows, 1000)
    means = scene.gaussians.means[rows]
    assert all(((means[i] >= boxes[:, 0]) & (means[i] <= boxes[:, 1])).all(axis=1).any() for i in range(len(rows)))
    assert len(shown.boxes("clusters", rows, 1000)) == 0


def test_a_quality_is_that_of_the_scene_in_memory(stored):
    store, scene = stored
    on_disk, in_memory = exhibit(store), exhibit(scene)
    wanted = st.SelectOptions(quality=35)
    view = st.Camera.look_at((3, -2, 1), (0, 0, 0), up=(0, -1, 0), width=160, height=90, fov_y_deg=50)
    assert np.array_equal(on_disk.cut(view, wanted, None).rows, in_memory.cut(view, wanted, None).rows)


def test_a_store_is_shown_and_is_served(stored):
    with st.view(stored[0], block=False) as viewer:
        assert viewer.num_nodes == len(stored[1])
