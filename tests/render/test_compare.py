"""Two scenes from the same views: what is equal, what is worse, where the worst is, and the page that shows it."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.errors import InputError, OutputError
from splatree.io.images import read_image
from splatree.metrics.psnr import psnr
from splatree.render.compare import summary_of
from splatree.render.compare_page import error_colors

from .framing_scenes import city, figure, room

SMALL = st.PathOptions(views=4, width=64, height=48)


@pytest.fixture(scope="module")
def scene():
    return city(step=4)


@pytest.fixture(scope="module")
def cameras(scene):
    return st.orbit(scene, replace(SMALL, up=(0, -1, 0)))


def noisy(scene, amount, rows=slice(None)):
    sh = scene.gaussians.sh.copy()
    sh[rows] += np.random.default_rng(0).normal(scale=amount, size=sh[rows].shape).astype(np.float32)
    return replace(scene, gaussians=replace(scene.gaussians, sh=sh))


def test_a_scene_loses_nothing_against_itself(scene, cameras):
    differences = [view.difference for view in st.compare(scene, scene, cameras)]
    together = summary_of(differences)
    assert math.isinf(together.psnr) and together.ssim == 1 and together.flip == 0
    assert together.num_pixels == 4 * 64 * 48


def test_more_noise_is_more_loss(scene, cameras):
    found = [
        summary_of([view.difference for view in st.compare(noisy(scene, s), scene, cameras)]) for s in (0.1, 0.5, 1.5)
    ]
    assert found[0].psnr > found[1].psnr > found[2].psnr
    assert found[0].flip < found[1].flip < found[2].flip
    assert found[0].ssim > found[1].ssim > found[2].ssim


def test_numbers_are_those_of_the_pictures(scene, cameras):
    views = list(st.compare(noisy(scene, 0.5), scene, cameras))
    for view in views:
        assert view.difference.psnr == pytest.approx(psnr(view.image, view.reference), abs=1e-6)
        assert view.difference.flip == pytest.approx(st.flip(view.image, view.reference), abs=1e-6)
    together = summary_of([view.difference for view in views])
    images, references = (np.stack([getattr(view, name) for view in views]) for name in ("image", "reference"))
    assert together.psnr == pytest.approx(-10 * np.log10(np.mean((images - references.astype(float)) ** 2)), abs=1e-4)
    assert together.psnr_covered < together.psnr  # black around the scene is equal


def test_levels_are_judged_against_all_leaves(scene, cameras):
    tree = st.build_lod(scene)
    coarse, fine = (
        summary_of([v.difference for v in st.compare(tree, tree, cameras, select=st.SelectOptions(pixel_error=error))])
        for error in (8, 0)
    )
    assert math.isinf(fine.psnr)
    assert coarse.psnr < 60 and coarse.num_drawn < coarse.num_drawn_reference


def test_views_of_a_free_standing_scene_are_far_and_near(scene):
    views = st.comparison_views(scene, SMALL)
    target = st.frame_scene(scene, aspect=64 / 48).target
    distances = [np.linalg.norm(view.position - target) for view in views]
    assert distances[1] == pytest.approx(0.4 * distances[0], rel=1e-6)


def test_views_of_a_room_turn_about_one_eye():
    views = st.comparison_views(room(), SMALL)
    assert all(np.allclose(view.position, views[0].position) for view in views)


def test_page_shows_the_worst_view_first_and_pictures_lie_beside_it(scene, tmp_path):
    names, given = ("good", "bad/one"), st.orbit(scene, replace(SMALL, up=(0, -1, 0)))
    cameras = [replace(camera, name=name) for camera, name in zip(given, names, strict=False)]
    views = [*st.compare(noisy(scene, 0.05), scene, cameras[:1]), *st.compare(noisy(scene, 2), scene, cameras[1:])]
    comparison = st.write_comparison(views, tmp_path / "lost", title="a < b", about="new.sog beside old.ply")
    assert comparison.worst == "bad/one"
    assert sorted(path.name for path in (tmp_path / "lost").iterdir()) == [
        "good_error.png",
        "good_side_by_side.png",
        "one_error.png",
        "one_side_by_side.png",
        "report.html",
    ]
    page = comparison.report.read_text()
    assert "a &lt; b" in page and "new.sog beside old.ply" in page and "$" not in page
    assert re.findall(r"<h3>(\S+)", page) == ["bad/one", "good"]
    assert page.count('src="data:image/jpeg;base64,') == 6
    side = read_image(tmp_path / "lost" / "good_side_by_side.png")
    assert side.shape == (48, 3 * 64, 3)
    # Reference, scene, errors from left to right; rounded to 8 bits.
    assert np.abs(side[:, :64] - views[0].reference).max() <= 0.5 / 255 + 1e-6
    assert np.abs(side[:, 64:128] - views[0].image).max() <= 0.5 / 255 + 1e-6


def test_page_is_replaced_only_by_force(scene, cameras, tmp_path):
    views = list(st.compare(scene, scene, list(cameras)[:1]))
    st.write_comparison(views, tmp_path)
    with pytest.raises(OutputError, match=r"report\.html: exists already"):
        st.write_comparison(views, tmp_path)
    st.write_comparison(views, tmp_path, force=True)


def test_errors_run_from_black_to_white():
    colors = error_colors(np.float32([[0, 0.1, 0.3, 0.5, 1.0]]))[0]
    assert (np.diff(colors.sum(axis=1)) >= 0).all()
    assert colors[0].max() < 0.05 and colors[-1].min() > 0.9


def test_what_cannot_be_compared_is_refused(scene):
    with pytest.raises(InputError, match="found 0 and"):
        next(st.compare(st.Scene.flat(st.Gaussians.empty()), scene))
    with pytest.raises(InputError, match="no view"):
        next(st.compare(scene, scene, []))
    with pytest.raises(InputError, match="no view"):
        st.write_comparison([])
    with pytest.raises(InputError, match="no view"):
        summary_of([])


def test_a_figure_is_compared_too():
    differences = [view.difference for view in st.compare(figure(), figure(), st.comparison_views(figure(), SMALL))]
    assert all(0 < difference.covered < 1 for difference in differences)
