"""Scenes that are moved to a GPU: what a user calls, on the emulator, and on the GPU if there is one."""

import gc
import json

import numpy as np
import pytest

import splatree as st
from splatree.cli import doctor
from splatree.cli.main import main
from splatree.errors import DeviceError
from splatree.kernels.cuda import device as cuda_device
from splatree.kernels.cuda import library as cuda_library
from splatree.kernels.cuda.driver import Device
from splatree.kernels.devices import DeviceName
from splatree.lod.baselines import baseline

from ..kernels.simt_device import Emulator
from ..scenes import camera, gaussians


@pytest.fixture
def scene() -> st.Scene:
    return st.build_lod(st.Scene.flat(gaussians(500, 1, degree=2)))


VIEWS = (camera(), camera(distance=12.0))
DEVICES: tuple[DeviceName, ...] = ("cuda", "cpu")
KPC = st.Wanted(contributions=True)
COARSE = st.SelectOptions(pixel_error=8)
"""Draws merged nodes in both views."""


def test_a_scene_is_drawn_where_it_is(scene: st.Scene, at_hand: Device) -> None:
    for view in VIEWS:
        found, wanted = st.render(scene, view, device="cuda"), st.render(scene, view)
        assert st.psnr(found.image, wanted.image) > 90
        assert abs(found.counters.num_selected - wanted.counters.num_selected) <= 1
        assert abs(found.counters.num_blended - wanted.counters.num_blended) <= 1e-3 * wanted.counters.num_blended


def test_a_trace_holds_what_the_processors_does(scene: st.Scene, at_hand: Device) -> None:
    found, wanted = (st.trace(scene, VIEWS[0], wanted=KPC, device=d) for d in DEVICES)
    np.testing.assert_array_equal(found.selection.rows, wanted.selection.rows)
    np.testing.assert_array_equal(found.splats.rows, wanted.splats.rows)
    np.testing.assert_array_equal(found.bins.tile_start, wanted.bins.tile_start)
    np.testing.assert_array_equal(found.bins.splat_from_pair, wanted.bins.splat_from_pair)
    assert found.contributions is not None
    assert wanted.contributions is not None
    np.testing.assert_allclose(found.contributions, wanted.contributions, atol=1e-3)
    assert list(found.result.milliseconds) == list(wanted.result.milliseconds)


@pytest.mark.parametrize(
    "select",
    [
        st.SelectOptions(rule="release"),
        st.SelectOptions(max_radius=20.0),
        st.SelectOptions(pixel_error=0.5),
        st.SelectOptions(profile="sphere", view_test="centre"),
    ],
    ids=str,
)
def test_all_options_of_the_selection_can_be_drawn(scene: st.Scene, at_hand: Device, select: st.SelectOptions) -> None:
    found, wanted = (st.trace(scene, VIEWS[0], select=select, device=d) for d in DEVICES)
    np.testing.assert_array_equal(found.selection.rows, wanted.selection.rows)
    assert found.selection.pixel_error == wanted.selection.pixel_error
    assert found.selection.notes == wanted.selection.notes
    assert st.psnr(found.result.image, wanted.result.image) > 90


def test_a_budget_is_met_by_the_cut_of_the_processor_at_the_same_pixel_error(scene: st.Scene, at_hand: Device) -> None:
    found = st.trace(scene, VIEWS[0], select=st.SelectOptions(budget=60), device="cuda").selection
    wanted = st.select(scene, VIEWS[0], st.SelectOptions(pixel_error=found.pixel_error))
    np.testing.assert_array_equal(found.rows, wanted.rows)
    assert 0 < len(found) <= 60


