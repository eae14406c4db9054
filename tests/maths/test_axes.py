import numpy as np
import pytest

from splatree.maths.axes import AXES, harmonic_signs, quat_signs, signs_between
from splatree.maths.covariance import covariances_from_gaussians
from splatree.maths.harmonics import basis_from_directions


@pytest.mark.parametrize("target", AXES)
def test_a_mirrored_gaussian_is_the_mirror_of_the_gaussian(target):
    """S Σ S is the covariance of the changed quaternion, and the colour seen along S d that seen along d before."""
    rng = np.random.default_rng(0)
    quats, log_scales, directions = (
        rng.standard_normal((9, 4)),
        rng.standard_normal((9, 3)),
        rng.standard_normal((9, 3)),
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    signs = signs_between("RDF", target)
    mirrored = covariances_from_gaussians(quats * quat_signs(signs), log_scales)
    wanted = covariances_from_gaussians(quats, log_scales) * signs[:, None] * signs
    np.testing.assert_allclose(mirrored, wanted, atol=1e-12)
    seen = basis_from_directions(directions * signs, 3) * harmonic_signs(signs, 3)
    np.testing.assert_allclose(seen, basis_from_directions(directions, 3), atol=1e-12)


def test_frames_are_named_by_where_their_axes_point():
    assert signs_between("RDF", "RUB").tolist() == [1, -1, -1]
    assert signs_between("RDF", "LUF").tolist() == [-1, -1, 1]
    assert (AXES.index("RUB") + 1, AXES.index("RDF") + 1, AXES.index("LUF") + 1) == (4, 6, 7)  # the numbers of SPZ
