"""The optimiser's step: the kernel against the definition, and its laws."""

from dataclasses import fields, replace

import numpy as np
import pytest

import splatree as st
from splatree.kernels.cpu import _core
from splatree.kernels.devices import stages_of
from splatree.scene.gradients import GaussianGradients, Moments

from ..scenes import cloud

reference, cpu = stages_of("reference"), stages_of("cpu")


def copied(g):
    return st.Gaussians(*(getattr(g, f.name).copy() for f in fields(g)))


def derivatives(rows, degree, seed=0):
    rng, k = np.random.default_rng(seed), (degree + 1) ** 2
    shapes = ((len(rows), 3), (len(rows), 4), (len(rows), 3), (len(rows),), (len(rows), k, 3))
    return GaussianGradients(rows, *(rng.normal(0, 1e-3, shape).astype(np.float32) for shape in shapes))


def rates_of(moments, seed=3):
    return (1e-2 * np.random.default_rng(seed).random(moments.values.shape[2])).astype(np.float32)


@pytest.mark.parametrize("isa", _core.isas())
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("ramp_steps", (1, 16))
def test_the_kernel_agrees_with_the_reference(degree, ramp_steps, isa):
    start, k = cloud(50, degree=degree), (degree + 1) ** 2
    results, before = [], _core.isa()
    _core.use_isa(isa)
    try:
        for stages in (reference, cpu):
            g, moments = copied(start), Moments.zeros(50, k)
            for i in range(20):
                rows = np.flatnonzero(np.random.default_rng(i).random(50) > 0.4).astype(np.int32)
                stages.step(g, derivatives(rows, degree, i), moments, rates_of(moments), ramp_steps=ramp_steps)
            results.append((g, moments))
    finally:
        _core.use_isa(before)
    (a, of_a), (b, of_b) = results
    np.testing.assert_array_equal(of_a.steps, of_b.steps)
    np.testing.assert_allclose(of_a.values, of_b.values, rtol=2e-4, atol=1e-9)
    for f in fields(a):
        # 20 steps of at most 1e-2 each, in float32.
        np.testing.assert_allclose(getattr(b, f.name), getattr(a, f.name), atol=2e-6, rtol=1e-6)


def test_rows_that_were_not_drawn_stay():
    g, moments = cloud(30, degree=1), Moments.zeros(30, 4)
    before, rows = copied(g), np.array([4, 9], np.int32)
    cpu.step(g, derivatives(rows, 1), moments, rates_of(moments))
    others = np.setdiff1d(np.arange(30), rows)
    for f in fields(g):
        np.testing.assert_array_equal(getattr(g, f.name)[others], getattr(before, f.name)[others])
        assert (getattr(g, f.name)[rows] != getattr(before, f.name)[rows]).all()
    assert moments.steps.tolist() == [int(i in (4, 9)) for i in range(30)]


def test_the_first_step_is_as_long_as_the_rate():
    g, moments = cloud(8, degree=0), Moments.zeros(8, 1)
    before, rows = copied(g), np.arange(8, dtype=np.int32)
    cpu.step(g, derivatives(rows, 0), moments, np.full(16, 1e-3, np.float32))
    np.testing.assert_allclose(np.abs(g.means - before.means), 1e-3, rtol=1e-3)
    cpu.step(
        fresh := copied(before), derivatives(rows, 0), Moments.zeros(8, 1), np.full(16, 1e-3, np.float32), ramp_steps=4
    )
    np.testing.assert_allclose(np.abs(fresh.means - before.means), 2.5e-4, rtol=2e-3)


@pytest.mark.parametrize("stages", (reference, cpu), ids=("reference", "cpu"))
def test_a_row_with_a_derivative_that_is_not_finite_makes_no_step(stages):
    g, moments, rows = cloud(3, degree=0), Moments.zeros(3, 1), np.arange(3, dtype=np.int32)
    found, before = derivatives(rows, 0), copied(g)
    means = found.means.copy()
    means[1, 2] = np.nan
    stages.step(g, replace(found, means=means), moments, np.full(16, 1e-3, np.float32))
    assert moments.steps.tolist() == [1, 0, 1]
    np.testing.assert_array_equal(g.means[1], before.means[1])
    assert np.isfinite(g.means).all()


def test_threads_do_not_change_a_bit():
    results = []
    for threads in (1, 3):
        g, moments, rows = cloud(5000, degree=1), Moments.zeros(5000, 4), np.arange(5000, dtype=np.int32)
        for i in range(3):
            cpu.step(g, derivatives(rows, 1, i), moments, rates_of(moments), threads=threads)
        results.append(g)
    for f in fields(results[0]):
        np.testing.assert_array_equal(getattr(results[0], f.name), getattr(results[1], f.name))


@pytest.mark.parametrize("stages", (reference, cpu), ids=("reference", "cpu"))
def test_a_view_of_nothing_changes_nothing(stages):
    g, moments = cloud(4, degree=1), Moments.zeros(4, 4)
    before = copied(g)
    stages.step(g, derivatives(np.zeros(0, np.int32), 1), moments, rates_of(moments))
    np.testing.assert_array_equal(g.means, before.means)
    assert not moments.steps.any()
