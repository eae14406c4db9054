"""Nodes that follow the pixel they are drawn at, in every back end (kernels/reference/project.py: follow)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as strategy

import splatree as st
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.stages import Stages
from splatree.kernels.reference.project import follow

from ..scenes import camera, gaussians
from .test_project import all_rows, seen


def curves(g: st.Gaussians, seed: int) -> np.ndarray:
    """Curves of nodes as they are built: g and h_l of any size, mass between that of one leaf and that of many."""
    rng, n = np.random.default_rng(seed), len(g)
    variances = np.exp(2 * g.log_scales.astype(np.float64))
    level = 10.0 ** rng.uniform(-3, 1, n) * variances.max(axis=1)
    peak = 10.0 ** rng.uniform(-2, 1.5, n)
    area = level + variances.mean(axis=1)
    made = np.stack([rng.uniform(0, 1, n) * peak * area, rng.uniform(0, 1, n) * peak, peak, level], axis=1)
    made[rng.random(n) < 0.3] = 0  # leaves
    return made.astype(np.float32)


def assert_near(fast, slow) -> None:
    _, i, j = np.intersect1d(fast.rows, slow.rows, return_indices=True)
    assert len(i) > 0.98 * max(len(fast), len(slow))
    # Variances are differences of the stored one and what widening added: float32 loses some digits of small ones.
    np.testing.assert_allclose(fast.opacities[i], slow.opacities[j], rtol=2e-3, atol=1e-4)
    clear = slow.opacities[j] > 1.2 / 255
    np.testing.assert_allclose(fast.half_sizes_px[i][clear], slow.half_sizes_px[j][clear], rtol=5e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_processor_follows_as_the_reference(isa, seed):
    g, seen_by = gaussians(500, seed), camera(distance=5.0)
    how, scene = curves(g, seed), st.Scene.flat(g)
    rows = all_rows(scene)
    fast = cpu.project.project(g, None, rows, seen(seen_by), curves=how)
    assert_near(fast, reference.project.project(g, None, rows, seen(seen_by), curves=how))
    assert not np.array_equal(fast.records, cpu.project.project(g, None, rows, seen(seen_by)).records)
    some = rows[::3]
    parts = cpu.project.project(g, None, some, seen(seen_by), curves=how)
    whole = fast.records[np.isin(fast.rows, some)]
    np.testing.assert_array_equal(parts.records, whole)  # whatever the place of a row in its vector


def test_the_device_follows_as_the_reference(device: Device):
    g, seen_by = gaussians(200, 4), camera(distance=5.0)
    how, rows = curves(g, 4), all_rows(st.Scene.flat(g))
    fast = Stages(device).project(g, None, rows, seen(seen_by), curves=how)
    assert_near(fast, reference.project.project(g, None, rows, seen(seen_by), curves=how))


def test_only_classic_views_follow():
    g, seen_by = gaussians(100, 5), camera()
    rows, view = all_rows(st.Scene.flat(g)), seen(seen_by, "antialiased")
    for stage in (cpu.project.project, reference.project.project):
        plain, following = stage(g, None, rows, view), stage(g, None, rows, view, curves=curves(g, 5))
        np.testing.assert_array_equal(plain.records, following.records)


@given(strategy.integers(0, 10**6), strategy.floats(-4, 4))
def test_nothing_is_drawn_larger_or_more_opaque_than_it_is_stored(seed, magnitude):
    """So every test of what can be seen, made for what is stored, holds."""
    g = gaussians(50, seed)
    how = curves(g, seed).astype(np.float64)
    scales, peak = np.exp(g.log_scales.astype(np.float64)), how[:, 2]
    stored = np.where(peak > 0, np.minimum(peak, 0.99), g.opacities())
    drawn, opacities = follow(how, how[:, 3] * 10.0**magnitude, scales, g.opacities())
    wide = np.maximum(peak / 0.99, 1) ** 0.3
    fits = (peak == 0) | np.all(scales**2 >= ((wide - 1) * how[:, 3])[:, None], axis=1)  # as nodes are stored
    assert np.all(opacities <= stored * (1 + 1e-9))
    assert np.all(drawn[fits] <= scales[fits] * (1 + 1e-9))


def test_at_its_level_and_beyond_a_node_is_drawn_as_stored():
    g = gaussians(50, 6)
    how = curves(g, 6).astype(np.float64)
    variances = np.exp(2 * g.log_scales.astype(np.float64))
    wide = np.maximum(how[:, 2] / 0.99, 1) ** 0.3
    scales = np.sqrt(wide[:, None] * variances + ((wide - 1) * how[:, 3])[:, None])
    for times in (1, 3, 1e6):
        drawn, opacities = follow(how, times * how[:, 3], scales, g.opacities())
        np.testing.assert_allclose(drawn, scales)
        follows = how[:, 2] > 0
        np.testing.assert_allclose(opacities[follows], np.minimum(how[follows, 2], 0.99))
