"""Whole frames on a device: the picture of the processor, no wait on the way, and no picture that lacks something."""

from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.errors import DeviceError
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.renderer import Renderer
from splatree.lod.blocks import with_blocks
from splatree.lod.select import for_levels
from splatree.scene.view import view_of

from ..scenes import camera, gaussians
from .conftest import SCENES
from .simt_device import Emulator


def tree_scene(n: int = 600, mode: str = "classic") -> st.Scene:
    return with_blocks(st.build_lod(st.Scene.flat(gaussians(n, 1, degree=2), mode=mode)), rows_per_block=32)  # type: ignore[arg-type]


def renderer_of(
    scene: st.Scene, device: Device, *, rows: int = 1024, pairs: int = 4096, blend: str | None = None
) -> Renderer:
    assert scene.blocks is not None
    return Renderer(device, scene.gaussians, scene.tree, scene.blocks, scene.ids, rows=rows, pairs=pairs, blend=blend)  # type: ignore[arg-type]


DRAWING = st.RenderOptions(background=(0.2, 0.5, 0.9))


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("pixel_error", [0.0, 3.0, 12.0])
def test_picture_is_that_of_the_processor(mode: str, pixel_error: float, device: Device) -> None:
    scene, seen_by, chosen = tree_scene(mode=mode), camera(), st.SelectOptions(pixel_error=pixel_error)
    picture = renderer_of(scene, device).draw(view_of(scene, seen_by, DRAWING), for_levels(chosen, scene))
    frame = st.trace(scene, seen_by, DRAWING, chosen)
    # Another order of operations rounds otherwise: 1e-7 a product, hundreds of them; 60 dB are 1e-3.
    assert st.psnr(picture.image.numpy(), frame.result.image) > 90
    np.testing.assert_allclose(picture.alpha.numpy(), frame.result.alpha, atol=1e-3)
    assert abs(picture.counters["num_selected"] - frame.result.counters.num_selected) <= 2
    assert abs(picture.counters["num_pairs"] - frame.result.counters.num_pairs) <= 4


@pytest.mark.parametrize("name", SCENES)
def test_hard_scenes_are_drawn(name: str, device: Device) -> None:
    g, seen_by = SCENES[name]()
    scene = with_blocks(st.Scene.flat(g))
    picture = renderer_of(scene, device).draw(view_of(scene, seen_by, DRAWING), st.SelectOptions())
    wanted = st.render(scene, seen_by, DRAWING)
    # A splat at τ or a pixel at its last splat may fall either way, as between processor and reference: 1.5/255 at most, few.
    difference = np.abs(picture.image.numpy() - wanted.image).max(axis=-1)
    assert difference.max() <= 1.5 / 255 * max(1.0, float(wanted.image.max()))
    assert (difference > 1e-4).mean() <= 0.01


def test_a_frame_waits_for_nothing(emulator: Emulator) -> None:
    scene, seen_by = tree_scene(), camera()
    renderer = renderer_of(scene, emulator)
    renderer.draw(view_of(scene, seen_by, DRAWING), st.SelectOptions())  # measures the blend kernels, which waits
    for _ in range(3):  # enqueued, recorded, replayed
        waits, launches = emulator.num_waits, emulator.num_launches
        pending = renderer.enqueue(view_of(scene, seen_by, DRAWING), st.SelectOptions())
        assert emulator.num_waits == waits
        assert emulator.num_launches == launches  # nor did the device start: nothing of it can have been asked for
        pending.finish()
        assert emulator.num_waits == waits + 1


def test_recorded_frames_follow_the_camera(device: Device) -> None:
    scene = tree_scene()
    renderer = renderer_of(scene, device)
    for i in range(5):
        seen_by = replace(camera(), K=camera().K + np.array([[i, 0, i], [0, i, 0], [0, 0, 0.0]]))
        chosen = for_levels(st.SelectOptions(pixel_error=float(i)), scene)
        picture = renderer.draw(view_of(scene, seen_by, DRAWING), chosen)
        wanted = st.render(scene, seen_by, DRAWING, st.SelectOptions(pixel_error=float(i)))
        assert st.psnr(picture.image.numpy(), wanted.image) > 90


