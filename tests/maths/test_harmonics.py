import numpy as np

from splatree.maths.harmonics import basis_from_directions, colors_from_harmonics


def test_basis_is_orthonormal_on_the_sphere() -> None:
    # Gauss-Legendre in cos θ and equal steps in φ integrate polynomials of degree 6 exactly.
    nodes, weights = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * (2 * np.pi / 16)
    z, angle = np.meshgrid(nodes, phi, indexing="ij")
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1).reshape(-1, 3)
    area = np.repeat(weights, 16) * (2 * np.pi / 16)
    Y = basis_from_directions(directions, 3)
    # The published constants are rounded to about 1e-16.
    np.testing.assert_allclose(Y.T @ (area[:, None] * Y), np.eye(16), atol=1e-12)


def test_lower_degree_is_a_prefix() -> None:
    directions = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
    np.testing.assert_array_equal(basis_from_directions(directions, 1), basis_from_directions(directions, 3)[:, :4])


def test_colour_of_zero_harmonics_is_grey_and_never_negative() -> None:
    sh = np.zeros((2, 4, 3))
    sh[1, 0] = -10
    colors = colors_from_harmonics(sh, np.array([[0.0, 0, 1]] * 2), 1)
    np.testing.assert_array_equal(colors, [[0.5] * 3, [0.0] * 3])
