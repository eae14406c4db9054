"""Training and refinement on a GPU: what a user calls, on the emulator, and on the GPU if there is one."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import splatree as st
from splatree.cli.main import main
from splatree.errors import DeviceError
from splatree.io.cameras.files import read_cameras
from splatree.kernels.cuda import library as cuda_library
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.stages import Stages
from splatree.kernels.devices import stages_of
from splatree.train.densify import Rows, Sightings
from splatree.train.schedule import rates
from splatree.train.step import Drawing, learn
from splatree.train.targets import Target

from ..kernels.simt_device import Emulator
from ..kernels.test_backward import far_off
from ..scenes import camera, cloud, surface

FEW = st.TrainOptions(iterations=2, max_gaussians=200, held_out=4, score=False)


def steps_on(stages: object, mode: str, count: int) -> tuple[Rows, Sightings, list[float]]:
    """Steps of the loop of training, on pictures of noise: what they leave, and their losses."""
    rows = Rows.beginning(cloud(80, 2, degree=1, spread=0.6, log_scales=("normal", -2.0, 0.4)))
    drawing = Drawing(stages, mode, 1, 0)  # type: ignore[arg-type]
    mask = np.random.default_rng(1).random((32, 48)) > 0.1
    seen, losses = Sightings.none(80), []
    for i in range(count):
        photo = np.random.default_rng(i).integers(0, 256, (32, 48, 3)).astype(np.uint8)
        target = Target(camera(48, 32, distance=3.0), photo, mask)
        losses.append(learn(rows, seen, target, np.eye(3, 4), rates(0.5, 1.0, rows.moments, 4), 1.0, drawing)[0].value)
    return rows, seen, losses


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_whole_steps_are_those_of_the_processor(mode: str, device: Device) -> None:
    """Three steps of the loop of training; the optimiser's moments are running means of the derivatives."""
    results = [steps_on(stages, mode, 3) for stages in (Stages(device), stages_of("cpu"))]
    (found, of_found, losses), (wanted, of_wanted, wanted_losses) = results
    np.testing.assert_allclose(losses, wanted_losses, rtol=1e-5)
    np.testing.assert_array_equal(found.moments.steps, wanted.moments.steps)
    assert found.moments.steps.max() == 3
    # Derivatives within 1e-4 of the largest (tests/kernels/test_cuda_backward.py), of scenes that differ as much.
    assert far_off(found.moments.values[:, 0], wanted.moments.values[:, 0]) < 1e-3
    assert far_off(of_found.errors, of_wanted.errors) < 1e-3
    for field in fields(st.Gaussians):
        # A step moves a number by the sign of a derivative that is all rounding: few, by a rate of 1e-2 at most.
        a, b = (getattr(rows.gaussians, field.name) for rows in (found, wanted))
        assert np.isclose(a, b, rtol=1e-5, atol=1e-5).mean() > 0.95
        np.testing.assert_allclose(a, b, atol=6e-2)


def test_a_device_trains_the_scene_of_the_processor(photographs: Path, at_hand: Device) -> None:
    found, wanted = (st.train(photographs, FEW, device=device) for device in ("cuda", "cpu"))  # type: ignore[arg-type]
    seen_by = read_cameras(photographs)[0]
    # As of the processor and the definitions (test_run.py).
    assert st.psnr(st.render(found.scene, seen_by).image, st.render(wanted.scene, seen_by).image) > 60


def test_schedule_changes_no_bit_of_a_step(emulator: Emulator) -> None:
    found = []
    for seed, num_resident in ((1, 1), (2, 3)):
        emulator.seed(seed)
        emulator.interleave(num_resident)
        rows, _, losses = steps_on(Stages(emulator), "classic", 2)
        found.append((losses, [getattr(rows.gaussians, field.name).tobytes() for field in fields(st.Gaussians)]))
    assert found[0] == found[1]


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_inner_nodes_learn_on_a_device_what_they_learn_on_the_processor(mode: str, at_hand: Device) -> None:
    scene = st.build_lod(st.Scene.flat(surface(300, degree=1), mode=mode))  # type: ignore[arg-type]
    views = [camera(48, 32, distance=d) for d in (9.0, 14.0, 20.0)]
    options = st.RefineOptions(iterations=6)
    found, wanted = (st.refine(scene, options, cameras=views, device=device) for device in ("cuda", "cpu"))  # type: ignore[arg-type]
    np.testing.assert_allclose(found.before, wanted.before, atol=1e-2)
    np.testing.assert_allclose(found.after, wanted.after, atol=2e-2)
    assert found.num_learned == pytest.approx(wanted.num_learned, abs=3)


def test_without_a_gpu_nothing_is_read_before_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from splatree.kernels.cuda.device import open_device

    monkeypatch.setattr(cuda_library, "LIBRARY_NAMES", ("libnothing.so",))
    open_device.cache_clear()
    with pytest.raises(DeviceError, match=r"no GPU driver: libnothing\.so was not found; .* or use device 'cpu'"):
        st.train(tmp_path / "nothing", FEW, device="cuda")
    assert main(["train", str(tmp_path), "-o", str(tmp_path / "a.splatree"), "--device", "cuda"]) != 0
    assert "no GPU driver" in capsys.readouterr().err
