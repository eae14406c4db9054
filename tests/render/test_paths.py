from dataclasses import replace

import numpy as np
import pytest

from splatree.errors import InputError
from splatree.maths.rotations import matrices_from_quats, quat_from_matrix
from splatree.render.framing.frame import frame_scene
from splatree.render.paths import PathOptions, bounds_of, flyout, orbit, through, turn
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene


def scene_of(means, opacity_logits=2.0, log_scale=-3.0):
    n = len(means)
    return Scene.flat(
        Gaussians(
            np.asarray(means, np.float32),
            np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
            np.full((n, 3), log_scale, np.float32),
            np.broadcast_to(np.float32(opacity_logits), n).copy(),
            np.zeros((n, 1, 3), np.float32),
        )
    )


@pytest.fixture(scope="module")
def ball():
    """Points in a ball of radius 2 around (10, 20, 30)."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.array([10, 20, 30]) + directions * 2 * rng.random((4000, 1)) ** (1 / 3)


def test_bounds_of_a_ball(ball):
    centre, radius = bounds_of(scene_of(ball))
    # Standard error of a median of 4000 points over a diameter of 4: about 0.03.
    assert centre == pytest.approx([10, 20, 30], abs=0.1)
    assert radius == pytest.approx(2 * 0.9 ** (1 / 3), abs=0.05)


def test_far_and_transparent_gaussians_hardly_move_the_bounds(ball):
    centre, radius = bounds_of(scene_of(ball))
    far = np.full((40, 3), 1e5)  # 1 % of the points
    fog = ball + np.array([50.0, 0, 0])
    logits = np.concatenate([np.full(4000, 2.0), np.full(40, 2.0), np.full(4000, -8.0)])
    other_centre, other_radius = bounds_of(scene_of(np.concatenate([ball, far, fog]), logits))
    assert other_centre == pytest.approx(centre, abs=0.1)
    assert other_radius == pytest.approx(radius, rel=0.05)


def test_orbit_shows_the_whole_scene_upright(ball):
    scene = scene_of(ball)
    centre, radius = bounds_of(scene)
    cameras = orbit(scene, PathOptions(views=8, width=640, height=360, elevation_deg=20))
    assert len(cameras) == 8
    for camera in cameras:
        assert camera.near < np.linalg.norm(camera.position - centre) - radius
        x = camera.camera_from_world[:3, :3] @ centre + camera.camera_from_world[:3, 3]
        assert x[:2] == pytest.approx([0, 0], abs=1e-9)
        # A sphere of angular radius asin(r/d) is in the picture if it fits in half the vertical field of view.
        assert np.arcsin(radius / x[2]) <= np.radians(25) + 1e-9
        # A point that is up in the world (−y) is up in the picture, and the camera is above the target.
        assert (camera.camera_from_world[:3, :3] @ [0, -1, 0])[1] < 0
        assert camera.position[1] < centre[1]


@pytest.mark.parametrize(("rim", "radii"), [(1.1, 1.1), (40.0, 1.25)])
def test_an_orbit_shows_the_rim_of_an_object_but_not_far_floaters(ball, rim, radii):
    """5 % of the points lie at ``rim`` radii: within the 99 % that are shown, beyond the 90 % of the radius."""
    directions = ball[:200] - np.array([10, 20, 30])
    _, radius = bounds_of(scene_of(ball))
    directions *= rim * radius / np.linalg.norm(directions, axis=1, keepdims=True)
    scene = scene_of(np.concatenate([ball, np.array([10, 20, 30]) + directions]))
    centre, radius = bounds_of(scene)
    shown = [
        np.linalg.norm(camera.position - centre) * np.sin(np.radians(25)) / radius
        for camera in orbit(scene, PathOptions(views=2, width=640, height=360))
    ]
    # The 200 points move the radius itself by a few hundredths.
    assert shown == pytest.approx([radii] * 2, abs=0.06)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (1, 2, -3)])
def test_elevation_is_measured_from_the_given_up(ball, up):
    scene = scene_of(ball)
    centre, _ = bounds_of(scene)
    for camera in orbit(scene, PathOptions(views=3, up=up, elevation_deg=35)):
        direction = (camera.position - centre) / np.linalg.norm(camera.position - centre)
        assert direction @ up / np.linalg.norm(up) == pytest.approx(np.sin(np.radians(35)), abs=1e-9)


def test_flyout_moves_away_by_a_constant_factor(ball):
    scene = scene_of(ball)
    centre, radius = bounds_of(scene)
    cameras = flyout(scene, PathOptions(views=4), nearest=0.5, farthest=4)
    distances = [np.linalg.norm(camera.position - centre) / radius for camera in cameras]
    assert distances == pytest.approx([0.5, 1, 2, 4], rel=1e-9)


def test_single_gaussian_can_be_looked_at():
    centre, radius = bounds_of(scene_of(np.array([[1.0, 2, 3]])))
    assert centre == pytest.approx([1, 2, 3])
    assert radius == pytest.approx(3 * np.exp(-3))
    assert len(orbit(scene_of(np.zeros((1, 3))), PathOptions(views=2))) == 2


def test_view_from_straight_above_is_a_camera(ball):
    for camera in orbit(scene_of(ball), PathOptions(views=2, elevation_deg=90)):
        assert np.isfinite(camera.camera_from_world).all()


def test_empty_scene_has_no_path():
    with pytest.raises(InputError, match="empty"):
        orbit(scene_of(np.zeros((0, 3))))


@pytest.mark.parametrize(
    "wrong",
    [{"views": 0}, {"width": 0}, {"up": (0, 0, 0)}, {"elevation_deg": 91}, {"fov_y_deg": 0}, {"fov_y_deg": 180}],
)
def test_impossible_paths_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        PathOptions(**wrong)
    with pytest.raises(InputError, match="nearest"):
        flyout(scene_of(np.ones((2, 3))), nearest=2, farthest=1)


def test_a_path_through_cameras_passes_each_and_stays_rigid(ball):
    cameras = list(orbit(scene_of(ball), PathOptions(views=3)))
    path = list(through(cameras, 9))
    assert len(path) == 9
    for place, camera in ((0, cameras[0]), (4, cameras[1]), (8, cameras[2])):
        assert path[place].camera_from_world == pytest.approx(camera.camera_from_world, abs=1e-9)
    half = path[2]
    assert half.position == pytest.approx((cameras[0].position + cameras[1].position) / 2)
    turned = [
        np.arccos((np.trace(a.T @ b) - 1) / 2) for a, b in ((rotation(cameras[i]), rotation(half)) for i in (0, 1))
    ]
    assert turned[0] == pytest.approx(turned[1])  # as far from the one as from the other
    assert rotation(half) @ rotation(half).T == pytest.approx(np.eye(3), abs=1e-9)


def test_a_path_through_one_camera_stands_still(ball):
    camera = orbit(scene_of(ball), PathOptions(views=1))[0]
    for view in through([camera], 3):
        assert view.camera_from_world == pytest.approx(camera.camera_from_world, abs=1e-9)
    with pytest.raises(InputError, match="found 0 cameras"):
        through([], 3)


def test_a_path_turns_the_shorter_way_whatever_the_signs_of_the_quaternions():
    """A quaternion and its negative are one direction; the way between them must not depend on which of both is stored."""
    rng = np.random.default_rng(3)
    quats = rng.normal(size=(40, 4))
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :3, :3] = matrices_from_quats(quats)
    cameras = [replace(Camera.look_at((0, 0, -1), (0, 0, 0)), camera_from_world=pose) for pose in poses]
    stored = np.array([quat_from_matrix(pose[:3, :3]) for pose in poses])
    assert ((stored[:-1] * stored[1:]).sum(axis=1) < 0).sum() > 5  # pairs for which signs matter
    quarters = list(through(cameras, 4 * 39 + 1))
    for i in range(39):
        whole = angle_between(cameras[i], cameras[i + 1])
        for k in range(5):
            # The angle of a rotation comes from a cosine: 1e-16 there is 1e-8 rad where the cosine is flat.
            assert angle_between(cameras[i], quarters[4 * i + k]) == pytest.approx(k / 4 * whole, abs=1e-6)


@pytest.mark.parametrize("inside", [False, True])
def test_a_turn_goes_all_round_in_even_steps(ball, inside):
    """About the target from outside, about the eye from within; the vertical and the distance stay."""
    up = np.array([0.0, 0.6, 0.8])
    eye, target = np.array([10.0, 16, 30]), np.array([10.0, 20, 30])
    framing = replace(frame_scene(scene_of(ball)), up=up, inside=inside, eye=eye, target=target)
    views = list(turn(framing, PathOptions(views=8, width=64, height=36)))
    first = framing.camera(64, 36)
    assert views[0].camera_from_world == pytest.approx(first.camera_from_world, abs=1e-9)
    angle = np.pi / 4
    for before, after in zip(views, [*views[1:], views[0]], strict=True):
        a, b = before.camera_from_world[2, :3], after.camera_from_world[2, :3]
        assert b @ up == pytest.approx(a @ up)
        flat_a, flat_b = a - (a @ up) * up, b - (b @ up) * up
        assert flat_a @ flat_b == pytest.approx(np.cos(angle) * (flat_a @ flat_a))
        if inside:
            assert after.position == pytest.approx(eye)
        else:
            assert np.linalg.norm(after.position - target) == pytest.approx(4)
            assert after.position @ up == pytest.approx(eye @ up)
            assert after.position - target == pytest.approx(-4 * b)


def angle_between(a, b):
    return np.arccos(np.clip((np.trace(rotation(a).T @ rotation(b)) - 1) / 2, -1, 1))


def rotation(camera):
    return camera.camera_from_world[:3, :3]
