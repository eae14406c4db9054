from functools import partial

import numpy as np
import pytest

from splatree import Gaussians
from splatree.kernels.cpu.build import visibility
from splatree.kernels.reference import visibility as reference
from splatree.simplify.visibility import VISIBILITY_MIN, pixel_size_of, visibilities_of

from ..scenes import cloud

opaque = partial(cloud, log_scales=("normal", -1.0, 0.7), logits=("normal", 0.0, 2.0), sh=0.0)

OPAQUE = 6.0
"""Logit of an opacity of 0.998."""


def balls(means: list[list[float]], log_scale: float = 0.0) -> Gaussians:
    n = len(means)
    return Gaussians(
        np.array(means, np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.full((n, 3), log_scale, np.float32),
        np.full(n, OPAQUE, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )


@pytest.mark.parametrize("n", [1, 2, 25])
@pytest.mark.parametrize("reach", [np.inf, 3.0])
@pytest.mark.parametrize("cell", [0.2, 1.0])
def test_visibilities_are_those_of_the_reference(n, reach, cell, isa):
    g = opaque(n, seed=n)
    middle = np.array([0.1, -0.2, 0.3])
    found = visibility.measure_visibilities(g, visibility.Sight(middle, cell, reach, 64))
    expected = reference.measure_visibilities(g, middle, cell=cell, reach=reach, width=64)
    # Float32 lengths of up to 64 cells, good to 1e-5 of a cell; a cell that lies on the edge of a splat within that weighs e^-2
    # of up to a few hundred.
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_alone_all_is_seen():
    g = balls([[0, 0, 0]])
    assert reference.measure_visibilities(g, np.zeros(3), cell=1.0, reach=np.inf, width=64) == pytest.approx(1)


def test_what_hides_is_forgotten_with_the_distance():
    """A ball between two on a diagonal is hidden along it; reach lets the light recover by 1 − e^(−distance/reach)."""
    g = balls([[0, 0, 0], [-12, -12, -12], [12, 12, 12]], log_scale=1.0)
    hidden = reference.measure_visibilities(g, np.zeros(3), cell=1.0, reach=np.inf, width=64)
    recovered = reference.measure_visibilities(g, np.zeros(3), cell=1.0, reach=5.0, width=64)
    assert hidden[0] < hidden[1] == pytest.approx(hidden[2])
    assert recovered[0] > 1 - np.exp(-20 / 5)


def test_of_the_one_behind_is_seen_what_the_other_lets_through():
    """Two balls nearly at one place, σ = 5 cells: each is in front on one way along every axis, and behind on the other."""
    g = balls([[0, 0, 0], [1e-3, 2e-3, 4e-3]], log_scale=np.log(5))
    half = Gaussians(g.means, g.quats, g.log_scales, np.zeros(2, np.float32), g.sh)  # opacity ½
    seen = reference.measure_visibilities(half, np.zeros(3), cell=1.0, reach=np.inf, width=64)
    # ∫ G (1 − α G) / ∫ G within 2 σ, with the opacity that keeps the mass under the cell's filter.
    alpha = 0.5 * 25 / (25 + 0.3)
    behind = 1 - alpha / 2 * (1 - np.exp(-4)) / (1 - np.exp(-2))
    # Sums over 300 cells for integrals: the rim, of weight e^-2, is good to about a cell in fifty.
    np.testing.assert_allclose(seen, np.sqrt((1 + behind**2) / 2), rtol=2e-3)


def test_result_does_not_depend_on_threads_or_on_where_the_scene_lies():
    g = opaque(3000, seed=4, spread=5.0)
    results = [visibilities_of(g, threads=t) for t in (1, 2, 4)]
    for other in results[1:]:
        np.testing.assert_array_equal(results[0], other)
    moved = Gaussians(g.means + np.float32(64), g.quats, g.log_scales, g.logit_opacities, g.sh)
    # Means of up to 80 are rounded to 4e-6, of cells of about 1: few cells change sides.
    np.testing.assert_allclose(visibilities_of(moved), results[0], atol=2e-3)


@pytest.mark.parametrize("log_scale", [-80.0, 80.0])
@pytest.mark.parametrize("spread", [0.0, 1e-20, 1e15])
def test_any_finite_scene_has_visibilities(log_scale, spread):
    g = opaque(20, seed=5, spread=spread)
    g = Gaussians(g.means, g.quats, np.full_like(g.log_scales, log_scale), g.logit_opacities, g.sh)
    seen = visibilities_of(g)
    assert np.all((seen >= VISIBILITY_MIN) & (seen <= 1))


def test_pixel_size_is_the_median_size():
    g = opaque(3, seed=8)
    scales = np.sort(np.exp(g.log_scales.astype(np.float64)), axis=1)
    assert pixel_size_of(g) == pytest.approx(np.median(np.sqrt(scales[:, 1] * scales[:, 2])), rel=1e-5)
