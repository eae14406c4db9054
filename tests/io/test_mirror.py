import numpy as np
import pytest

from splatree import Camera, Gaussians, Scene, render
from splatree.io.mirror import mirror
from splatree.maths.axes import AXES, signs_between

from ..scenes import random_gaussians


def camera(signs):
    """The view along z of a world mirrored by ``signs``; one that is seen in a mirror is mirrored left to right."""
    handed = np.diag([np.prod(signs), 1, 1]).astype(np.float64)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = handed * 1.0 @ np.diag(signs)
    camera_from_world[:3, 3] = (0, 0, 40)
    K = np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]], np.float64)
    return Camera(camera_from_world, K, 64, 48)


@pytest.mark.parametrize("target", AXES)
def test_a_mirrored_scene_gives_the_picture_of_the_scene(target):
    g = random_gaussians(300)
    g = Gaussians(g.means, g.quats, g.log_scales + 4, g.logit_opacities, g.sh)
    wanted = render(Scene.flat(g), camera(np.ones(3))).image
    signs = signs_between("RDF", target)
    copy = Gaussians(*(column.copy() for column in (g.means, g.quats, g.log_scales, g.logit_opacities, g.sh)))
    mirror(copy, signs)
    found = render(Scene.flat(copy), camera(signs)).image
    found = found[:, ::-1] if np.prod(signs) < 0 else found
    assert np.ptp(wanted) > 0.3  # something is to be seen
    # Signs are exact, but products of them are summed in other orders; 80 dB is far above what an 8-bit picture shows.
    assert -10 * np.log10(np.mean((found - wanted) ** 2) + 1e-20) > 80
