"""The stages of training on a device against their definitions, with the bands of the processor's tests."""

from dataclasses import fields, replace

import numpy as np
import pytest

import splatree as st
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.stages import Stages
from splatree.kernels.devices import stages_of
from splatree.scene.gradients import Moments

from ..scenes import cloud
from .conftest import SCENES
from .simt_device import Emulator
from .test_backward import COLUMNS, MODES, drawn, far_off, small, upstream_of, view_of
from .test_loss import GAIN, pictures
from .test_optimise import copied, derivatives, rates_of

reference, cpu = stages_of("reference"), stages_of("cpu")


def crowd(n: int, seed: int = 1) -> st.Gaussians:
    """Enough translucent and opaque splats that tiles have more than one batch and pixels are finished."""
    return cloud(n, seed, degree=1, sh=0.3, log_scales=("normal", -1.6, 0.4), spread=0.6, logits=("normal", 0.5, 1.5))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("given", ["colour", "everything"])
def test_sums_of_splats_are_those_of_the_reference(mode: str, given: str, device: Device) -> None:
    view, g = view_of(mode), crowd(90)
    upstream = upstream_of(view, g if given == "everything" else None)
    splats, bins, picture = drawn(reference, g, view)
    assert np.diff(bins.tile_start).max() > 64  # three batches
    found = Stages(device).blend_backward(splats, bins, view, picture, upstream)
    wanted = reference.blend_backward(splats, bins, view, picture, upstream)
    for f in fields(wanted):
        a, b = getattr(found, f.name), getattr(wanted, f.name)
        assert (a is None) == (b is None)
        if b is not None:  # float32, as of the processor (tests/kernels/test_backward.py)
            assert far_off(a, b) < 1e-4, f.name


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("degree", range(4))
def test_derivatives_of_rows_are_those_of_the_reference(mode: str, degree: int, device: Device) -> None:
    view, g = view_of(mode), small(40, degree=degree)
    upstream = upstream_of(view, g)
    splats, bins, picture = drawn(reference, g, view)
    sums = reference.blend_backward(splats, bins, view, picture, upstream)
    for drawn_degree in {degree, 0}:
        seen = replace(view, sh_degree=drawn_degree)
        found, wanted = (stages.project_backward(g, splats, sums, seen) for stages in (Stages(device), reference))
        np.testing.assert_array_equal(found.rows, wanted.rows)
        for name in COLUMNS:
            assert far_off(getattr(found, name), getattr(wanted, name)) < 1e-4, name


@pytest.mark.parametrize("name", SCENES)
def test_hard_scenes_are_as_near_to_the_definition_as_on_the_processor(name: str, device: Device) -> None:
    g, seen_by = SCENES[name]()
    view = st.View(seen_by, background=(0.2, 0.3, 0.1))
    upstream = upstream_of(view)
    splats, bins, picture = drawn(cpu, g, view)
    sums = [s.blend_backward(splats, bins, view, picture, upstream) for s in (Stages(device), cpu)]
    # A pixel at τ, or at its last splat, may fall either way: it moves the sums of one splat by a share of a pixel.
    close = np.abs(sums[0].moments - sums[1].moments) <= 1e-3 * np.abs(sums[1].moments).max(initial=0) + 1e-6
    assert (~close).sum() <= 0.01 * close.size
    if not len(splats):
        return
    found, fast, wanted = (s.project_backward(g, splats, sums[1], view) for s in (Stages(device), cpu, reference))
    for column in COLUMNS:
        a, b, c = (getattr(derivatives, column) for derivatives in (found, fast, wanted))
        assert np.isfinite(a).all()
        # Those of needles lose digits in float32, on either.
        assert far_off(a, c) <= 4 * far_off(b, c) + 1e-4


def test_what_lies_behind_a_wall_takes_no_derivative(device: Device) -> None:
    view, g = view_of(width=32, height=16), crowd(120)
    g.log_scales[:4], g.logit_opacities[:4] = 2.5, 9
    g.means[:4] = view.camera.position + view.camera.camera_from_world[2, :3]  # before all others
    splats, bins, picture = drawn(cpu, g, view)
    sums = Stages(device).blend_backward(splats, bins, view, picture, upstream_of(view))
    hidden = splats.rows >= 4
    assert hidden.sum() > 50
    assert not sums.moments[hidden].any()
    assert not sums.colors[hidden].any()
    assert sums.colors[~hidden].any()