def test_pictures_that_are_kept_are_not_drawn_over(device: Device) -> None:
    scene = tree_scene()
    renderer = renderer_of(scene, device)
    first = renderer.draw(view_of(scene, camera(), DRAWING), st.SelectOptions())
    before = first.image.numpy()
    renderer.draw(view_of(scene, camera(shift_x=9.0), DRAWING), st.SelectOptions())
    np.testing.assert_array_equal(first.image.numpy(), before)


@pytest.mark.parametrize("room", [{"rows": 5}, {"pairs": 7}, {"rows": 1, "pairs": 1}])
def test_arrays_that_are_too_small_grow_and_the_view_is_drawn_again(room: dict[str, int], device: Device) -> None:
    scene, seen_by = tree_scene(), camera()
    small, large = renderer_of(scene, device, **room), renderer_of(scene, device)
    pictures = [r.draw(view_of(scene, seen_by, DRAWING), st.SelectOptions()) for r in (small, large)]
    np.testing.assert_array_equal(*(p.image.numpy() for p in pictures))
    assert pictures[0].counters == pictures[1].counters


@pytest.mark.parametrize("ids", [True, False])
def test_schedule_and_kernel_change_no_bit(ids: bool, emulator: Emulator) -> None:
    scene, seen_by = tree_scene(), camera()
    if not ids:
        scene = replace(scene, ids=None)
    found = []
    for seed, num_resident, blend in ((1, 1, "blend_16"), (2, 3, "blend_16"), (3, 2, "longest_8")):
        emulator.seed(seed)
        emulator.interleave(num_resident)
        picture = renderer_of(scene, emulator, blend=blend).draw(view_of(scene, seen_by, DRAWING), st.SelectOptions())
        found.append((picture.image.numpy().tobytes(), picture.depth.numpy().tobytes()))
    assert found[0] == found[1] == found[2]


def test_trace_has_what_each_stage_left(device: Device) -> None:
    scene, seen_by = tree_scene(), camera()
    chosen = for_levels(st.SelectOptions(), scene)
    traced = renderer_of(scene, device).trace(view_of(scene, seen_by, DRAWING), chosen)
    frame = st.trace(scene, seen_by, DRAWING)
    np.testing.assert_array_equal(traced.rows, frame.selection.rows)
    np.testing.assert_array_equal(traced.splats.rows, frame.splats.rows)
    np.testing.assert_array_equal(traced.splats.order, frame.splats.order)
    np.testing.assert_allclose(traced.splats.colors, frame.splats.colors, atol=4e-6)
    assert abs(traced.bins.num_pairs - frame.bins.num_pairs) <= 4
    assert abs(traced.picture.num_blended - frame.result.counters.num_blended) <= 1e-3 * traced.picture.num_blended
    assert list(traced.milliseconds) == ["select", "project", "bin", "blend"]


def test_memory_that_is_not_there_is_an_error_that_says_so(emulator: Emulator) -> None:
    scene = tree_scene()
    emulator.limit_memory(50_000)
    with pytest.raises(DeviceError, match=r"CUDA_ERROR_OUT_OF_MEMORY.*free GPU memory"):
        renderer_of(scene, emulator)


def test_a_picture_is_shared_without_a_copy(device: Device) -> None:
    scene = tree_scene(60)
    image = renderer_of(scene, device).draw(view_of(scene, camera(), DRAWING), st.SelectOptions()).image
    shared = image.__cuda_array_interface__
    assert shared["shape"] == (37, 52, 3)
    assert shared["typestr"] == "<f4"
    assert shared["data"] == (image.pointer, False)
