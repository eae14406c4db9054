"""The runtime meets a driver: the stand-in of simt/driver.cpp, which refuses what a driver refuses and more."""

import ctypes
import gc
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import splatree as st
from splatree.cli.main import main
from splatree.errors import DeviceError
from splatree.kernels.cuda import device as cuda_device
from splatree.kernels.cuda import library as cuda_library
from splatree.kernels.cuda.compile import load_compiler
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.library import NUMBERS, Driver, Handle, load_driver, prototypes
from splatree.kernels.cuda.sources import ROOT
from splatree.lod.select import for_levels
from splatree.scene.view import view_of

from ..scenes import camera
from .simt_device import Emulator
from .test_cuda_renderer import DRAWING, renderer_of, tree_scene


def headers_of_cuda() -> Iterator[Path]:
    """Folders that hold cuda.h: of toolkits, and of packages."""
    places = [Path("/usr/local"), *(Path(folder) / "nvidia" for folder in sys.path)]
    for place in places:
        yield from (path.parent for path in sorted(place.glob("*/include/cuda.h")))


def test_declarations_are_those_of_the_toolkit(tmp_path: Path) -> None:
    folder = next(headers_of_cuda(), None)
    if folder is None:
        pytest.skip("no cuda.h: there is no CUDA toolkit here")
    lines = ["#include <cuda.h>", '#include "cuda/driver.h"']  # a declaration that differs is an error
    lines += [f"static_assert({name} == {value});" for name, value in NUMBERS.items()]
    source = tmp_path / "check.cpp"
    source.write_text("\n".join(lines))
    words = ["c++", "-std=c++17", "-fsyntax-only", f"-I{folder}", f"-I{ROOT}", str(source)]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr


def test_types_are_read_from_the_declarations() -> None:
    types = prototypes()
    assert len(types) == (ROOT / "cuda" / "driver.h").read_text().count("CUresult cu")
    size, pointer = ctypes.c_size_t, ctypes.c_void_p
    assert types["cuMemcpyHtoDAsync_v2"] == [ctypes.c_uint64, pointer, size, pointer]
    assert types["cuGetErrorName"] == [ctypes.c_int, ctypes.POINTER(ctypes.c_char_p)]
    assert types["cuStreamCreate"] == [ctypes.POINTER(pointer), ctypes.c_uint]


