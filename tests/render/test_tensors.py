"""Tensors in and out without a copy: DLPack, ``__cuda_array_interface__``, torch."""

import gc
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import splatree as st
from splatree.kernels.cpu import _core
from splatree.kernels.cuda.driver import DeviceArray

from ..kernels.simt_device import Emulator
from ..scenes import camera, gaussians

NAMES = [field.name for field in fields(st.Gaussians)]


@pytest.fixture
def device(emulator: Emulator) -> Emulator:
    """The emulator alone, which tells what is held."""
    return emulator


class ByInterface:
    """A tensor of a library that has no DLPack."""

    def __init__(self, array: DeviceArray, **changes: Any) -> None:
        self.__cuda_array_interface__ = array.__cuda_array_interface__ | changes


@pytest.fixture
def columns(at_hand: Emulator) -> dict[str, DeviceArray]:
    g = gaussians(200, 1, degree=2)
    return {name: at_hand.upload(getattr(g, name), name=name) for name in NAMES}


@pytest.mark.parametrize("wrap", [lambda array: array, ByInterface], ids=["dlpack", "interface"])
def test_kernels_read_the_tensors_where_they_lie(wrap: Any, columns: dict[str, DeviceArray], at_hand: Emulator) -> None:
    scene = st.scene_from_tensors(**{name: wrap(column) for name, column in columns.items()})
    wanted = st.render(st.Scene.flat(gaussians(200, 1, degree=2)), camera())
    with st.open_session(scene) as session:
        found = session.draw_on_device(camera())
        held = session._engine.held.scene.arrays
    assert st.psnr(found.image.numpy(), wanted.image) > 90
    assert {name: held[name].pointer for name in NAMES} == {name: columns[name].pointer for name in NAMES}


def test_tensors_are_drawn_view_by_view(columns: dict[str, DeviceArray], at_hand: Emulator) -> None:
    scene, cameras = st.scene_from_tensors(**columns), [camera()]
    with st.open_session(scene) as session:
        wanted = session.draw(camera()).image
    for found in (
        *st.render_batch(scene, cameras),
        *(frame.result for frame in st.trace_batch(scene, cameras)),
        *(evaluation.cut.result for evaluation in st.evaluate(scene, cameras)),
    ):
        np.testing.assert_array_equal(found.image, wanted)
    assert st.time_frames(scene, cameras, views=1, warm_up=0).num_frames == 1


def test_tensors_are_kept_while_the_scene_is(columns: dict[str, DeviceArray], at_hand: Emulator) -> None:
    gc.collect()
    before = at_hand.held["arrays"]
    scene = st.scene_from_tensors(**columns)
    columns.clear()
    gc.collect()
    with st.open_session(scene) as session:
        session.draw(camera())
    del scene, session
    gc.collect()
    assert at_hand.held["arrays"] == before - len(NAMES)


def test_a_picture_is_shared_and_stays_while_it_is_used(columns: dict[str, DeviceArray], at_hand: Emulator) -> None:
    session = st.open_session(st.scene_from_tensors(**columns))
    image = session.draw_on_device(camera()).image
    assert image.__dlpack_device__() == (2, 0)
    pointer, shape, contiguous, dtype, ordinal, keeper = _core.import_tensor(image.__dlpack__(stream=-1))
    assert (pointer, shape, contiguous, dtype, ordinal) == (image.pointer, [37, 52, 3], True, "float32", 0)
    before = image.numpy()
    del image
    gc.collect()
    other = session.draw_on_device(camera(shift_x=9.0)).image
    assert other.pointer != pointer  # the capsule keeps the first one
    del keeper
    gc.collect()
    assert session.draw_on_device(camera()).image.pointer == pointer
    np.testing.assert_array_equal(session.draw_on_device(camera()).image.numpy(), before)


def test_consumers_on_another_stream_wait_for_the_picture(columns: dict[str, DeviceArray], at_hand: Emulator) -> None:
    array = at_hand.empty((4,), np.float32)
    array.clear()
    copied = at_hand.pinned((4,), np.float32)
    copied.values[:] = 5
    array.__dlpack__(stream=1)  # the default stream
    at_hand.call("cuMemcpyDtoHAsync_v2", copied._pointer, array.pointer, 16, None)
    at_hand.call("cuStreamSynchronize", None)
    np.testing.assert_array_equal(copied.values, np.zeros(4))


def test_kernels_wait_for_the_stream_that_fills_a_tensor(at_hand: Emulator) -> None:
    array, ones = at_hand.empty((4,), np.float32, name="means"), np.ones(4, np.float32)
    at_hand.call("cuMemcpyHtoDAsync_v2", array.pointer, ones.ctypes.data, 16, None)  # on the default stream
    from splatree.kernels.cuda.tensors import borrowed

    found = borrowed(at_hand, "means", ByInterface(array, stream=1))
    np.testing.assert_array_equal(found.numpy(), ones)


def requiring_gradients(array: DeviceArray) -> Any:
    def refuse(**_: Any) -> None:
        raise BufferError("Can't export tensors that require gradient, use tensor.detach()")

    return SimpleNamespace(__dlpack__=refuse, __dlpack_device__=lambda: (2, 0))


