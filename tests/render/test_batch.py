from dataclasses import replace

import numpy as np
import pytest

from splatree.progress import listen
from splatree.render.batch import render_batch, trace_batch
from splatree.render.evaluate import evaluate
from splatree.render.paths import PathOptions, orbit
from splatree.render.pipeline import render
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree

FAMILIES = 30


@pytest.fixture(scope="module")
def scene():
    """Families of a parent and two leaves beside it."""
    rng = np.random.default_rng(2)
    means = np.repeat(rng.normal(size=(FAMILIES, 3)), 3, axis=0)
    means[1::3] += [0.05, 0, 0]
    means[2::3] -= [0.05, 0, 0]
    log_scales = np.full((3 * FAMILIES, 3), -2.5)
    log_scales[::3] += 0.2
    rows = np.arange(3 * FAMILIES)
    gaussians = Gaussians(
        means.astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (3 * FAMILIES, 1)),
        log_scales.astype(np.float32),
        np.full(3 * FAMILIES, 2.0, np.float32),
        rng.normal(size=(3 * FAMILIES, 1, 3)).astype(np.float32),
    )
    tree = GaussianTree(
        subtree_end=np.where(rows % 3 == 0, rows + 3, rows + 1).astype(np.int32),
        depth=(rows % 3 > 0).astype(np.uint8),
        extents=np.full(3 * FAMILIES, 1.0, np.float32),
    )
    return Scene(gaussians, tree)


@pytest.fixture(scope="module")
def cameras(scene):
    return orbit(scene, PathOptions(views=3, width=64, height=48))


def test_batch_draws_what_single_views_draw(scene, cameras):
    options, select = RenderOptions(background=(1, 0, 0)), SelectOptions(pixel_error=1e6)
    batch = list(render_batch(scene, cameras, options, select))
    assert len(batch) == len(cameras)
    for camera, result in zip(cameras, batch, strict=True):
        assert np.array_equal(result.image, render(scene, camera, options, select).image)


def test_batch_reports_each_view(scene, cameras):
    events = []
    with listen(events.append):
        list(trace_batch(scene, cameras))
    assert [event.done for event in events] == [0, 1, 2, 3, 3]
    assert events[-1].finished


def test_evaluation_measures_what_the_levels_lose(scene, cameras):
    select = SelectOptions(pixel_error=1e6)
    for camera, e in zip(cameras, evaluate(scene, cameras, select=select), strict=True):
        assert e.camera is camera
        assert e.cut.result.counters.num_selected == FAMILIES
        assert e.leaves.result.counters.num_selected == 2 * FAMILIES
        a, b = (np.clip(frame.result.image, 0, 1).astype(np.float64) for frame in (e.cut, e.leaves))
        assert e.cut_vs_leaves.psnr == pytest.approx(-10 * np.log10(np.mean((a - b) ** 2)), abs=1e-9)
        assert e.cut_vs_leaves.ssim < 0.999


def test_evaluation_without_levels_finds_no_loss(scene, cameras):
    flat = Scene.flat(scene.gaussians)
    for e in evaluate(flat, cameras):
        assert e.cut_vs_leaves.psnr == float("inf")
        assert e.cut_vs_leaves.ssim == pytest.approx(1, abs=1e-12)


def test_evaluation_compares_with_the_photograph_of_the_view(scene, cameras):
    photo = np.clip(render(scene, cameras[1], None, SelectOptions(pixel_error=0)).image, 0, 1)
    first, second, _ = evaluate(scene, cameras, select=SelectOptions(pixel_error=1e6), photos={cameras[1].name: photo})
    assert first.cut_vs_photo is None and first.leaves_vs_photo is None
    assert second.leaves_vs_photo.psnr == float("inf")
    assert replace(second.cut_vs_photo, psnr_fitted=None) == second.cut_vs_leaves
