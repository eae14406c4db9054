"""The CUDA driver through ctypes: the two dozen functions that a frame needs.

The driver's library comes with every GPU driver and has had these functions, with these signatures, since CUDA 11.4. Nothing
else is needed on the machine: no toolkit, no torch. The context is the device's primary one, the same that torch uses, so that
arrays can be shared with it without a copy (``__cuda_array_interface__``).

Work goes to torch's current stream if torch is in use in this process, else to a stream of our own. Nothing here waits for
the device but `Device.wait` and `DeviceArray.numpy`.
"""

import ctypes
import math
import sys
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from splatree.errors import DeviceError
from splatree.kernels.cuda.sources import stage_of, threads_of
from splatree.shapes import Array

__all__ = ["Device", "DeviceArray", "Driver", "Event", "Graph", "dotted", "load_driver"]

DRIVER_NAMES = {"win32": ("nvcuda.dll",)}.get(sys.platform, ("libcuda.so.1", "libcuda.so"))
OLDEST_DRIVER = 11040
"""CUDA 11.4 (2021) is the first whose driver instantiates graphs by the function used here."""
OLDEST_ARCHITECTURE = (7, 5)
"""Turing: the oldest that current NVRTC compiles for."""

_SUCCESS, _OUT_OF_MEMORY = 0, 2
_MULTIPROCESSORS, _MAJOR, _MINOR = 16, 75, 76  # of enum CUdevice_attribute
_NON_BLOCKING, _THREAD_LOCAL = 1, 1

Handle = ctypes.c_void_p
Address = ctypes.c_uint64


class Driver:
    """The functions of the driver's library, with its errors as `DeviceError`."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def __call__(self, name: str, *arguments: Any) -> None:
        """Call a function; an error says what the driver says."""
        code = getattr(self._library, name)(*arguments)
        if code == _SUCCESS:
            return
        name_text, text = ctypes.c_char_p(), ctypes.c_char_p()
        self._library.cuGetErrorName(code, ctypes.byref(name_text))
        self._library.cuGetErrorString(code, ctypes.byref(text))
        found = (name_text.value or b"unknown error").decode(), (text.value or b"").decode()
        advice = "; draw with fewer or smaller arrays, or free GPU memory" if code == _OUT_OF_MEMORY else ""
        raise DeviceError(f"GPU driver, {name}: {found[0]} ({code}): {found[1]}{advice}")

    def give_back(self, name: str, *arguments: Any) -> None:
        """Call a function that frees something; a context that has failed refuses, and its memory goes with it."""
        getattr(self._library, name)(*arguments)

    def version(self) -> int:
        """1000 × major + 10 × minor of the CUDA version that the driver supports."""
        found = ctypes.c_int()
        self("cuDriverGetVersion", ctypes.byref(found))
        return found.value


def load_driver() -> Driver:
    """The driver of this machine, initialised.

    Raises:
        DeviceError: there is none, it is too old, or it finds no GPU.
    """
    for name in DRIVER_NAMES:
        try:
            driver = Driver(ctypes.CDLL(name))
            break
        except OSError:
            continue
    else:
        raise DeviceError(
            f"no GPU driver: {DRIVER_NAMES[0]} was not found; install the NVIDIA driver, or use device 'cpu'"
        )
    driver("cuInit", 0)
    version = driver.version()
    if version < OLDEST_DRIVER:
        raise DeviceError(
            f"GPU driver: found CUDA {dotted(version)}, wanted at least {dotted(OLDEST_DRIVER)}; update it"
        )
    return driver


class DeviceArray:
    """An array in device memory, freed with this object; torch and CuPy take it without a copy."""

    def __init__(self, device: "Device", shape: Sequence[int], dtype: npt.DTypeLike, *, name: str = "") -> None:
        self.device, self.shape, self.dtype, self.name = device, tuple(shape), np.dtype(dtype), name
        self.pointer = device._allocate(max(self.nbytes, 16), name)
        _finally(self, device._give_back, "cuMemFree_v2", Address(self.pointer))

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def nbytes(self) -> int:
        """Bytes of the elements."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {"shape": self.shape, "typestr": self.dtype.str, "data": (self.pointer, False), "version": 2}

    def numpy(self, count: int | None = None) -> Array:
        """A copy on the host, of the first ``count`` rows or all; waits for the device."""
        shape = self.shape if count is None else (count, *self.shape[1:])
        host = np.empty(shape, self.dtype)
        if host.nbytes:
            pointer = ctypes.c_void_p(host.ctypes.data)
            self.device.driver(
                "cuMemcpyDtoHAsync_v2", pointer, Address(self.pointer), ctypes.c_size_t(host.nbytes), self.device.stream
            )
            self.device.wait()
        return host

    def fill(self, host: Array) -> None:
        """Copy from the host, which may be changed as soon as this returns."""
        host = np.ascontiguousarray(host, self.dtype)
        if host.nbytes > self.nbytes:
            raise DeviceError(f"{self.name}: found {host.nbytes} bytes, wanted at most {self.nbytes}")
        if host.nbytes:
            pointer = ctypes.c_void_p(host.ctypes.data)
            self.device.driver(
                "cuMemcpyHtoDAsync_v2", Address(self.pointer), pointer, ctypes.c_size_t(host.nbytes), self.device.stream
            )

    def clear(self) -> None:
        """Set all bytes to zero."""
        self.device.driver(
            "cuMemsetD8Async",
            Address(self.pointer),
            ctypes.c_ubyte(0),
            ctypes.c_size_t(self.nbytes),
            self.device.stream,
        )


