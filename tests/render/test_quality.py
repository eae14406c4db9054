"""Measuring how good the cuts of a scene look (render/quality.py)."""

from dataclasses import replace
from importlib import import_module
from importlib.resources import as_file, files

import numpy as np
import pytest

import splatree as st
from splatree.errors import InputError
from splatree.render.quality import _fitted

from ..scenes import surface


def test_the_fit_finds_the_curve_that_pictures_follow():
    rng = np.random.default_rng(5)
    curve = st.QualityCurve(41.0, -5.0, -2.0, 4.0, -0.3, -0.7, error_db=0.0, num_pictures=60)
    samples = []
    for _ in range(60):
        pixel_error, merged, varied = rng.uniform(0.5, 16), rng.uniform(0.01, 1), rng.uniform(0.001, 0.1)
        samples.append((curve.psnr(pixel_error, merged=merged, varied=varied), pixel_error, merged, varied))
    found = _fitted(samples)
    assert found.error_db < 0.01
    for name in ("offset", "by_pixel_error", "by_fine", "fine_px", "by_merged", "by_varied"):
        # Keeping the numbers small costs 0.03² against 60 pictures: 1e-3 of them.
        assert getattr(found, name) == pytest.approx(getattr(curve, name), rel=1e-2)


def test_a_fit_that_is_far_off_promises_less():
    """What is taken off is 2.5 errors less 2 dB, if that is anything."""
    rng = np.random.default_rng(6)
    for scatter, taken in ((0.4, 0.0), (2.0, 2.5 * 2.0 - 2)):
        samples = []
        for _ in range(4000):
            pixel_error, merged, varied = rng.uniform(2, 16), rng.uniform(0.01, 1), rng.uniform(0.001, 0.1)
            psnr = 25 - 4 * np.log(pixel_error) - 7 * np.log10(varied) - 3 * np.log10(merged) + scatter * rng.normal()
            samples.append((psnr, pixel_error, merged, varied))
        found = _fitted(samples)
        assert found.error_db == pytest.approx(scatter, rel=0.05)
        at = {"merged": 0.3, "varied": 0.02}
        true = 25 - 4 * np.log(6) - 7 * np.log10(0.02) - 3 * np.log10(0.3)
        # Of 4000 pictures the mean is known to 0.03 dB, the error to 0.02, which counts 2.5 times.
        assert true - found.psnr(6, **at) == pytest.approx(taken, abs=0.2)


def test_a_fit_never_rises_with_the_pixel_error():
    """Pictures that get better where τ_R grows, as a few odd views may."""
    samples = [(30 + pixel_error, pixel_error, 0.5, 0.5) for pixel_error in range(2, 14)]
    assert _fitted(samples).by_pixel_error == 0


@pytest.mark.parametrize("method", ["radius", "pairs"])
def test_views_that_were_not_measured_have_the_quality_asked_for(method):
    """A tenth of the bundled city; views between those that are made for the measurement."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        city = st.read(path)
    leaves = st.Scene.flat(city.gaussians.take(np.arange(0, 24_000)))
    tree = st.with_quality(st.build_lod(leaves, st.BuildOptions(method=method)))
    assert tree.tree.record.quality.num_pictures >= 15
    options = st.PathOptions(views=4, width=320, height=180)
    cameras = [*list(st.flyout(leaves, options))[1:3], *list(st.turn(st.frame_scene(leaves), options))[1::2]]
    for quality in (30.0, 34.0):
        errors = []
        for camera in cameras:
            wanted = np.clip(st.render(leaves, camera).image, 0, 1)
            picture = st.render(tree, camera, select=st.SelectOptions(quality=quality)).image
            errors.append(min(st.psnr(np.clip(picture, 0, 1), wanted), 48.0) - quality)
        assert abs(np.mean(errors)) <= 1  # found: 0.1 to 0.7
        assert min(errors) >= -2  # found: -0.6


def test_what_cannot_be_measured_is_refused():
    flat = st.Scene.flat(surface(100))
    with pytest.raises(InputError, match="found a scene without levels"):
        st.with_quality(flat)
    scene = st.build_lod(flat)
    camera = st.Camera.look_at([0, 0, -6], [0, 0, -12], width=32, height=32)
    with pytest.raises(InputError, match="found 0 pictures from 28 to 48 dB in 1 views"):
        st.with_quality(scene, [camera])


def test_the_measurement_is_the_same_for_any_number_of_threads():
    scene = st.build_lod(st.Scene.flat(surface(600)))
    camera = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=160, height=120)
    cameras = [camera, *(replace(c, near=camera.near) for c in st.dolly(scene, camera, 8, step=-0.4))]
    one, many = (st.with_quality(scene, cameras, threads=threads).tree.record.quality for threads in (1, 3))
    assert one == many


def test_a_scene_too_large_for_many_views_is_measured_in_as_many_as_a_curve_needs(monkeypatch):
    """However few nodes may be drawn: views are begun until there are pictures enough, and then no more."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        city = st.read(path)
    tree = st.build_lod(st.Scene.flat(city.gaussians.take(np.arange(0, 24_000))), st.BuildOptions("radius"))
    most = st.with_quality(tree).tree.record.quality.num_pictures
    for name in ("NODES_DRAWN", "FEWEST_NODES"):
        monkeypatch.setattr(import_module("splatree.render.quality"), name, 0)
    assert 8 <= st.with_quality(tree).tree.record.quality.num_pictures < most
