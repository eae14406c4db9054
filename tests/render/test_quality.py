"""A quality along the way of a camera (render/quality.py)."""

import numpy as np
import pytest

import splatree as st
from splatree.render.quality import STEP, Carried

from ..scenes import surface


def moved(camera: st.Camera, forwards: float) -> st.Camera:
    pose = camera.camera_from_world.copy()
    pose[2, 3] -= forwards
    return st.Camera(pose, camera.K, camera.width, camera.height)


@pytest.fixture
def session():
    scene = st.build_lod(st.Scene.flat(surface(600)), st.BuildOptions("pairs", max_roots=4))
    with st.open_session(scene) as session:
        yield session


def test_a_quality_is_measured_again_where_the_camera_has_moved_far(session, monkeypatch):
    measured = []
    select = session.select

    def counted(camera, **words):
        measured.append(words["last"])
        return select(camera, **words)

    monkeypatch.setattr(session, "select", counted)
    camera = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=240, height=160)
    carried, wanted = Carried(session), st.SelectOptions(quality=36, budget=500)
    first = carried.settled(camera, wanted)
    assert (first.quality, first.budget) == (None, 500)
    assert first.pixel_error == select(camera, select=st.SelectOptions(quality=36)).pixel_error
    nearest = float(np.linalg.norm(session.scene.gaussians.means - camera.position, axis=1).min())
    assert carried.settled(moved(camera, 0.9 * STEP * nearest), wanted) == first
    assert carried.settled(camera, st.SelectOptions(quality=36, budget=300)).pixel_error == first.pixel_error
    assert measured == [None]
    carried.settled(moved(camera, 2.5), wanted)
    carried.settled(moved(camera, 2.5), st.SelectOptions(quality=30))
    assert measured[1] == first.pixel_error and len(measured) == 3


def test_without_a_quality_nothing_is_measured(session):
    by_size = st.SelectOptions(pixel_error=5.0)
    camera = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=240, height=160)
    assert Carried(session).settled(camera, by_size) is by_size
