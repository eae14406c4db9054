import numpy as np
import pytest

from splatree.maths.harmonics import colors_from_harmonics
from splatree.maths.rotations import matrices_from_quats
from splatree.view.nodes import LOG_SCALE_MAX, pack_colors, pack_nodes, unpack_nodes

from .scenes import scene

EYE, CENTRE = np.array([0.3, -0.2, -5.0]), np.array([0.1, 0.2, 0.3])


@pytest.mark.parametrize("degree", [0, 3])
def test_a_node_keeps_what_is_drawn(degree):
    shown = scene(degree=degree)
    rows = np.arange(0, len(shown), 3, dtype=np.int32)
    found = unpack_nodes(pack_nodes(shown, rows, EYE, CENTRE))
    g = shown.gaussians.take(rows)
    np.testing.assert_allclose(found["means"], g.means - CENTRE, atol=1e-6)
    turned = matrices_from_quats(found["quats"])
    np.testing.assert_allclose(turned, matrices_from_quats(g.quats), atol=2e-4)  # 16 bits: a step of 4e-5 a component
    np.testing.assert_allclose(found["log_scales"], g.log_scales, atol=LOG_SCALE_MAX / 65535 + 1e-6)
    np.testing.assert_allclose(found["opacities"], 1 / (1 + np.exp(-g.logit_opacities.astype(float))), atol=1e-5)
    directions = g.means - EYE
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = colors_from_harmonics(g.sh, directions, degree)
    np.testing.assert_allclose(
        found["colors"], np.minimum(colors, 2), atol=1.1e-3
    )  # half a step of the 10 bits of blue
    np.testing.assert_array_equal(found["is_leaf"], shown.tree.is_leaf[rows])
    np.testing.assert_array_equal(found["depth"], shown.tree.depth[rows])


def test_colours_alone_are_those_of_the_nodes():
    shown = scene()
    rows = np.arange(50, dtype=np.int32)
    np.testing.assert_array_equal(pack_colors(shown, rows, EYE), pack_nodes(shown, rows, EYE, CENTRE)[:, 4])


def test_no_rows_are_no_words():
    assert pack_nodes(scene(), np.zeros(0, np.int32), EYE, CENTRE).shape == (0, 8)