class PinnedArray:
    """A host array that the device writes without anybody waiting; read it behind an `Event`."""

    def __init__(self, device: "Device", shape: Sequence[int], dtype: npt.DTypeLike) -> None:
        bytes_ = math.prod(shape) * np.dtype(dtype).itemsize
        pointer = ctypes.c_void_p()
        device.driver("cuMemAllocHost_v2", ctypes.byref(pointer), ctypes.c_size_t(bytes_))
        assert pointer.value is not None
        buffer = (ctypes.c_ubyte * bytes_).from_address(pointer.value)
        self.values: Array = np.ctypeslib.as_array(buffer).view(dtype).reshape(shape)
        self._pointer, self._device = pointer, device
        _finally(self, device._give_back, "cuMemFreeHost", pointer)

    def fetch(self, array: DeviceArray) -> None:
        """Copy from the device once it gets there."""
        size = ctypes.c_size_t(self.values.nbytes)
        self._device.driver("cuMemcpyDtoHAsync_v2", self._pointer, Address(array.pointer), size, self._device.stream)


class Event:
    """A point in the stream."""

    def __init__(self, device: "Device") -> None:
        self._device, self._handle = device, Handle()
        device.driver("cuEventCreate", ctypes.byref(self._handle), ctypes.c_uint(0))
        _finally(self, device._give_back, "cuEventDestroy_v2", self._handle)

    def record(self) -> None:
        """Put the point behind all work that was enqueued so far."""
        self._device.driver("cuEventRecord", self._handle, self._device.stream)

    def wait(self) -> None:
        """Return when the device has passed the point."""
        self._device.driver("cuEventSynchronize", self._handle)

    def milliseconds_since(self, earlier: "Event") -> float:
        """Time between two points that were passed."""
        found = ctypes.c_float()
        self._device.driver("cuEventElapsedTime", ctypes.byref(found), earlier._handle, self._handle)
        return found.value


class Graph:
    """Recorded work, launched as one."""

    def __init__(self, device: "Device", handle: Handle) -> None:
        self._device, self._handle = device, Handle()
        device.driver("cuGraphInstantiateWithFlags", ctypes.byref(self._handle), handle, ctypes.c_uint64(0))
        device.driver("cuGraphDestroy", handle)
        _finally(self, device._give_back, "cuGraphExecDestroy", self._handle)

    def launch(self) -> None:
        """Enqueue all of it."""
        self._device.driver("cuGraphLaunch", self._handle, self._device.stream)


