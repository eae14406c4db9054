"""What PlayCanvas draws of Gaussians, against a transcription of its shaders (gsplatCornerVS, gsplatPS) splat by splat."""

import dataclasses

import numpy as np
import pytest

import splatree as st
from splatree.maths.rotations import matrices_from_quats
from splatree.stream.readers import playcanvas_drawing
from splatree.stream.readers.playcanvas_drawing import ENGINE_DILATION_PX2, draw_playcanvas

from ..scenes import random_gaussians

VIEW = st.Camera.look_at([0, 0, -4.0], [0, 0, 0.0], width=64, height=48)


def as_the_engine(g, camera, widening=0.3, least_px=2.0):
    """The shaders' arithmetic in half pixels, back to front, without the steps of the buffer."""
    picture = np.zeros((camera.height, camera.width, 3))
    y, x = np.indices(picture.shape[:2]) + 0.5
    W, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    points = g.means.astype(np.float64) @ W.T + t
    colors = np.clip(g.sh[:, 0].astype(np.float64) * 0.28209479177387814 + 0.5, 0, None)
    num_drawn = 0
    for i in np.argsort(-points[:, 2]):
        p, f = points[i], 2 * np.diag(camera.K)[:2]
        J = np.array([[f[0] / p[2], 0, -f[0] * p[0] / p[2] ** 2], [0, f[1] / p[2], -f[1] * p[1] / p[2] ** 2]])
        M = J @ W @ matrices_from_quats(g.quats[i : i + 1])[0] * np.exp(g.log_scales[i].astype(np.float64))
        widened = M @ M.T + widening * np.eye(2)
        if 2 * np.sqrt(2 * np.linalg.eigvalsh(widened)[-1]) < least_px:
            continue
        num_drawn += 1
        u, v = camera.K[:2, :2] @ p[:2] / p[2] + camera.K[:2, 2]
        d = 2 * np.stack([x - u, y - v], axis=-1)
        A = np.einsum("hwi,ij,hwj->hw", d, np.linalg.inv(widened), d) / 8
        alpha = g.opacities()[i] * (np.exp(-4 * A) - np.exp(-4)) / (1 - np.exp(-4))
        alpha = np.where((A <= 1) & (alpha >= 1 / 255), alpha, 0)[..., None]
        picture = colors[i] * alpha + picture * (1 - alpha)
    return np.clip(picture, 0, 1), num_drawn


def cloud(largest):
    """Scales lie on the steps of the engine's buffer, so that no splat is moved over the limit of two pixels."""
    rng, steps_of = np.random.default_rng(3), lambda scale: (np.log(scale) + 12) * 255 / 21
    g = random_gaussians(300, degree=0, seed=3)
    steps = np.round(rng.uniform(steps_of(largest / 30), steps_of(largest), (300, 3)))
    return dataclasses.replace(
        g, means=g.means * np.float32(0.05), log_scales=(steps * (21 / 255) - 12).astype(np.float32)
    )


@pytest.mark.parametrize("largest", [0.03, 0.1, 0.4])
def test_pictures_are_near_to_the_shaders(largest):
    """The rim of a splat is that of a Gaussian here."""
    g = cloud(largest)
    expected, _ = as_the_engine(g, VIEW)
    usual = np.clip(st.render(st.Scene.flat(g), VIEW).image, 0, 1)
    found = np.clip(draw_playcanvas(g, VIEW).image, 0, 1)
    assert st.psnr(found, expected.astype(np.float32)) >= max(36, st.psnr(usual, expected.astype(np.float32)) + 3)
    assert abs(found.mean() / expected.mean() - 1) <= 0.02


def test_splats_of_less_than_two_pixels_are_left_out():
    g = cloud(0.05)
    means = np.float32(0.3) * g.means  # all within the picture
    g = dataclasses.replace(g, means=means, logit_opacities=np.full(len(g), 2.0, np.float32))
    for dilation in (ENGINE_DILATION_PX2, 0.12, 0.3):
        _, expected = as_the_engine(g, VIEW, widening=4 * dilation)
        assert draw_playcanvas(g, VIEW, dilation_px2=dilation).counters.num_selected == expected
        assert (expected == 300) == (dilation == 0.3)


def test_nothing_large_enough_gives_a_black_picture():
    assert not draw_playcanvas(cloud(1e-4), VIEW).image.any()


def test_variances_do_not_depend_on_how_many_are_found_at_once(monkeypatch):
    """BLAS may add three products in another order for other numbers of rows: the last bits may differ, and no row."""
    g = cloud(0.1)
    whole = playcanvas_drawing._largest_variances(g, VIEW)
    sizes, of_run = [], playcanvas_drawing._largest_of

    def counted(means, *more):
        sizes.append(len(means))
        return of_run(means, *more)

    monkeypatch.setattr(playcanvas_drawing, "_largest_of", counted)
    for length in (1, 7, 299, 300):
        sizes.clear()
        monkeypatch.setattr(playcanvas_drawing, "_ROWS_AT_ONCE", length)
        np.testing.assert_allclose(playcanvas_drawing._largest_variances(g, VIEW), whole, rtol=1e-12)
        assert max(sizes) == length and sum(sizes) == len(g)
    assert len(playcanvas_drawing._largest_variances(g.take(np.zeros(0, np.intp)), VIEW)) == 0
