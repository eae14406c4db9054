import numpy as np
import pytest

import splatree as st
from splatree import InputError, RenderOptions, Scene, SelectOptions
from splatree.constants import ALPHA_THRESHOLD
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.view import view_of

from ..scenes import gaussians

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"background": (0, NAN, 0)}, "background: found"),
        ({"background": (0, 0, 255)}, "from 0 to 1"),
        ({"background": (-0.1, 0, 0)}, "from 0 to 1"),
        ({"dilation_px2": -0.1}, "dilation_px2: found -0.1, wanted 0"),
        ({"dilation_px2": INF}, "found inf"),
        ({"dilation_px2": NAN}, "found nan"),
        ({"threshold": 0.0}, "threshold: found 0.0, wanted between 0 and 1"),
        ({"threshold": 1.0}, "threshold"),
        ({"pixels": "soft"}, "pixels: found 'soft', wanted 'taper' or 'hard'"),
        ({"tile_rule": "box"}, "tile_rule: found 'box', wanted"),
        ({"pixels": "taper", "tile_rule": "tau"}, "'taper' with tile_rule 'tau'"),
        ({"pixels": "taper", "tile_rule": "3sigma"}, "'taper' with tile_rule '3sigma'"),
        ({"sh_degree": -1}, "sh_degree: found -1, wanted 0 to 3"),
        ({"sh_degree": 4}, "sh_degree: found 4, wanted 0 to 3"),
    ],
)
def test_render_options_that_cannot_be_drawn_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        RenderOptions(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pixel_error": -1.0}, "pixel_error: found -1.0, wanted 0 px or more"),
        ({"pixel_error": NAN}, "pixel_error"),
        ({"budget": 0}, "budget: found 0, wanted at least 1 node"),
        ({"max_radius": -1.0}, "max_radius"),
        ({"rule": "best"}, "rule: found 'best', wanted 'cut'"),
        ({"view_test": "all"}, "view_test: found 'all', wanted 'footprint'"),
        ({"cull": "boxes"}, "cull: found 'boxes', wanted 'none'"),
    ],
)
def test_select_options_that_mean_nothing_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        SelectOptions(**options)


@pytest.mark.parametrize(
    "options",
    [
        {"background": (0, 1, 0.5), "dilation_px2": 0.0, "sh_degree": 0},
        {"dilation_px2": 1e12, "sh_degree": 3},
        {"pixels": "taper", "tile_rule": "balanced"},
    ],
)
def test_the_ends_of_ranges_are_options(options):
    assert {name: getattr(RenderOptions(**options), name) for name in options} == options


def scene(**fields):
    one = Gaussians(
        np.zeros((1, 3), np.float32),
        np.ones((1, 4), np.float32),
        np.zeros((1, 3), np.float32),
        np.zeros(1, np.float32),
        np.zeros((1, 4, 3), np.float32),
    )
    flat = Scene.flat(one, mode="antialiased")
    return Scene(**{**vars(flat), **fields})


CAMERA = Camera.look_at(np.array([0.0, 0, -4]), np.zeros(3))


def test_what_options_leave_open_is_as_the_scene_says():
    own = view_of(scene(threshold=0.1, tile_rule="balanced"), CAMERA)
    assert (own.mode, own.threshold, own.tile_rule, own.sh_degree) == ("antialiased", 0.1, "balanced", 1)
    given = RenderOptions(mode="classic", threshold=0.2, tile_rule="tau", sh_degree=0)
    given = view_of(scene(threshold=0.1, tile_rule="balanced"), CAMERA, given)
    assert (given.mode, given.threshold, given.tile_rule, given.sh_degree) == ("classic", 0.2, "tau", 0)
    assert view_of(scene(), CAMERA).tile_rule == "ellipse"


