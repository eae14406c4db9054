"""Lenses and the pictures through them: the formulas of OpenCV, their inverse, and what is drawn."""

import math
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree import Camera, Gaussians, InputError, Scene
from splatree.scene.lens import Lens
from splatree.scene.warp import bend, covering_pinhole, filled_pinhole, straighten

LENSES = {
    "brown": Lens("brown", (-0.2, 0.05), tangential=(1e-3, -2e-3)),
    "rational": Lens("brown", (0.1, 0.02, 0.01), (0.3, 0.01)),
    "fisheye": Lens("fisheye", (0.02, -0.01, 0.003)),
    "fisheye with a prism": Lens("fisheye", (0.02, 0.01), tangential=(1e-3, 1e-3), prism=(1e-3, -1e-3)),
    "fov": Lens("fov", (0.9,)),
}
CAMERA = Camera.look_at(np.array([0.0, 0.0, -4.0]), np.zeros(3), width=120, height=90, fov_y_deg=50)


def test_a_lens_bends_as_opencv_says():
    u, v = 0.3, -0.2
    r2 = u * u + v * v
    k1, k2, p1, p2 = -0.2, 0.05, 1e-3, -2e-3
    radial = 1 + k1 * r2 + k2 * r2**2
    brown = (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u), v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v))
    np.testing.assert_allclose(LENSES["brown"].bent(np.array([u, v])), brown, rtol=1e-12)
    r = math.sqrt(r2)
    angle = math.atan(r)
    long = angle * (1 + 0.02 * angle**2 - 0.01 * angle**4 + 0.003 * angle**6)
    np.testing.assert_allclose(LENSES["fisheye"].bent(np.array([u, v])), (u * long / r, v * long / r), rtol=1e-12)
    np.testing.assert_allclose(
        LENSES["fov"].bent(np.array([u, v])),
        np.array([u, v]) * math.atan(2 * r * math.tan(0.45)) / (0.9 * r),
        rtol=1e-12,
    )


@pytest.mark.parametrize("name", LENSES)
def test_straight_undoes_bent(name):
    lens = LENSES[name]
    slopes = np.random.default_rng(0).uniform(-0.6, 0.6, (500, 2))
    slopes[0] = 0
    np.testing.assert_allclose(lens.straight(lens.bent(slopes)), slopes, atol=2e-6)


def test_what_a_lens_does_not_show_has_no_direction():
    # r − r³ / 3 turns back at r = 1, where it is 2/3.
    folding = Lens("brown", (-1 / 3,))
    assert np.isnan(folding.straight(np.array([0.7, 0.0]))).all()
    assert np.isfinite(folding.straight(np.array([0.6, 0.0]))).all()
    # A fisheye shows 80° at its angle; a flat picture does not go so far.
    assert np.isnan(Lens("fisheye").straight(np.array([0.0, math.radians(80)]))).all()


@pytest.mark.parametrize("name", LENSES)
def test_a_gaussian_is_drawn_where_the_lens_shows_it(name):
    camera = replace(CAMERA, lens=LENSES[name])
    points = np.array([[-1.2, -0.8, 0], [1.3, 0.9, 0], [0.7, -1.1, 0.5], [0, 0, 0]], np.float32)
    for point in points:
        one = Gaussians(
            point[None], np.array([[1, 0, 0, 0]], np.float32), np.full((1, 3), -4, np.float32), np.full(1, 3, np.float32),
            np.ones((1, 1, 3), np.float32),
        )  # fmt: skip
        alpha = st.render(Scene.flat(one), camera).alpha
        x, y, z = camera.camera_from_world[:3, :3] @ point + camera.camera_from_world[:3, 3]
        wanted = LENSES[name].bent(np.array([x / z, y / z])) * np.diag(camera.K)[:2] + camera.K[:2, 2]
        rows, columns = np.indices(alpha.shape) + 0.5
        found = np.array([(columns * alpha).sum(), (rows * alpha).sum()]) / alpha.sum()
        # A tenth of a pixel: the splat is not quite symmetric once it is bent. Without the lens it would be off by some pixels.
        np.testing.assert_allclose(found, wanted, atol=0.1)


def test_trace_keeps_the_pinhole_and_gives_the_picture_of_the_camera():
    scene = Scene.flat(_cloud(200))
    camera = replace(CAMERA, lens=LENSES["brown"], name="bent")
    frame = st.trace(scene, camera)
    assert frame.camera.lens is None and frame.camera.name == "bent"
    assert frame.result.image.shape == (90, 120, 3)
    np.testing.assert_array_equal(frame.result.image, st.render(scene, camera).image)
    drawn = frame.result.alpha > 0.5
    assert (np.abs(frame.result.depth[drawn] - 4) < 2.5).all()


def test_a_stage_alone_refuses_a_lens():
    with pytest.raises(InputError, match=r"found a lens, wanted a pinhole.*`render` and `trace`"):
        st.select(Scene.flat(_cloud(10)), replace(CAMERA, lens=LENSES["brown"]))


def test_a_picture_that_cannot_be_flat_is_refused():
    wide = replace(CAMERA, lens=Lens("fisheye"), K=np.array([[40.0, 0, 60], [0, 40, 45], [0, 0, 1]]))
    with pytest.raises(InputError, match=r"more than 75° from its axis.*crop the camera, or undistort"):
        covering_pinhole(wide)
    assert filled_pinhole(wide).width < 2 * 40 * math.tan(math.radians(60)) + 2  # 120° of it can be compared


@pytest.mark.parametrize("name", LENSES)
def test_bent_and_straightened_is_what_a_pinhole_draws(name):
    scene = Scene.flat(_cloud(60, log_scale=-1.5))
    camera = replace(CAMERA.scaled(2), lens=LENSES[name])
    photo = st.render(scene, camera).image
    flat = filled_pinhole(camera)
    assert flat.lens is None and flat.width > 200
    # Two resamplings of a smooth picture: 35 dB and more.
    assert st.psnr(np.clip(straighten(photo, camera, flat), 0, 1), np.clip(st.render(scene, flat).image, 0, 1)) > 35


def test_bending_a_picture_of_directions_gives_the_directions():
    camera = replace(CAMERA, lens=LENSES["fisheye"])
    pinhole = covering_pinhole(camera)
    x, y = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
    slopes = (np.stack([x, y], axis=-1) - pinhole.K[:2, 2]) / np.diag(pinhole.K)[:2]
    shown = bend(slopes.astype(np.float32), pinhole, camera)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    places = (np.stack([x, y], axis=-1) - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    np.testing.assert_allclose(LENSES["fisheye"].bent(shown.astype(np.float64)), places, atol=1e-5)


def _cloud(n, log_scale=-2.5):
    rng = np.random.default_rng(1)

    def normal(*shape):
        return rng.standard_normal(shape).astype(np.float32)

    means = (rng.uniform(-2.2, 2.2, (n, 3)) * (1, 1, 0.2)).astype(np.float32)
    return Gaussians(means, normal(n, 4), np.full((n, 3), log_scale, np.float32), normal(n) + 1, 0.5 * normal(n, 1, 3))
