import numpy as np

from splatree.maths.covariance import axes_from_gaussians, covariances_from_gaussians


def test_eigenvalues_are_the_squared_scales() -> None:
    rng = np.random.default_rng(2)
    quats, log_scales = rng.normal(size=(50, 4)), rng.uniform(-3, 1, (50, 3))
    eigenvalues = np.linalg.eigvalsh(covariances_from_gaussians(quats, log_scales))
    np.testing.assert_allclose(eigenvalues, np.sort(np.exp(2 * log_scales), axis=1), rtol=1e-9)


def test_axes_are_as_long_as_the_scales() -> None:
    rng = np.random.default_rng(3)
    quats, log_scales = rng.normal(size=(50, 4)), rng.uniform(-30, 30, (50, 3))
    lengths = np.linalg.norm(axes_from_gaussians(quats, log_scales), axis=1)
    np.testing.assert_allclose(lengths, np.exp(log_scales), rtol=1e-12)
