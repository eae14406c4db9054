"""The first picture of rooms, streets, objects and cities, whichever way their axes point and whatever flies around them."""

from dataclasses import replace
from functools import cache
from importlib.resources import as_file, files

import numpy as np
import pytest

import splatree as st
from splatree.edit.options import EditOptions
from splatree.errors import InputError
from splatree.maths.rotations import matrix_from_angles
from splatree.render.framing.survey import survey_of
from splatree.render.framing.upright import guess_up
from splatree.scene.scene import Source

from ..scenes import random_gaussians
from . import framing_scenes

scene_named = cache(lambda name: getattr(framing_scenes, name)())
UP = np.array([0.0, -1.0, 0.0])
"""The vertical of the scenes as they are made."""


@pytest.fixture(scope="module")
def small_scene():
    """The bundled piece of a city, less all but each 20th Gaussian."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        scene = st.read(path)
    return st.Scene.flat(scene.gaussians.take(np.arange(0, len(scene), 20)))


def degrees_between(a, b):
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1))))


def picture(scene, framing):
    return st.render(scene, framing.camera(160, 90), select=st.SelectOptions(pixel_error=0))


@pytest.mark.parametrize("name", ["room", "street", "garden"])
def test_what_surrounds_the_eye_is_looked_at_from_inside(name):
    scene = scene_named(name)
    framing = st.frame_scene(scene)
    assert framing.inside, framing.reasons
    result = picture(scene, framing)
    assert result.alpha.mean() > 0.95
    # Nothing hangs before the eye: what is seen is farther than a tenth of the scene's radius, but for a twentieth of the pixels.
    assert np.quantile(result.depth, 0.05) > 0.05 * framing.radius


@pytest.mark.parametrize("name", ["figure", "city"])
def test_what_stands_free_is_looked_at_from_outside_and_fits(name):
    scene = scene_named(name)
    framing = st.frame_scene(scene)
    assert not framing.inside, framing.reasons
    alpha = picture(scene, framing).alpha
    edge = np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
    assert edge.max() < 0.1
    ys, xs = np.nonzero(alpha > 0.5)
    assert max(np.ptp(ys) / 90, np.ptp(xs) / 160) > 0.7


@pytest.mark.parametrize("name", ["room", "street", "garden", "city"])
@pytest.mark.parametrize("degrees", [(0, 0, 0), (-90, 0, 0), (180, 0, 0), (25, 0, 10)])
def test_up_is_found_whichever_way_a_scene_is_turned(name, degrees):
    guess = guess_up(survey_of(st.edit(scene_named(name), EditOptions(rotate=degrees))))
    assert degrees_between(guess.up, matrix_from_angles(degrees) @ UP) < 3, guess


@pytest.mark.parametrize("degrees", [(0, 0, 0), (90, 0, 0), (-90, 0, 0), (180, 0, 0), (0, 0, 90), (25, 0, 10)])
def test_up_of_a_real_capture_is_found_whichever_way_it_is_turned(small_scene, degrees):
    guess = guess_up(survey_of(st.edit(small_scene, EditOptions(rotate=degrees))))
    assert degrees_between(guess.up, matrix_from_angles(degrees) @ UP) < 5, guess


def test_capture_from_the_air_is_seen_from_above(small_scene):
    framing = st.frame_scene(small_scene)
    assert not framing.inside
    assert (framing.eye - framing.centre) @ UP > 0.3 * framing.radius


def test_file_that_says_its_axis_is_believed():
    figure = scene_named("figure")
    for comment, up in (
        ("Vertical axis: z", (0, 0, 1)),
        ("vertical axis: Y", (0, -1, 0)),
        ("Up axis: -x", (-1, 0, 0)),
    ):
        said = replace(figure, source=Source(metadata={"comments": f'["Made by hand", "{comment}"]'}))
        assert degrees_between(guess_up(survey_of(said), said.source).up, up) < 15, comment


def test_up_of_a_thing_without_ground_is_as_is_custom():
    figure = st.edit(scene_named("figure"), EditOptions(rotate=(90, 0, 0)))
    assert guess_up(survey_of(figure)).up == pytest.approx(UP, abs=0.2)


def test_a_thing_with_its_feet_at_0_is_upright_whether_y_is_down_or_up():
    for degrees in ((0, 0, 0), (180, 0, 0)):
        figure = st.edit(scene_named("figure"), EditOptions(rotate=degrees))
        up = matrix_from_angles(degrees) @ UP
        assert guess_up(survey_of(figure)).up == pytest.approx(up, abs=0.2)


def test_axes_of_an_spz_count_only_where_it_names_them():
    """A ball says nothing of what is up: its file does, or custom."""
    ball = st.Scene.flat(random_gaussians(500))
    named, assumed, told = (
        guess_up(survey_of(ball), Source(format="spz", metadata=metadata)).lead
        for metadata in ({"axes": "RDF"}, {"axes": "RDF, assumed"}, {"axes": "RUB, as told"})
    )
    assert assumed < named - 1
    assert named == told


def test_outliers_and_fog_do_not_move_the_picture():
    city = scene_named("city")
    rng = np.random.default_rng(1)
    g = city.gaussians.take(rng.integers(0, len(city), len(city) // 50))
    far = replace(
        g,
        means=(rng.normal(size=g.means.shape) * 1e4).astype(np.float32),
        log_scales=g.log_scales + np.float32(3),
    )
    calm, wild = (st.frame_scene(s) for s in (city, st.Scene.flat(st.Gaussians.concatenate([city.gaussians, far]))))
    assert degrees_between(wild.up, calm.up) < 1
    assert wild.radius == pytest.approx(calm.radius, rel=0.1)
    assert wild.centre == pytest.approx(calm.centre, abs=0.05 * calm.radius)
    assert np.linalg.norm(wild.eye - wild.target) < 1.5 * np.linalg.norm(calm.eye - calm.target)


def test_harmonics_tell_from_which_side_a_scene_was_photographed(small_scene):
    survey = survey_of(small_scene)
    middle = np.median(survey.means, axis=0)
    assert survey.gaze(middle + 300 * UP) > 0.3
    assert survey.gaze(middle - 300 * UP) < -0.3
    bare = survey_of(replace(small_scene, gaussians=small_scene.gaussians.with_sh_degree(0)))
    assert bare.gaze(middle + 300 * UP) == 0


def test_what_is_asked_for_is_done(small_scene):
    framing = st.frame_scene(small_scene, up=(0, 0, 2), inside=True)
    assert framing.up == pytest.approx([0, 0, 1])
    assert framing.inside and framing.is_sure


def test_one_gaussian_has_a_picture():
    one = st.Scene.flat(scene_named("figure").gaussians.take([0]))
    framing = st.frame_scene(one)
    assert picture(one, framing).alpha.max() > 0.5


@pytest.mark.parametrize("aspect", [1 / 65537, 65537])
def test_pictures_of_any_shape_are_framed(aspect):
    """Their trial pictures are 1:16 to 16:1: narrower ones had no pixel, wider ones took minutes."""
    framing = st.frame_scene(scene_named("figure"), inside=False, aspect=aspect)
    assert np.isfinite(framing.eye).all() and np.isfinite(framing.target).all()


def test_what_cannot_be_framed_is_refused(small_scene):
    with pytest.raises(InputError, match="empty"):
        st.frame_scene(st.Scene.flat(st.Gaussians.empty()))
    for up in ((0, 0, 0), (0, 1), (np.nan, 0, 0)):
        with pytest.raises(InputError, match="wanted a direction"):
            st.frame_scene(small_scene, up=up)