@pytest.fixture
def found_library(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> Iterator[Emulator]:
    """The stand-in is the driver that the library finds."""
    monkeypatch.setattr(cuda_library, "LIBRARY_NAMES", (emulator.library._name,))
    yield emulator
    emulator.play()
    emulator.driver("cuInit", 0)


@pytest.mark.parametrize(
    ("machine", "message"),
    [
        ({"version": 11020}, "GPU driver: found CUDA 11.2, wanted at least 11.4; update it"),
        ({"init": 100}, r"cuInit: CUDA_ERROR_NO_DEVICE \(100\).*; attach a GPU, in a container pass it through"),
        ({"init": 34}, r"CUDA_ERROR_STUB_LIBRARY \(34\).*; this is the stub of a toolkit: install the NVIDIA driver"),
        ({"init": 803}, r"CUDA_ERROR_SYSTEM_DRIVER_MISMATCH \(803\).*; the driver was updated: restart the machine"),
        ({"devices": 0}, "GPU 0: the driver found 0; use device 'cpu', or attach one"),
        (
            {"major": 6, "minor": 1},
            "SIMT emulator: found compute capability 6.1, wanted at least 7.5; use device 'cpu'",
        ),
    ],
    ids=str,
)
def test_machines_that_cannot_draw_are_refused(machine: dict[str, int], message: str, found_library: Emulator) -> None:
    found_library.play(**machine)
    with pytest.raises(DeviceError, match=message):
        Device(load_driver(), lambda stage, architecture: b"")


def test_a_library_without_a_function_is_too_old() -> None:
    with pytest.raises(DeviceError, match=r"found no cuInit, wanted a driver for CUDA 11\.4 or newer; update it"):
        Driver(ctypes.CDLL(None))


def test_any_thread_may_call_and_finds_its_context_again(emulator: Emulator) -> None:
    array = emulator.upload(np.arange(4))
    other, found = Handle(emulator.library.simt_other_context()), []

    def work() -> None:  # as torch does on another GPU
        emulator.driver("cuCtxSetCurrent", other)
        found.append(array.numpy())
        now = Handle()
        emulator.driver("cuCtxGetCurrent", ctypes.byref(now))
        found.append(now.value)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    np.testing.assert_array_equal(found[0], np.arange(4))
    assert found[1] == other.value


class FakeTorch:
    """torch as far as streams go."""

    def __init__(self, emulator: Emulator) -> None:
        self.streams = [Handle(), Handle()]  # the first is the default one
        emulator.call("cuStreamCreate", ctypes.byref(self.streams[1]), NUMBERS["CU_STREAM_NON_BLOCKING"])
        self.current = 0
        self.cuda = SimpleNamespace(is_initialized=lambda: True, current_stream=self._current)

    def _current(self, ordinal: int) -> Any:
        assert ordinal == 0
        return SimpleNamespace(cuda_stream=self.streams[self.current].value or 0)


def test_streams_that_take_turns_wait_for_each_other(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, seen_by = tree_scene(), camera()
    renderer = renderer_of(scene, emulator)  # its columns are copied on our own stream
    wanted = st.render(scene, seen_by, DRAWING)
    torch = FakeTorch(emulator)
    monkeypatch.setitem(sys.modules, "torch", torch)
    for torch.current in (0, 1, 1, 0, 1):  # also a recorded frame changes its stream
        picture = renderer.draw(view_of(scene, seen_by, DRAWING), for_levels(st.SelectOptions(), scene))
        assert st.psnr(picture.image.numpy(), wanted.image) > 90


def test_views_under_way_at_once_are_each_drawn_with_their_own_camera(emulator: Emulator) -> None:
    scene = tree_scene()
    renderer = renderer_of(scene, emulator)
    cameras = [replace(camera(), K=camera().K + np.diag([i, i, 0.0])) for i in range(4)]
    pending = [renderer.enqueue(view_of(scene, c, DRAWING), for_levels(st.SelectOptions(), scene)) for c in cameras]
    for seen_by, drawn in zip(cameras, reversed([p.finish() for p in reversed(pending)]), strict=True):
        assert st.psnr(drawn.image.numpy(), st.render(scene, seen_by, DRAWING).image) > 90


def test_frames_ask_for_no_memory_even_if_nobody_looks_at_them(emulator: Emulator) -> None:
    scene = tree_scene()
    renderer = renderer_of(scene, emulator)

    def enqueue() -> None:
        renderer.enqueue(view_of(scene, camera(), DRAWING), st.SelectOptions())

    for _ in range(3):  # measured, enqueued, recorded
        enqueue()
        emulator.wait()
    waits, allocations = emulator.num_waits, emulator.num_allocations
    enqueue()
    assert emulator.num_allocations == allocations
    enqueue()  # the second under way has its numbers in memory of its own
    assert emulator.num_allocations == allocations + 1
    assert emulator.num_waits == waits


def test_everything_is_given_back(emulator: Emulator) -> None:
    scene = tree_scene()
    gc.collect()
    before = emulator.held
    renderer = renderer_of(scene, emulator, pairs=7)  # grows on the way
    for view in (camera(), camera(), camera(), camera(20, 20)):
        picture = renderer.draw(view_of(scene, view, DRAWING), st.SelectOptions())
    image = picture.image
    assert emulator.held["graphs"] == 1
    del renderer, picture
    gc.collect()
    held = {name: emulator.held[name] - before[name] for name in before}
    assert held == {"arrays": 3, "pinned": 2, "events": 1, "graphs": 0}  # what belongs to the image that is kept
    assert np.isfinite(image.numpy()).all()
    del image
    gc.collect()
    assert emulator.held == before


def test_an_image_that_is_kept_without_its_picture_is_not_drawn_over(emulator: Emulator) -> None:
    scene = tree_scene()
    renderer = renderer_of(scene, emulator)
    image = renderer.draw(view_of(scene, camera(), DRAWING), st.SelectOptions()).image
    before = image.numpy()
    renderer.draw(view_of(scene, camera(shift_x=9.0), DRAWING), st.SelectOptions())
    np.testing.assert_array_equal(image.numpy(), before)


def test_memory_may_be_freed_while_work_is_recorded(emulator: Emulator) -> None:
    array, other = emulator.upload(np.ones(4)), [emulator.upload(np.ones(4))]
    with emulator.recorded() as graphs:
        array.clear()
        other.clear()  # as the garbage collector does when it likes
    np.testing.assert_array_equal(array.numpy(), np.ones(4))
    graphs[0].launch()
    np.testing.assert_array_equal(array.numpy(), np.zeros(4))


def test_a_recording_that_fails_leaves_nothing(emulator: Emulator) -> None:
    before = emulator.held
    with pytest.raises(DeviceError, match="CUDA_ERROR_STREAM_CAPTURE"), emulator.recorded():
        emulator.wait()
    assert emulator.held == before
    emulator.wait()


def test_users_meet_the_driver_from_end_to_end(
    found_library: Emulator, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        load_compiler()
    except DeviceError as error:
        pytest.skip(str(error))
    monkeypatch.setenv("HOME", str(tmp_path))  # where compiled kernels are kept
    cuda_device.open_device.cache_clear()
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cuda"], found
    assert len(list((tmp_path / ".cache" / "splatree" / "cuda").iterdir())) == 5  # all that a frame needs
    scene = tree_scene(60)
    picture = st.render(scene, camera(), DRAWING, device="cuda")
    assert st.psnr(picture.image, st.render(scene, camera(), DRAWING).image) > 90
    cuda_device.open_device.cache_clear()


def launch_with_other_threads(emulator: Emulator) -> None:
    job = emulator.upload(np.zeros(4096, np.uint8))
    function, _ = emulator._kernel("project")
    emulator._kernels["project"] = function, 64
    try:
        emulator.launch("project", 1, job)
        emulator.wait()
    finally:
        del emulator._kernels["project"]


def record_a_copy_of_pageable_memory(emulator: Emulator) -> None:
    array = emulator.upload(np.ones(4))
    with emulator.recorded():
        array.fill(np.zeros(4))


def use_what_was_freed(emulator: Emulator) -> None:
    array = emulator.empty((4,), np.float32)
    with emulator.recorded() as graphs:
        array.clear()
    del array
    graphs[0].launch()
    emulator.wait()


def call_without_a_context(emulator: Emulator) -> None:
    errors: list[DeviceError] = []

    def work() -> None:
        try:
            emulator.driver("cuStreamSynchronize", None)
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    raise errors[0]


def time_what_has_not_passed(emulator: Emulator) -> None:
    first, second = emulator.event(), emulator.event()
    first.record()
    second.record()
    second.milliseconds_since(first)


def load_what_is_no_code(emulator: Emulator) -> None:
    emulator.call("cuModuleLoadData", ctypes.byref(Handle()), b"\x7fELF" + bytes(60))


MISUSE: dict[Callable[[Emulator], None], str] = {
    launch_with_other_threads: "project: found 64 threads a block, built for 128",
    record_a_copy_of_pageable_memory: "LAUNCH_FAILED|memory that is not pinned",
    use_what_was_freed: "memset: found an array that is not there",
    call_without_a_context: "CUDA_ERROR_INVALID_CONTEXT",
    time_what_has_not_passed: "CUDA_ERROR_NOT_READY",
    load_what_is_no_code: "CUDA_ERROR_INVALID_IMAGE",
}


@pytest.mark.parametrize("misuse", MISUSE, ids=lambda misuse: misuse.__name__)
def test_misuse_is_refused(misuse: Callable[[Emulator], None], emulator: Emulator) -> None:
    with pytest.raises(DeviceError, match=MISUSE[misuse]):
        misuse(emulator)
