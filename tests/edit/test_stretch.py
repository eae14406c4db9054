"""Gaussians under linear maps that mirror, stretch or shear (edit/stretch.py)."""

import numpy as np
import pytest

from splatree.edit.stretch import Stretch
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.harmonics import basis_from_directions
from splatree.maths.rotations import matrix_from_angles

from ..scenes import random_gaussians

TURN = matrix_from_angles((20.0, -50.0, 110.0))
MIRROR = TURN @ np.diag([-1.0, 1, 1]) @ TURN.T @ TURN


def colors(g, directions):
    return basis_from_directions(directions, g.sh_degree) @ g.sh.astype(np.float64)


def directions(num=20):
    found = np.random.default_rng(1).normal(size=(num, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(5))
def test_shapes_are_those_of_the_map(seed):
    matrix, g = np.random.default_rng(seed).normal(size=(3, 3)), random_gaussians(50, 0, seed)
    found = Stretch(matrix).gaussians(g)
    wanted = matrix @ covariances_from_gaussians(g.quats, g.log_scales) @ matrix.T
    errors = np.abs(covariances_from_gaussians(found.quats, found.log_scales) - wanted)
    assert (errors.max(axis=(1, 2)) < 1e-5 * np.abs(wanted).max(axis=(1, 2))).all()  # float32
    np.testing.assert_array_equal(found.logit_opacities, g.logit_opacities)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("orthogonal", [TURN, MIRROR, -TURN], ids=["turn", "mirror", "point"])
def test_colours_turn_and_mirror_with_space(orthogonal, degree):
    """What is seen in a direction is then seen in the direction to which the map takes it."""
    g = random_gaussians(30, degree)
    found = Stretch(2.5 * orthogonal).gaussians(g)
    np.testing.assert_allclose(
        colors(found, directions() @ orthogonal.T), colors(g, directions()), atol=1e-5
    )  # float32


def test_harmonics_stay_where_axes_only_become_longer():
    g = random_gaussians(30, 3)
    np.testing.assert_allclose(Stretch(np.diag([1.0, 3, 0.5])).gaussians(g).sh, g.sh, atol=1e-5)  # float32


def test_half_axes_of_gaussians_that_lie_along_the_axes_grow_with_them():
    g = random_gaussians(1, 0)
    g.quats[:], g.log_scales[:] = (1, 0, 0, 0), np.log([1.0, 2.0, 3.0])
    found = Stretch(np.diag([4.0, -1, 1])).gaussians(g)
    np.testing.assert_allclose(np.exp(found.log_scales), [[4, 3, 2]], rtol=1e-6)
