import numpy as np
import pytest

from splatree.kernels.cpu.codec.rotate import rotate_harmonics
from splatree.kernels.reference.rotate import rotate_harmonics as rotate_slowly
from splatree.maths.harmonics import rotations_of_harmonics
from splatree.maths.rotations import matrix_from_angles

R = matrix_from_angles((20, -130, 71))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [0, 1, 16, 9001])
def test_rotated_harmonics_are_the_reference(degree, n):
    sh = np.random.default_rng(degree).normal(size=(n, (degree + 1) ** 2, 3)).astype(np.float32)
    matrices = rotations_of_harmonics(R, degree)
    found = rotate_harmonics(sh, matrices)
    assert found.dtype == np.float32
    # Seven products of values near 1, each with a rounding of 6e-8.
    np.testing.assert_allclose(found, rotate_slowly(sh, matrices), atol=3e-6)


def test_the_bits_depend_neither_on_threads_nor_on_the_place_of_a_row():
    sh = np.random.default_rng(0).normal(size=(9001, 16, 3)).astype(np.float32)
    matrices = rotations_of_harmonics(R, 3)
    found = rotate_harmonics(sh, matrices, threads=1)
    assert rotate_harmonics(sh, matrices, threads=2).tobytes() == found.tobytes()
    assert rotate_harmonics(sh[5:77].copy(), matrices).tobytes() == found[5:77].tobytes()


def test_matrices_of_another_degree_are_refused():
    with pytest.raises(ValueError, match="a matrix for each degree"):
        rotate_harmonics(np.zeros((3, 9, 3), np.float32), rotations_of_harmonics(R, 3))
