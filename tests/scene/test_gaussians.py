import numpy as np
import pytest

from splatree import Gaussians, Scene, ShapeError


def make(n: int, k: int = 4) -> Gaussians:
    rng = np.random.default_rng(n + k)
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, k, 3))
    return Gaussians(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))


def test_field_of_wrong_length_names_field_found_and_wanted():
    g = make(5)
    with pytest.raises(ShapeError, match=r"Gaussians\.quats: found shape \(4, 4\), wanted \(n 4\) with n = 5"):
        Gaussians(g.means, g.quats[:4].copy(), g.log_scales, g.logit_opacities, g.sh)


@pytest.mark.parametrize("means", [np.zeros((5, 3)), np.zeros((3, 5), np.float32).T, [[0.0, 0.0, 0.0]]])
def test_wrong_dtype_strided_or_list_is_refused(means):
    g = make(5)
    with pytest.raises(ShapeError, match=r"Gaussians\.means"):
        Gaussians(means, g.quats, g.log_scales, g.logit_opacities, g.sh)


def test_the_byte_order_of_another_machine_is_named():
    g = make(5)
    other = g.means.astype(g.means.dtype.newbyteorder())
    with pytest.raises(
        ShapeError, match="found dtype float32 in the byte order of another machine, wanted float32; convert it"
    ):
        Gaussians(other, g.quats, g.log_scales, g.logit_opacities, g.sh)


def test_number_of_harmonics_is_a_square_up_to_16():
    assert [make(2, k).sh_degree for k in (1, 4, 9, 16)] == [0, 1, 2, 3]
    for k in (2, 25):
        with pytest.raises(ShapeError, match="coefficients"):
            make(2, k)


def test_concatenate_raises_to_the_highest_degree_and_keeps_bits():
    a, b = make(3, 1), make(4, 9)
    joined = Gaussians.concatenate([a, b])
    assert len(joined) == 7
    assert joined.sh_degree == 2
    assert joined.sh[:3, :1].tobytes() == a.sh.tobytes()
    assert not joined.sh[:3, 1:].any()
    assert joined.sh[3:].tobytes() == b.sh.tobytes()
    assert joined.take(np.arange(3, 7)).means.tobytes() == b.means.tobytes()
    assert len(Gaussians.concatenate([])) == 0


def test_flat_scene_is_a_forest_of_leaves():
    scene = Scene.flat(make(6))
    assert scene.tree.num_leaves == 6
    assert scene.tree.num_levels == 1
    assert Scene.flat(Gaussians.empty()).tree.num_levels == 0


def test_opacities_scales_and_reach_are_decoded_without_overflow():
    g = Gaussians(
        np.zeros((3, 3), np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (3, 1)),
        np.float32([[0, 1, -1], [-2, -2, -2], [-1, -1, np.log(2)]]),
        np.float32([0, -1000, 1000]),
        np.zeros((3, 1, 3), np.float32),
    )
    np.testing.assert_array_equal(g.opacities(), [0.5, 0, 1])
    np.testing.assert_allclose(g.scales()[0], [1, np.e, 1 / np.e])
    np.testing.assert_allclose(g.reach(), [3 * np.e, 3 * np.exp(-2), 6])
    assert g.opacities().dtype == g.scales().dtype == g.reach().dtype == np.float64