def test_schedule_changes_no_bit_of_the_sums(emulator: Emulator) -> None:
    view, g = view_of(), crowd(60)
    splats, bins, picture = drawn(cpu, g, view)
    found = []
    for seed in (1, 2, 3):
        emulator.seed(seed)
        sums = Stages(emulator).blend_backward(splats, bins, view, picture, upstream_of(view))
        found.append(sums.moments.tobytes() + sums.colors.tobytes())
    assert found[0] == found[1] == found[2]


def test_an_empty_scene_has_no_derivatives(device: Device) -> None:
    view, g = view_of(), st.Gaussians.empty(1)
    splats, bins, picture = drawn(cpu, g, view)
    sums = Stages(device).blend_backward(splats, bins, view, picture, upstream_of(view))
    assert sums.moments.shape == (0, 6)
    assert len(Stages(device).project_backward(g, splats, sums, view).rows) == 0


def test_tapers_are_refused(device: Device) -> None:
    view, g = replace(view_of(), threshold=0.1, pixels="taper"), small()
    splats, bins, picture = drawn(cpu, g, view)
    with pytest.raises(st.InputError, match="backward: found pixels 'taper'"):
        Stages(device).blend_backward(splats, bins, view, picture, upstream_of(view))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (20, 37), (33, 5)])
@pytest.mark.parametrize(("is_masked", "ssim_weight"), [(False, 0.2), (True, 0.2), (True, 1.0), (False, 0.0)])
def test_the_loss_is_that_of_the_reference(
    size: tuple[int, int], is_masked: bool, ssim_weight: float, device: Device
) -> None:
    image, photo, mask = pictures(*size, seed=7)
    options = {"ssim_weight": ssim_weight, "mask": mask if is_masked else None}
    found, wanted = (s.photo_loss(image, photo, GAIN, **options) for s in (Stages(device), reference))
    # As of the processor (tests/kernels/test_loss.py).
    assert found.value == pytest.approx(wanted.value, rel=1e-5, abs=1e-6)
    assert np.abs(found.image - wanted.image).max() <= 2e-4 * max(np.abs(wanted.image).max(), 1e-12)
    np.testing.assert_allclose(found.errors, wanted.errors, atol=1e-6)
    np.testing.assert_allclose(found.products, wanted.products, rtol=1e-5)
    np.testing.assert_allclose(found.squares, wanted.squares, rtol=1e-5)


def test_schedule_changes_no_bit_of_the_loss(emulator: Emulator) -> None:
    image, photo, mask = pictures()
    found = []
    for seed in (1, 2):
        emulator.seed(seed)
        loss = Stages(emulator).photo_loss(image, photo, GAIN, mask=mask)
        found.append((loss.value, loss.image.tobytes(), loss.squares.tobytes()))
    assert found[0] == found[1]


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("ramp_steps", [1, 16])
def test_steps_are_those_of_the_reference(degree: int, ramp_steps: int, device: Device) -> None:
    start, k = cloud(50, degree=degree), (degree + 1) ** 2
    results = []
    for stages in (reference, Stages(device)):
        g, moments = copied(start), Moments.zeros(50, k)
        for i in range(6):
            rows = np.flatnonzero(np.random.default_rng(i).random(50) > 0.4).astype(np.int32)
            stages.step(g, derivatives(rows, degree, i), moments, rates_of(moments), ramp_steps=ramp_steps)
        results.append((g, moments))
    (a, of_a), (b, of_b) = results
    np.testing.assert_array_equal(of_a.steps, of_b.steps)
    np.testing.assert_allclose(of_a.values, of_b.values, rtol=2e-4, atol=1e-9)
    for f in fields(a):
        # Six steps of at most 1e-2 each, in float32.
        np.testing.assert_allclose(getattr(b, f.name), getattr(a, f.name), atol=2e-6, rtol=1e-6)


def test_a_row_with_a_derivative_that_is_not_finite_makes_no_step(device: Device) -> None:
    g, moments, rows = cloud(3, degree=0), Moments.zeros(3, 1), np.array([0, 1, 2], np.int32)
    found, before = derivatives(rows, 0), copied(g)
    means = found.means.copy()
    means[1, 2] = np.inf
    moments.steps[2] = 65535
    Stages(device).step(g, replace(found, means=means), moments, np.full(16, 1e-3, np.float32))
    assert moments.steps.tolist() == [1, 0, 65535]
    for f in fields(g):
        np.testing.assert_array_equal(getattr(g, f.name)[1], getattr(before, f.name)[1])
    Stages(device).step(g, derivatives(np.zeros(0, np.int32), 0), moments, np.full(16, 1e-3, np.float32))
    assert moments.steps.tolist() == [1, 0, 65535]