FAULTS = {
    "list": (lambda a: [1.0], st.InputError, "sh: found list, wanted a tensor with DLPack"),
    "host": (lambda a: a.numpy(), st.InputError, "means on GPU 0, .* sh on the processor, wanted all on one device"),
    "vulkan": (
        lambda a: SimpleNamespace(__dlpack_device__=lambda: (7, 0)),
        st.InputError,
        "sh: found a tensor on a device of DLPack's kind 7, wanted CUDA or the processor",
    ),
    "half": (
        lambda a: a.device.upload(a.numpy().astype(np.float16)),
        st.ShapeError,
        r"sh: found a tensor of float16, wanted float32; convert it with \.float\(\)",
    ),
    "strided": (
        lambda a: ByInterface(a, strides=(4, 800, 7200)),
        st.ShapeError,
        r"sh: found a strided tensor, wanted a contiguous one; use \.contiguous\(\)",
    ),
    "elsewhere": (
        lambda a: ByInterface(a, data=(4096, False)),
        st.InputError,
        "sh: found an address that is not in the memory of GPU 0, wanted all there",
    ),
    "shifted": (
        lambda a: ByInterface(a, data=(a.pointer + 4, False)),
        st.ShapeError,
        r"sh: found a tensor at an address that is no multiple of 16 bytes, .*; use \.clone\(\)",
    ),
    "gradients": (
        requiring_gradients,
        st.InputError,
        r"sh: the tensor does not give its memory away: .*; use \.detach",
    ),
    "shape": (
        lambda a: a.device.upload(np.zeros((200, 5, 3), np.float32)),
        st.ShapeError,
        r"Gaussians\.sh: found 5 coefficients, wanted 1, 4, 9 or 16",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_kernels_cannot_read_is_an_error_that_says_what_to_do(fault: str, columns: dict[str, DeviceArray]) -> None:
    change, kind, message = FAULTS[fault]
    with pytest.raises(kind, match=message):
        st.scene_from_tensors(**columns | {"sh": change(columns["sh"])})


def test_a_device_without_memory_of_its_own_keeps_no_picture() -> None:
    with (
        st.open_session(st.Scene.flat(gaussians(3, 1))) as session,
        pytest.raises(st.InputError, match="draw_on_device: device 'cpu' has no memory of its own; use draw"),
    ):
        session.draw_on_device(camera())


def test_a_picture_that_is_chosen_in_several_steps_does_not_stay_on_the_device(
    columns: dict[str, DeviceArray], at_hand: Emulator
) -> None:
    with st.open_session(st.scene_from_tensors(**columns)) as session:
        assert 100 < len(session.select(camera(), select=st.SelectOptions(budget=500))) < 200
        with pytest.raises(st.InputError, match="draw_on_device: found a budget"):
            session.draw_on_device(camera(), select=st.SelectOptions(budget=500))


def test_tensors_on_a_device_are_not_drawn_on_another(columns: dict[str, DeviceArray], at_hand: Emulator) -> None:
    scene = st.scene_from_tensors(**columns)
    with pytest.raises(st.InputError, match="found tensors on device 'cuda', wanted them on 'cpu'"):
        st.open_session(scene, device="cpu")
    assert st.render(scene.scene, camera()).image.shape == (37, 52, 3)  # the copy on the host


def test_tensors_on_the_processor_are_shared_too() -> None:
    g = gaussians(50, 1)
    scene = st.scene_from_tensors(**{name: getattr(g, name) for name in NAMES}, mode="antialiased")
    assert (scene.device, scene.scene.mode) == ("cpu", "antialiased")
    assert np.shares_memory(scene.scene.gaussians.sh, g.sh)
    np.testing.assert_array_equal(st.render(scene, camera()).image, st.render(scene.scene, camera()).image)


def test_torch_gives_and_takes_tensors(
    columns: dict[str, DeviceArray], at_hand: Emulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    g = gaussians(50, 1)
    tensors = {name: torch.from_numpy(getattr(g, name)) for name in NAMES}
    scene = st.scene_from_tensors(**tensors)
    assert np.shares_memory(scene.scene.gaussians.means, g.means)
    with pytest.raises(st.InputError, match=r"means: the tensor does not give its memory away: .*; use \.detach"):
        st.scene_from_tensors(**tensors | {"means": tensors["means"].clone().requires_grad_()})
    # The emulator's memory is the processor's: as such torch reads it here, in place.
    image = st.open_session(st.scene_from_tensors(**columns)).draw_on_device(camera()).image
    monkeypatch.setattr(DeviceArray, "__dlpack_device__", lambda array: (1, 0))
    monkeypatch.setattr(DeviceArray, "__dlpack__", partial_without_stream(DeviceArray.__dlpack__))
    taken = torch.from_dlpack(image)
    assert taken.data_ptr() == image.pointer
    np.testing.assert_array_equal(taken.numpy(), image.numpy())


def partial_without_stream(export: Any) -> Any:
    return lambda array, **_: export(array, stream=-1)