class Device:
    """One GPU: its memory, its stream, its kernels."""

    def __init__(self, driver: Driver, cubin_of: Callable[[str, str], bytes], *, ordinal: int = 0) -> None:
        """``cubin_of(stage, architecture)`` compiles a file of kernels (kernels/cuda/compile.py)."""
        self.driver, self._cubin_of = driver, cubin_of
        device = ctypes.c_int()
        count = ctypes.c_int()
        driver("cuDeviceGetCount", ctypes.byref(count))
        if not ordinal < count.value:
            raise DeviceError(f"GPU {ordinal}: the driver found {count.value}; use device 'cpu', or attach one")
        driver("cuDeviceGet", ctypes.byref(device), ctypes.c_int(ordinal))
        name = ctypes.create_string_buffer(128)
        driver("cuDeviceGetName", name, ctypes.c_int(128), device)
        self.name = name.value.decode()
        major, minor, self.num_multiprocessors = (
            self._attribute(device, attribute) for attribute in (_MAJOR, _MINOR, _MULTIPROCESSORS)
        )
        if (major, minor) < OLDEST_ARCHITECTURE:
            wanted = ".".join(map(str, OLDEST_ARCHITECTURE))
            raise DeviceError(
                f"{self.name}: found compute capability {major}.{minor}, wanted at least {wanted}; use device 'cpu'"
            )
        self.architecture = f"sm_{major}{minor}"
        total = ctypes.c_size_t()
        driver("cuDeviceTotalMem_v2", ctypes.byref(total), device)
        self.memory_bytes = total.value
        self._context = Handle()
        driver("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), device)
        driver("cuCtxSetCurrent", self._context)
        self._own_stream = Handle()
        driver("cuStreamCreate", ctypes.byref(self._own_stream), ctypes.c_uint(_NON_BLOCKING))
        self._recording = False
        self._modules: dict[str, Handle] = {}
        self._kernels: dict[str, tuple[Handle, int]] = {}

    @property
    def stream(self) -> Handle:
        """Where work goes: torch's current stream if torch is in use, else our own, also while recording."""
        torch = sys.modules.get("torch")
        if torch is None or self._recording or not torch.cuda.is_initialized():
            return self._own_stream
        return Handle(torch.cuda.current_stream().cuda_stream)

    def make_current(self) -> None:
        """Bind the context to this thread; each thread that uses the device has to."""
        self.driver("cuCtxSetCurrent", self._context)

    def empty(self, shape: Sequence[int], dtype: npt.DTypeLike, *, name: str = "") -> DeviceArray:
        """Memory for an array."""
        return DeviceArray(self, shape, dtype, name=name)

    def upload(self, host: Array, *, name: str = "") -> DeviceArray:
        """A copy of a host array."""
        array = self.empty(host.shape, host.dtype, name=name)
        array.fill(host)
        return array

    def pinned(self, shape: Sequence[int], dtype: npt.DTypeLike) -> PinnedArray:
        """Host memory for what the device reports."""
        return PinnedArray(self, shape, dtype)

    def event(self) -> Event:
        """A point in the stream, not yet recorded."""
        return Event(self)

    def launch(self, kernel: str, num_blocks: int, job: DeviceArray, argument: int = 0) -> None:
        """Enqueue a kernel; each takes the address of a job and a number."""
        function, threads = self._kernel(kernel)
        pointer, number = Address(job.pointer), ctypes.c_int(argument)
        arguments = (ctypes.c_void_p * 2)(ctypes.addressof(pointer), ctypes.addressof(number))
        sizes = (max(num_blocks, 1), 1, 1, threads, 1, 1, 0)
        self.driver("cuLaunchKernel", function, *map(ctypes.c_uint, sizes), self.stream, arguments, None)

    def prepare(self, kernels: Sequence[str]) -> None:
        """Load kernels before they are used: loading is not allowed while work is recorded."""
        for kernel in kernels:
            self._kernel(kernel)

    @contextmanager
    def recorded(self) -> Iterator[list[Graph]]:
        """Record what is enqueued within; the list then holds the graph."""
        graphs: list[Graph] = []
        self._recording = True
        try:
            self.driver("cuStreamBeginCapture_v2", self._own_stream, ctypes.c_int(_THREAD_LOCAL))
            try:
                yield graphs
            finally:
                handle = Handle()
                self.driver("cuStreamEndCapture", self._own_stream, ctypes.byref(handle))
        finally:
            self._recording = False
        graphs.append(Graph(self, handle))

    def wait(self) -> None:
        """Return when the device has done all that was enqueued."""
        self.driver("cuStreamSynchronize", self.stream)

    def _attribute(self, device: ctypes.c_int, attribute: int) -> int:
        found = ctypes.c_int()
        self.driver("cuDeviceGetAttribute", ctypes.byref(found), ctypes.c_int(attribute), device)
        return found.value

    def _kernel(self, name: str) -> tuple[Handle, int]:
        if name not in self._kernels:
            stage = stage_of(name)
            if stage not in self._modules:
                module = Handle()
                self.driver("cuModuleLoadData", ctypes.byref(module), self._cubin_of(stage, self.architecture))
                self._modules[stage] = module
            function = Handle()
            self.driver("cuModuleGetFunction", ctypes.byref(function), self._modules[stage], name.encode())
            self._kernels[name] = function, threads_of(name)
        return self._kernels[name]

    def _allocate(self, num_bytes: int, name: str) -> int:
        pointer = Address()
        self.driver("cuMemAlloc_v2", ctypes.byref(pointer), ctypes.c_size_t(num_bytes))
        return pointer.value

    def _give_back(self, function: str, what: Address | Handle) -> None:
        self.driver.give_back("cuCtxSetCurrent", self._context)
        self.driver.give_back(function, what)


def _finally(owner: object, work: Callable[..., None], *arguments: Any) -> None:
    """Give something back when its owner goes; what is left at the end of the process goes with it."""
    weakref.finalize(owner, work, *arguments).atexit = False


def dotted(version: int) -> str:
    """13000 as "13.0"."""
    return f"{version // 1000}.{version % 1000 // 10}"
