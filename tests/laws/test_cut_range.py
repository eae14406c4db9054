"""The cuts of a range of τ_R at once are the cuts of each τ_R alone, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatree import RenderOptions, SelectOptions
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame import select as compiled
from splatree.kernels.cpu.frame.question import limit_of, pixel_error_of
from splatree.kernels.reference import select as reference
from splatree.lod.blocks import with_blocks
from splatree.scene.view import view_of

from .test_select_kernel import PROFILES, VIEW_TESTS, random_camera, random_scene, seeds

RANGES = ((0.0, 3.0), (1.7, 8.0), (3.0, 300.0), (0.0, 1e5), (8.0, 8.0))


@settings(max_examples=40)
@given(
    seed=seeds,
    profile=st.sampled_from(PROFILES),
    view_test=st.sampled_from(VIEW_TESTS),
    ends=st.sampled_from(RANGES),
    stages=st.sampled_from([compiled, reference]),
    has_runs=st.booleans(),
)
def test_each_limit_of_a_range_draws_its_own_cut(seed, profile, view_test, ends, stages, has_runs):
    scene, camera = with_blocks(random_scene(seed), rows_per_block=16), random_camera(seed)
    view = view_of(scene, camera, RenderOptions(dilation_px2=0.3))
    runs = np.array([[0, len(scene) // 3], [len(scene) // 2, len(scene)]], np.int32) if has_runs else None
    common = scene.gaussians, scene.tree, scene.blocks, view

    def options(tau):
        return SelectOptions(pixel_error=tau, profile=profile, view_test=view_test)

    fine, coarse = ends
    found = stages.select_range(*common, options(fine), coarsest=coarse, runs=runs)
    assert (np.diff(found.rows) > 0).all()
    for tau in np.linspace(fine, coarse, 7):
        alone, _ = stages.select(*common, options(float(tau)), runs=runs)
        limit = np.float32(limit_of(float(tau), profile))
        if stages is reference:  # whose sizes are float64: the range rounds them
            limit = limit_of(float(tau), profile)
            near = np.isclose(found.enters, limit, rtol=1e-6) | np.isclose(found.leaves, limit, rtol=1e-6)
            if near.any():
                continue
        np.testing.assert_array_equal(found.at(limit), alone)


@pytest.mark.parametrize("isa", _core.isas())
@given(seed=seeds, every=st.sampled_from([2, 3, 16]))
@settings(max_examples=10)
def test_a_sample_of_the_blocks_is_that_part_of_all(isa, seed, every):
    scene, camera = with_blocks(random_scene(seed), rows_per_block=16), random_camera(seed)
    common = scene.gaussians, scene.tree, scene.blocks, view_of(scene, camera), SelectOptions(pixel_error=1.7)
    before = _core.isa()
    _core.use_isa(isa)
    try:
        whole = compiled.select_range(*common, coarsest=80.0)
        some = compiled.select_range(*common, coarsest=80.0, every=every)
    finally:
        _core.use_isa(before)
    is_looked_at = whole.rows // 16 % every == 0
    for name in ("rows", "enters", "leaves"):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[is_looked_at])


@given(value=st.floats(np.float32(1e-10), np.float32(1e30), width=32), profile=st.sampled_from(PROFILES))
def test_a_limit_is_found_again_from_its_pixel_error(value, profile):
    assert np.float32(limit_of(pixel_error_of(value, profile), profile)) == np.float32(value)
