"""Cuts that are chosen by the quality that is asked for (lod/quality.py)."""

import json
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import splatree as st
from splatree.errors import InputError
from splatree.lod.quality import COARSEST_PX, FINEST_PX, WHOLE_BELOW, Gauge, pixel_error_for, sample_of
from splatree.lod.select import smallest_radius
from splatree.scene.view import View

from ..scenes import surface

POINT_PX = smallest_radius("exact")
CAMERA = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=240, height=160)


def levels(method: str = "radius", num: int = 600) -> st.Scene:
    return st.build_lod(st.Scene.flat(surface(num)), st.BuildOptions(method=method, max_roots=4))  # type: ignore[arg-type]


def shown(scene: st.Scene, pixel_error: float, camera: st.Camera = CAMERA):
    return np.clip(st.render(scene, camera, select=st.SelectOptions(pixel_error=pixel_error)).image, 0, 1)


@pytest.mark.parametrize("method", ["radius", "pairs"])
def test_the_cut_has_the_quality_that_was_asked_for(method):
    """The picture is small, so the search sees all of it. A surface seen at a slant: its PSNR falls evenly enough."""
    scene, camera = levels(method, 4000), st.Camera.look_at([1.5, -2.5, -2], [0, 0, 0], width=240, height=160)
    leaves = shown(scene, 0.0, camera)
    counts = []
    for quality in (32, 36, 40):
        chosen = st.select(scene, camera, st.SelectOptions(quality=quality))
        assert st.psnr(shown(scene, chosen.pixel_error, camera), leaves) == pytest.approx(quality, abs=1)
        counts.append(len(chosen))
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def falling(size_px: float) -> float:
    """A PSNR that falls by 3 dB from one size to the next that is tried, and faster above 8 px."""
    return 40 - 6 / math.log(2) * math.log(size_px / 4) - 4 * max(0.0, math.log(size_px / 8))


def size_of(pixel_error: float) -> float:
    return math.sqrt(pixel_error**2 - POINT_PX**2)


@pytest.mark.parametrize("last", [None, 0.01, 3.0, 9.0, 1e9, math.inf])
@pytest.mark.parametrize("quality", [25, 30, 38.7, 44, 52])
def test_the_search_finds_the_size_from_anywhere(quality, last):
    found = pixel_error_for(lambda tau: falling(size_of(tau)), quality, point_px=POINT_PX, last=last)
    assert falling(size_of(found)) == pytest.approx(quality, abs=0.2)


def test_the_search_from_a_view_nearby_is_shorter():
    tried = []

    def psnr_at(tau):
        tried.append(tau)
        return falling(size_of(tau))

    alone = pixel_error_for(psnr_at, 45, point_px=POINT_PX)
    num_alone = len(tried)
    assert num_alone > 1
    assert pixel_error_for(psnr_at, 45, point_px=POINT_PX, last=1.02 * alone) == pytest.approx(alone, rel=0.02)
    assert len(tried) == num_alone + 1


@pytest.mark.parametrize(("psnr", "found"), [(20.0, 0.0), (100.0, math.hypot(COARSEST_PX, POINT_PX))])
def test_where_no_cut_is_as_bad_or_as_good_the_ends_are_taken(psnr, found):
    assert pixel_error_for(lambda tau: psnr, 30, point_px=POINT_PX) == pytest.approx(found)


def falls_at(step, tau):
    return 100.0 if size_of(tau) < step else 20.0


def test_a_picture_that_gets_worse_at_once_is_searched_until_the_step_is_found():
    """One node makes all the difference at some size: the search ends below it, and does not go on for ever."""
    for step in (2.9, 3.0, 3.1):
        for quality in (30, 40, 95):
            found = pixel_error_for(partial(falls_at, step), quality, point_px=POINT_PX)
            assert 0.93 * step < size_of(found) < step


def test_what_was_measured_of_a_view_is_not_measured_again():
    drawn = []
    scene = levels()
    with st.open_session(scene) as session:

        def draw(view, select):
            drawn.append(select.pixel_error)
            return session.draw(view.camera, select=select).image

        gauge, view = Gauge(draw), View(CAMERA)
        wanted = st.SelectOptions(quality=36, profile="exact")
        first = gauge.settled(wanted, view, point_px=POINT_PX)
        num_first = len(drawn)
        assert drawn[0] == 0 and num_first == len(set(drawn))
        assert gauge.settled(wanted, View(CAMERA), point_px=POINT_PX) == first
        assert len(drawn) == num_first
        gauge.settled(wanted, View(CAMERA.scaled(0.5)), point_px=POINT_PX)
        assert drawn[num_first] == 0


