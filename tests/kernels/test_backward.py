"""Derivatives: the reference against differences of the picture, and the kernels against the reference."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as strategy

import splatree as st
from splatree.kernels.cpu import _core
from splatree.kernels.devices import stages_of
from splatree.scene.gradients import GaussianGradients, PictureGradients, SplatGradients

from ..scenes import camera, cloud

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
MODES = ("classic", "antialiased")
reference, cpu = stages_of("reference"), stages_of("cpu")


def small(n=12, seed=3, degree=1, logits=("normal", -1.0, 0.7)):
    return cloud(n, seed, degree=degree, sh=0.3, log_scales=("normal", -2.0, 0.4), spread=0.6, logits=logits)


def view_of(mode="classic", width=40, height=28, threshold=1 / 255):
    seen = camera().resized(width, height)
    K = seen.K.copy()
    K[0, 2] += 3.7  # an off-centre principal point
    return st.View(replace(seen, K=K), mode=mode, background=(0.2, 0.3, 0.1), threshold=threshold)


def drawn(stages, g, view):
    splats = stages.project(g, None, np.arange(len(g), dtype=np.int32), view)
    bins = stages.bin(splats, view)
    return splats, bins, stages.blend(splats, bins, view)


def upstream_of(view, g=None, seed=0):
    """By the colour; with Gaussians ``g`` also by alpha and depth, and with errors."""
    rng, size = np.random.default_rng(seed), (view.camera.height, view.camera.width)
    image = rng.normal(size=(*size, 3)).astype(np.float32)
    if g is None:
        return PictureGradients(image)
    # Depth is divided by alpha, which float32 rounds to 6e-8: it is asked for where there is some.
    is_covered = drawn(reference, g, view)[2].alpha > 0.1
    return PictureGradients(
        image,
        rng.normal(size=size).astype(np.float32),
        (0.1 * is_covered * rng.normal(size=size)).astype(np.float32),
        rng.random(size).astype(np.float32),
    )


def backward(stages, g, view, upstream, threads=0) -> tuple[SplatGradients, GaussianGradients]:
    splats, bins, picture = drawn(stages, g, view)
    sums = stages.blend_backward(splats, bins, view, picture, upstream, threads=threads)
    return sums, stages.project_backward(g, splats, sums, view, threads=threads)


def loss_of(g, view, upstream):
    picture = drawn(reference, g, view)[2]
    parts = ((picture.image, upstream.image), (picture.alpha, upstream.alpha), (picture.depth, upstream.depth))
    return sum(float(np.sum(a.astype(np.float64) * b)) for a, b in parts if b is not None)


def far_off(found, wanted):
    """The largest difference, relative to the largest of its kind."""
    return np.abs(found.astype(np.float64) - wanted).max() / max(np.abs(wanted).max(), 1e-30)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("degree", range(4))
def test_the_reference_is_the_slope_of_the_picture(mode, degree):
    # A threshold of 1e-9 and translucent splats: no step lies within the differences.
    view, g = view_of(mode, threshold=1e-9), small(degree=degree)
    upstream = upstream_of(view, g)
    found = backward(reference, g, view, upstream)[1]
    rng = np.random.default_rng(degree)
    for name in COLUMNS:
        column, slopes = getattr(g, name), getattr(found, name)
        for entry in rng.integers(len(found.rows), size=5):
            place = (found.rows[entry], *(rng.integers(size) for size in column.shape[1:]))
            ends = []
            for sign in (-1, 1):
                moved = column.copy()
                moved[place] += sign * 2e-3
                ends.append((loss_of(replace(g, **{name: moved}), view, upstream), float(moved[place])))
            slope = (ends[1][0] - ends[0][0]) / (ends[1][1] - ends[0][1])
            # Pictures are float32: 1e-7 of the loss over a step of 4e-3.
            assert slope == pytest.approx(slopes[(entry, *place[1:])], abs=float(3e-4 * np.abs(slopes).max()))


@pytest.mark.parametrize("isa", _core.isas())
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("degree", range(4))
def test_the_kernels_agree_with_the_reference(mode, degree, isa):
    view, g = view_of(mode, 70, 45, threshold=1e-9), small(60, degree=degree, logits=("normal", 0.0, 2.0))
    upstream = upstream_of(view, g)
    sums, found = backward_on(isa, g, view, upstream)
    expected_sums, expected = backward(reference, g, view, upstream)
    np.testing.assert_array_equal(found.rows, expected.rows)
    for name in ("moments", "colors", "depths", "weights", "errors"):
        assert far_off(getattr(sums, name), getattr(expected_sums, name)) < 1e-4, name
    for name in COLUMNS:
        assert far_off(getattr(found, name), getattr(expected, name)) < 1e-4, name


def backward_on(isa, g, view, upstream):
    before = _core.isa()
    _core.use_isa(isa)
    try:
        return backward(cpu, g, view, upstream)
    finally:
        _core.use_isa(before)


@settings(max_examples=20, deadline=None)
@given(seed=strategy.integers(0, 2**31), mode=strategy.sampled_from(MODES), degree=strategy.integers(0, 3))
def test_threads_do_not_change_a_bit(seed, mode, degree):
    view, g = view_of(mode, 90, 50), small(300, seed=seed, degree=degree)
    upstream = upstream_of(view, seed=seed)
    one = backward(cpu, g, view, upstream, threads=1)
    for threads in (2, 7):
        for a, b in zip(one, backward(cpu, g, view, upstream, threads=threads), strict=True):
            for name, value in vars(a).items():
                np.testing.assert_array_equal(value, getattr(b, name))


@settings(max_examples=10, deadline=None)
@given(seed=strategy.integers(0, 2**31))
def test_permuted_rows_have_the_same_derivatives(seed):
    view, g = view_of(width=90, height=50), small(200, seed=seed)
    order = np.random.default_rng(seed).permutation(len(g)).astype(np.uint32)
    upstream = upstream_of(view, seed=seed)
    rows = np.arange(len(g), dtype=np.int32)
    results = []
    for columns, ids in ((g, None), (g.take(order), order)):
        splats = cpu.project(columns, ids, rows, view)
        bins = cpu.bin(splats, view)
        picture = cpu.blend(splats, bins, view)
        sums = cpu.blend_backward(splats, bins, view, picture, upstream)
        found = cpu.project_backward(columns, splats, sums, view)
        names = found.rows if ids is None else ids[found.rows]
        results.append((np.sort(names), [getattr(found, name)[np.argsort(names)] for name in COLUMNS]))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    for a, b in zip(results[0][1], results[1][1], strict=True):
        np.testing.assert_array_equal(a, b)


def test_derivatives_are_linear_in_those_of_the_picture():
    view, g = view_of(width=90, height=50), small(200)
    one, two = upstream_of(view, seed=1), upstream_of(view, seed=2)
    both = PictureGradients(one.image + 2 * two.image)
    a, b, c = (backward(cpu, g, view, upstream)[1] for upstream in (one, two, both))
    for name in COLUMNS:
        assert far_off(getattr(c, name), getattr(a, name) + 2.0 * getattr(b, name)) < 1e-4


def test_a_scaled_world_has_scaled_derivatives():
    view, g = view_of(width=90, height=50), small(200)
    pose = view.camera.camera_from_world.copy()
    pose[:3, 3] *= 4
    larger = replace(g, means=4 * g.means, log_scales=(g.log_scales.astype(np.float64) + np.log(4)).astype(np.float32))
    far = replace(view, camera=replace(view.camera, camera_from_world=pose, near=4 * view.camera.near))
    upstream = upstream_of(view)
    a, b = backward(cpu, g, view, upstream)[1], backward(cpu, larger, far, upstream)[1]
    assert far_off(4 * b.means, a.means) < 1e-4
    assert far_off(b.log_scales, a.log_scales) < 1e-4


def test_the_derivative_of_a_quaternion_is_across_it():
    view, g = view_of(), small(100)
    found = backward(cpu, g, view, upstream_of(view))[1]
    along = np.abs(np.sum(found.quats * g.quats[found.rows], axis=1))
    lengths = np.linalg.norm(found.quats, axis=1) * np.linalg.norm(g.quats[found.rows], axis=1)
    assert (along <= 1e-5 * lengths.max()).all()


def test_what_is_not_drawn_has_no_derivative():
    """A row out of view is not in the list; one behind opaque walls has zeros; a channel clipped at 0 takes none."""
    view, g = view_of(), small(3, degree=0)
    forward = view.camera.camera_from_world[2, :3]
    eye = view.camera.position
    means = np.stack([eye + 3 * forward, eye + 6 * forward, eye - 3 * forward]).astype(np.float32)
    walls = replace(
        g,
        means=means,
        log_scales=np.full((3, 3), 2.0, np.float32),
        logit_opacities=np.full(3, 12.0, np.float32),
        sh=np.full((3, 1, 3), [[-9.0, 1.0, 1.0]], np.float32),
    )
    # Three walls of opacity 0.99 leave T = 1e-6: the last of four is hidden.
    doubled = st.Gaussians.concatenate([walls.take(np.array([0, 0, 0, 1, 2]))])
    _, found = backward(cpu, doubled, view, upstream_of(view))
    assert found.rows.tolist() == [0, 1, 2, 3]
    hidden = np.array([3])
    for name in COLUMNS:
        assert not getattr(found, name)[hidden].any()
    assert not found.sh[:, 0, 0].any()
    # Opacity is held at 0.99 near the middle: colours take derivatives, shapes there do not.
    assert found.sh[0, 0, 1] != 0


def test_nothing_is_ever_nan():
    view = view_of(width=64, height=48)
    g = small(6, degree=1)
    eye = view.camera.position.astype(np.float32)
    hostile = replace(
        g,
        means=np.concatenate([g.means[:5], eye[None]]),
        log_scales=np.array(
            [[-46, -46, -46], [46, 46, 46], [-46, 2, -46], [1, -40, -40], [-2, -2, -2], [-2, -2, -2]], np.float32
        ),
        logit_opacities=np.array([90, 90, 90, 90, -90, 3], np.float32),
        quats=np.concatenate([g.quats[:4], np.zeros((1, 4), np.float32), 1e18 * g.quats[5:]]),
    )
    for mode in MODES:
        found = backward(cpu, hostile, replace(view, mode=mode), upstream_of(view))[1]
        for name in COLUMNS:
            assert np.isfinite(getattr(found, name)).all(), (mode, name)


def test_tapers_are_refused():
    view, g = replace(view_of(), threshold=0.1, pixels="taper"), small()
    with pytest.raises(st.InputError, match="backward: found pixels 'taper'"):
        backward(cpu, g, view, upstream_of(view))


def test_an_empty_scene_has_no_derivatives():
    view = view_of()
    sums, found = backward(cpu, st.Gaussians.empty(1), view, upstream_of(view))
    assert len(found.rows) == 0 and sums.moments.shape == (0, 6)
