from dataclasses import replace

import numpy as np
import pytest

from splatree import InputError, PathOptions, SelectOptions, orbit, trace
from splatree.render.session import Session
from splatree.render.timing import time_frames
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(3)
    columns = (rng.normal(size=(50, 3)), rng.normal(size=(50, 4)), np.full((50, 3), -2.0), np.zeros(50))
    sh = rng.normal(size=(50, 1, 3))
    return Scene.flat(Gaussians(*(column.astype(np.float32) for column in (*columns, sh))))


def test_few_cameras_are_timed_along_a_path_through_them(scene):
    cameras = list(orbit(scene, PathOptions(views=3, width=48, height=32)))
    timing = time_frames(scene, cameras, views=7, warm_up=1)
    assert timing.num_frames == 7
    assert set(timing.ms) == {"select", "project", "bin", "blend"}
    assert timing.frame_ms >= sum(timing.ms.values())  # the stages are within the frame
    assert timing.frame_cpu_ms == pytest.approx(sum(timing.cpu_ms.values()))


def test_enough_cameras_are_timed_themselves(scene):
    cameras = list(orbit(scene, PathOptions(views=4, width=48, height=32)))
    options = SelectOptions(view_test="none")
    timing = time_frames(scene, cameras, select=options, views=3, warm_up=0)
    frames = [trace(scene, camera, select=options).result.counters for camera in cameras]
    assert timing.num_frames == 4
    assert timing.num_pairs == np.mean([counters.num_pairs for counters in frames])
    assert timing.num_selected == 50


def test_a_selector_takes_the_place_of_options(scene):
    camera = orbit(scene, PathOptions(views=1, width=48, height=32))[0]
    seen = trace(scene, camera).selection

    def first_ten(view, *, threads=0):
        return type(seen)(seen.rows[:10], "first ten", None, 0.0)

    assert trace(scene, camera, select=first_ten).result.counters.num_selected == 10


def test_culling_is_part_of_the_selection(scene, monkeypatch):
    camera = orbit(scene, PathOptions(views=1, width=48, height=32))[0]
    took = {"cull": 4.0, "select": 1.0, "project": 2.0, "bin": 3.0, "blend": 5.0}

    drawn = Session.draw

    def timed(*words, **named):
        return replace(drawn(*words, **named), milliseconds=took, cpu_milliseconds=took)

    monkeypatch.setattr(Session, "draw", timed)
    timing = time_frames(scene, [camera], views=1, warm_up=0)
    assert timing.filter_ms == timing.ms["select"] == 5
    assert timing.frame_cpu_ms == sum(took.values())


def test_nothing_to_time_is_refused(scene):
    with pytest.raises(InputError, match="found 0 views"):
        time_frames(scene, [], views=0)