def test_the_sample_is_rows_of_tiles_of_the_picture():
    """Strips show what the picture shows there, but for splats that reach into them from far outside: these are projected as
    at the border (FRUSTUM_CLAMP)."""
    scene = levels(num=4000)
    large = CAMERA.scaled(4)
    strips = sample_of(View(large), np.ones(40, bool)).views
    assert -(-large.height // 16) >= WHOLE_BELOW
    assert len(strips) == 8
    picture = st.render(scene, large).image
    for strip in strips:
        top = round(large.K[1, 2] - strip.camera.K[1, 2])
        assert top % 16 == 0
        part = st.render(scene, strip.camera).image
        assert st.psnr(part, picture[top : top + 16]) > 45
    assert sample_of(View(CAMERA), np.ones(10, bool)).views[0].camera is CAMERA
    is_shown = np.zeros(40, bool)
    is_shown[[7, 8, 30]] = True
    few = sample_of(View(large), is_shown)
    assert [round(large.K[1, 2] - strip.camera.K[1, 2]) // 16 for strip in few.views] == [7, 8, 30]
    assert few.share == 3 / 40


@pytest.mark.parametrize("background", [0.0, 0.25])
@pytest.mark.parametrize("first", [352, 600, 1040])
def test_a_thing_between_the_rows_of_an_even_sample_is_measured(first, background):
    """40 rows of pixels of 1088 show a thing whose colours are wrong by τ_R / 1000; the rest is empty."""
    whole = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=1920, height=1088)
    drawn = []

    def draw(view, select):
        factor = whole.K[1, 1] / view.camera.K[1, 1]
        rows = (np.arange(view.camera.height) + 0.5 - view.camera.K[1, 2]) * factor + whole.K[1, 2]
        picture = np.full((view.camera.height, view.camera.width, 3), background, np.float32)
        picture[(rows >= first) & (rows < first + 40)] = 0.5 + select.pixel_error / 1000
        drawn.append(view.camera.height)
        return picture

    wanted, view = st.SelectOptions(quality=60), View(whole, background=(background,) * 3)
    found = Gauge(draw).settled(wanted, view, point_px=0.0).pixel_error
    assert -10 * math.log10((found / 1000) ** 2 * 40 / 1088) == pytest.approx(60, abs=0.2)
    assert set(drawn) == {68, 16}  # the thumbnail and strips, never the whole picture


def test_with_occlusion_whole_pictures_are_measured():
    """What hides a node of a strip may lie outside of the strip."""
    camera, drawn = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=1920, height=1088), []

    def draw(view, select):
        drawn.append(view.camera.height)
        return np.full((view.camera.height, view.camera.width, 3), select.pixel_error / 1000, np.float32)

    Gauge(draw).settled(st.SelectOptions(quality=48, occlusion=True), View(camera), point_px=0.0)
    assert set(drawn) == {1088}


def test_a_session_and_select_choose_the_same_cut():
    scene = levels("pairs")
    options = st.SelectOptions(quality=34)
    chosen = st.select(scene, CAMERA, options)
    with st.open_session(scene, select=options) as session:
        np.testing.assert_array_equal(session.select(CAMERA).rows, chosen.rows)
        image = st.render(scene, CAMERA, select=st.SelectOptions(pixel_error=chosen.pixel_error)).image
        np.testing.assert_array_equal(session.draw(CAMERA).image, image)


def test_a_session_forgets_what_it_measured_of_other_columns():
    scene = levels()
    with st.open_session(scene, select=st.SelectOptions(quality=34)) as session:
        before = session.select(CAMERA).pixel_error
        flat = np.zeros_like(scene.gaussians.sh)
        session.update({"sh": flat})
        anew = replace(scene, gaussians=replace(scene.gaussians, sh=flat))
        assert session.select(CAMERA).pixel_error == st.select(anew, CAMERA, st.SelectOptions(quality=34)).pixel_error
        assert session.select(CAMERA).pixel_error != before


def test_a_budget_goes_before_a_quality():
    scene = levels()
    free = st.select(scene, CAMERA, st.SelectOptions(quality=40))
    assert len(free) > 60
    bound = st.select(scene, CAMERA, st.SelectOptions(quality=40, budget=60))
    assert len(bound) <= 60


def test_a_scene_without_levels_is_drawn_whole():
    flat = st.Scene.flat(surface(600))
    assert len(st.select(flat, CAMERA, st.SelectOptions(quality=40))) == len(
        st.select(flat, CAMERA, st.SelectOptions(pixel_error=0))
    )


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"quality": 0}, "quality: found 0"),
        ({"quality": 40, "pixel_error": 2.0}, "beside pixel_error 2.0"),
        ({"quality": 40, "rule": "release"}, "found rule 'release'"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, found):
    with pytest.raises(InputError, match=found):
        st.SelectOptions(**options)


def test_records_of_older_files_with_a_curve_are_read():
    record = levels().tree.record
    fields = json.loads(record.to_json())
    assert st.LevelRecord.from_json(json.dumps({**fields, "quality": {"offset": 30.0}})) == record
    assert FINEST_PX < COARSEST_PX
