import os
import shutil
from collections.abc import Iterator
from functools import partial

import pytest
from hypothesis import HealthCheck, settings

from splatree.errors import DeviceError
from splatree.kernels.cpu import _core
from splatree.kernels.cuda import device as cuda_device
from splatree.kernels.cuda.device import open_device
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.renderer import Renderer

from .kernels.simt_device import Emulator, compile_emulator
from .shown import shown_files, shown_folder

__all__ = ["shown_files", "shown_folder"]

# No deadline: this suite never asserts on time. Derandomized: a red run is red again.
settings.register_profile(
    "splatree", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow], print_blob=False
)
settings.load_profile("splatree")


@pytest.fixture(scope="session")
def compiled_emulator(tmp_path_factory: pytest.TempPathFactory) -> Emulator:
    """Device code on the processor, compiled once, by the first worker that needs it."""
    if shutil.which("c++") is None:
        pytest.skip("the emulator of the device needs a C++ compiler, c++")
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return Emulator(compile_emulator(tmp_path_factory.mktemp("simt")))
    fcntl = pytest.importorskip("fcntl")
    folder = tmp_path_factory.getbasetemp().parent / "simt"  # of all workers
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        library = folder / "libsimt.so"
        return Emulator(library if library.exists() else compile_emulator(folder))


@pytest.fixture
def emulator(compiled_emulator: Emulator) -> Iterator[Emulator]:
    """The emulator as each test finds it."""
    compiled_emulator.seed(1)
    yield compiled_emulator
    compiled_emulator.interleave(1)
    compiled_emulator.limit_memory(1 << 30)
    compiled_emulator.forget_failure()


@pytest.fixture(params=_core.isas())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Each instruction set that this processor runs, in turn."""
    before = _core.isa()
    _core.use_isa(request.param)
    yield request.param
    _core.use_isa(before)


@pytest.fixture(params=["emulator", "gpu"])
def device(request: pytest.FixtureRequest) -> Device:
    """Where device code runs: the emulator, and the GPU if there is one."""
    if request.param == "emulator":
        return request.getfixturevalue("emulator")
    try:
        return open_device(0)
    except DeviceError as error:
        pytest.skip(f"no GPU: {error}")


@pytest.fixture
def at_hand(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device is every GPU that the library opens; with little room at first, as the emulator watches every word."""
    monkeypatch.setattr(cuda_device, "open_device", lambda ordinal: device)
    monkeypatch.setattr(cuda_device, "Renderer", partial(Renderer, rows=256, pairs=1024))
    return device


@pytest.fixture
def bucket() -> Iterator[str]:
    """The address of an empty folder of the store that fsspec keeps in memory."""
    files = pytest.importorskip("fsspec").filesystem("memory")
    yield "memory://bucket"
    files.store.clear()
    files.pseudo_dirs[:] = [""]