@pytest.mark.parametrize(
    "drawing",
    [
        st.RenderOptions(threshold=0.05, pixels="taper"),
        st.RenderOptions(threshold=0.05),
        st.RenderOptions(threshold=0.05, tile_rule="balanced", pixels="taper"),
        st.RenderOptions(tile_rule="3sigma"),
        st.RenderOptions(mode="antialiased", sh_degree=0, background=(1.0, 0.5, 0.0)),
    ],
    ids=str,
)
def test_all_options_of_the_drawing_are_followed(scene: st.Scene, at_hand: Device, drawing: st.RenderOptions) -> None:
    found, wanted = (st.render(scene, VIEWS[0], drawing, device=d) for d in DEVICES)
    assert st.psnr(found.image, wanted.image) > 80


def test_views_are_evaluated_on_the_device(scene: st.Scene, at_hand: Device) -> None:
    found, wanted = (list(st.evaluate(scene, VIEWS, select=COARSE, device=d)) for d in DEVICES)
    for on_device, on_processor in zip(found, wanted, strict=True):
        assert abs(on_device.cut_vs_leaves.psnr - on_processor.cut_vs_leaves.psnr) < 1e-2


@pytest.fixture
def held(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> Emulator:
    """The emulator alone, which tells what is held, as the GPU that the library opens."""
    monkeypatch.setattr(cuda_device, "open_device", lambda ordinal: emulator)
    return emulator


def test_another_threshold_of_a_scene_is_drawn_from_the_same_columns(scene: st.Scene, held: Emulator) -> None:
    with st.open_session(scene, device="cuda") as session:
        first = session.draw(VIEWS[0])
        before = held.num_allocations
        other = session.draw(VIEWS[0], options=st.RenderOptions(threshold=0.1))
        assert held.num_allocations == before
    assert other.counters.num_pairs < first.counters.num_pairs


def test_the_columns_go_with_the_session(scene: st.Scene, held: Emulator) -> None:
    gc.collect()
    before = held.held["arrays"]
    with st.open_session(scene, device="cuda") as session:
        session.draw(VIEWS[0])
        assert held.held["arrays"] > before
    del session
    gc.collect()
    assert held.held["arrays"] == before


def test_a_device_that_is_not_known_is_refused(scene: st.Scene) -> None:
    with pytest.raises(st.InputError, match="render: device: found 'gpu', wanted 'cpu', 'cuda', 'reference'"):
        st.render(scene, VIEWS[0], device="gpu")  # type: ignore[arg-type]


def test_without_a_driver_the_error_says_what_to_do(scene: st.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_library, "LIBRARY_NAMES", ("libno_such_driver.so",))
    cuda_device.open_device.cache_clear()
    with pytest.raises(
        DeviceError, match=r"no GPU driver: libno_such_driver\.so was not found; install the NVIDIA driver"
    ):
        st.render(scene, VIEWS[0], device="cuda")


def test_doctor_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(cuda_library, "LIBRARY_NAMES", ("libno_such_driver.so",))
    cuda_device.open_device.cache_clear()
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "GPU driver: no GPU driver: libno_such_driver.so was not found; install the NVIDIA driver" in text
    assert "scenes are drawn on the processor" in text
    assert main(["doctor", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cuda"] is False


def test_doctor_draws_on_the_device(at_hand: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "agrees with the processor's to 1" in doctor._self_test().found  # 100 dB and more


def test_render_takes_a_device(scene: st.Scene, at_hand: Device, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    st.write(scene, tmp_path / "scene.splatree")
    words = ["--views", "1", "--width", "40", "--height", "30", "--device", "cuda", "--json"]
    assert main(["render", str(tmp_path / "scene.splatree"), "-o", str(tmp_path / "out"), *words]) == 0
    assert list(json.loads(capsys.readouterr().out)["views"][0]["ms"]) == ["select", "project", "bin", "blend"]
    assert st.read_image(tmp_path / "out" / "view_0000.png").shape == (30, 40, 3)


def test_baselines_are_drawn_on_the_device(scene: st.Scene, at_hand: Device) -> None:
    chosen = baseline("octree", scene, VIEWS)
    found, wanted = (st.render(scene, VIEWS[0], select=chosen, device=d) for d in DEVICES)
    assert st.psnr(found.image, wanted.image) > 90
