import numpy as np

from splatree.maths.rotations import matrices_from_quats, matrix_from_angles, quat_from_matrix


def test_matrices_are_rotations_whatever_the_length() -> None:
    rng = np.random.default_rng(1)
    quats = rng.normal(size=(200, 4)) * 10.0 ** rng.uniform(-10, 10, (200, 1))
    R = matrices_from_quats(quats)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-13)  # a few roundings of float64


def test_half_angle_about_an_axis() -> None:
    angle = 0.7
    R = matrices_from_quats(np.array([[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]]))[0]
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(R, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-15)


def test_zero_quaternion_is_no_rotation() -> None:
    np.testing.assert_array_equal(matrices_from_quats(np.zeros((1, 4)))[0], np.eye(3))


def test_quaternion_of_a_matrix_gives_the_matrix_back() -> None:
    rng = np.random.default_rng(2)
    half_turns = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0.6, 0, 0.8], [1, 0, 0, 0]])  # where traces say nothing
    for R in matrices_from_quats(np.concatenate([rng.normal(size=(50, 4)), half_turns])):
        q = quat_from_matrix(R)
        assert q[0] >= 0
        np.testing.assert_allclose(np.linalg.norm(q), 1, atol=1e-14)
        np.testing.assert_allclose(matrices_from_quats(q[None])[0], R, atol=1e-13)  # a few roundings of float64


def test_angles_turn_about_x_then_y_then_z() -> None:
    x, y, z = np.eye(3)
    np.testing.assert_allclose(matrix_from_angles((90, 0, 0)) @ y, z, atol=1e-15)
    np.testing.assert_allclose(matrix_from_angles((0, 90, 0)) @ z, x, atol=1e-15)
    np.testing.assert_allclose(matrix_from_angles((0, 0, 90)) @ x, y, atol=1e-15)
    np.testing.assert_allclose(matrix_from_angles((90, 90, 0)) @ y, x, atol=1e-15)  # y → z about x, then z → x about y