@pytest.mark.parametrize(
    ("tile_rule", "threshold", "least_threshold", "least_opacity", "area_power"),
    [
        ("ellipse", 0.1, 0.1, 0.1, 0.0),
        ("balanced", 0.1, ALPHA_THRESHOLD, ALPHA_THRESHOLD, 0.4),  # large splats end lower, at 1/255 at the least
        ("balanced", 0.001, 0.001, 0.001, 0.4),
        ("tau", 0.1, 0.1, 0.0, 0.0),  # squares list splats of any opacity
        ("3sigma", 0.1, 0.1, 0.0, 0.0),
    ],
)
def test_what_follows_from_the_tile_rule(tile_rule, threshold, least_threshold, least_opacity, area_power):
    resolved = view_of(scene(), CAMERA, RenderOptions(tile_rule=tile_rule, threshold=threshold))
    assert resolved.least_threshold == least_threshold
    assert resolved.least_opacity == least_opacity
    assert resolved.area_power == area_power
    assert resolved.is_square == (tile_rule in ("tau", "3sigma"))


def test_pixels_are_drawn_down_to_the_lossless_threshold_and_tapered_only_above_it():
    for threshold, pixel_threshold, tapers in ((0.1, ALPHA_THRESHOLD, True), (0.001, 0.001, False)):
        resolved = view_of(scene(), CAMERA, RenderOptions(threshold=threshold, pixels="taper"))
        assert (resolved.pixel_threshold, resolved.tapers) == (pixel_threshold, tapers)
    assert not view_of(scene(), CAMERA, RenderOptions(threshold=0.1)).tapers
    assert not view_of(scene(), CAMERA, RenderOptions(threshold=ALPHA_THRESHOLD, pixels="taper")).tapers


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (
            lambda: st.SelectOptions(pixel_error=1e308),
            r"pixel_error: found 1e\+308, wanted 0 px or more, at most 1e\+30 or inf",
        ),
        (lambda: st.SelectOptions(max_radius=1e308), r"max_radius: found 1e\+308, wanted 0 px or more, at most 1e\+30"),
        (lambda: st.BaselineOptions(pixel_error=-1), "pixel_error: found -1, wanted 0 px or more"),
        (lambda: st.BaselineOptions(depth=-1), "depth: found -1, wanted 0 or more"),
        (lambda: st.PathOptions(views=10**7), "views: found 10000000, wanted 1 to 1,000,000"),
        (
            lambda: st.PathOptions(width=2**31),
            "width, height: found 2147483648 × 540, wanted 1 × 1 px to 2,147,483,647",
        ),
        (lambda: st.RefineOptions(iterations=10**10), "iterations: found 10000000000, wanted 1 to 1e9"),
        (lambda: st.RefineOptions(made_views=10**7), "made_views: found 10000000, wanted 8 to 1e6"),
        (lambda: st.RefineOptions(seed=-1), "seed: found -1, wanted 0 or more"),
        (lambda: st.ClusterOptions(seed=-1), "seed: found -1, wanted 0 or more"),
        (
            lambda: st.EditOptions(crop_sphere=(0, 0, 0, 1e300)),
            "crop_sphere: found .*, wanted numbers of at most 1e.100",
        ),
        (lambda: st.EditOptions(translate=(float("nan"), 0, 0)), "translate: found .*, wanted numbers of at most"),
        (lambda: st.ServeOptions(host=""), "host, packages: found '', "),
        (lambda: st.ServeOptions(packages=""), "host, packages: found '127.0.0.1', '', wanted addresses"),
        (
            lambda: st.ViewOptions(allow_origin=("https://hub.example/",)),
            "allow_origin: found 'https://hub.example/', ",
        ),
        (lambda: st.ViewOptions(allow_origin=("hub.example",)), "allow_origin: found 'hub.example', wanted scheme"),
        (lambda: st.ViewOptions(allow_origin=("http://a; script-src *",)), "allow_origin: found "),
    ],
)
def test_values_without_sense_are_refused(make, found):
    with pytest.raises(st.InputError, match=found):
        make()


def test_huge_pixel_errors_draw_the_roots():
    """Their squares have no room in a number."""
    scene = st.build_lod(st.Scene.flat(gaussians(50, 0)), st.BuildOptions(method="radius"))
    camera = st.Camera.look_at([0, 0, -30], [0, 0, 0], width=32, height=32)
    for huge in (1e30, float("inf")):
        rows = st.select(scene, camera, st.SelectOptions(pixel_error=huge, view_test="none")).rows
        assert (scene.tree.depth[rows] == 0).all() and len(rows)
        assert len(st.select(scene, camera, st.SelectOptions(max_radius=huge, view_test="none")))
