import numpy as np

from splatree.maths.harmonics import basis_from_directions, colors_from_harmonics, rotations_of_harmonics
from splatree.maths.rotations import matrices_from_quats


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


def random_rotations(count: int) -> np.ndarray:
    return matrices_from_quats(np.random.default_rng(3).normal(size=(count, 4)))


def test_turned_harmonics_show_in_turned_directions_what_they_showed() -> None:
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for R in random_rotations(5):
        D = block_diagonal(rotations_of_harmonics(R, 3))
        before = basis_from_directions(directions, 3)
        after = basis_from_directions(directions @ R.T, 3) @ D  # of R d
        np.testing.assert_allclose(after, before, atol=1e-13)  # some ten roundings of float64


def test_rotations_of_harmonics_are_a_group_of_orthogonal_matrices() -> None:
    for R, S in zip(random_rotations(5), random_rotations(10)[5:], strict=True):
        for a, b, ab in zip(*(rotations_of_harmonics(M, 3) for M in (R, S, R @ S)), strict=True):
            np.testing.assert_allclose(a @ b, ab, atol=1e-13)
            np.testing.assert_allclose(a.T @ a, np.eye(len(a)), atol=1e-13)
    for identity in rotations_of_harmonics(np.eye(3), 3):
        np.testing.assert_allclose(identity, np.eye(len(identity)), atol=1e-14)


def block_diagonal(blocks: list[np.ndarray]) -> np.ndarray:
    """The DC's 1 and the blocks along the diagonal."""
    D = np.eye(16)
    for degree, block in enumerate(blocks, start=1):
        D[degree**2 : (degree + 1) ** 2, degree**2 : (degree + 1) ** 2] = block
    return D
