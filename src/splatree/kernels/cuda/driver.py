"""One GPU through its driver: memory, streams, kernels, recorded frames.

The context is the device's primary one, the same that torch uses, so that arrays are shared with it without a copy (DLPack,
``__cuda_array_interface__``). It is made current for each call and whatever was current before is restored, so that any thread
may call, and torch may be at work on another GPU.

Work goes to torch's current stream if torch is in use in this process, else to a stream of our own; where that changes from one
call to the next, the new stream waits for the old one, on the device. Nothing here makes the host wait but `Device.wait`,
`Event.wait`, `DeviceArray.numpy` and freeing memory; a copy from memory that is not pinned may. One thread at a time.
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
from splatree.kernels.cpu import _core
from splatree.kernels.cuda.library import NUMBERS, Address, Driver, Handle
from splatree.kernels.cuda.sources import stage_of, threads_of
from splatree.shapes import Array

__all__ = ["Device", "DeviceArray", "Event", "Graph", "PinnedArray"]

OLDEST_ARCHITECTURE = (7, 5)
"""Turing: the oldest that current NVRTC compiles for."""
DLPACK_CUDA = 2
"""The kind of device of DLPack."""


class DeviceArray:
    """An array in device memory; torch, CuPy and JAX take it without a copy, and keep it as long as they need it."""

    def __init__(
        self,
        device: "Device",
        shape: Sequence[int],
        dtype: npt.DTypeLike,
        pointer: int,
        *,
        name: str = "",
        owner: object = None,
    ) -> None:
        """``owner`` is kept as long as this object: what the memory belongs to."""
        self.device, self.shape, self.dtype = device, tuple(shape), np.dtype(dtype)
        self.pointer, self.name, self.owner = pointer, name, owner

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def nbytes(self) -> int:
        """Bytes of the elements."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        stream = self.device.stream.value or 1  # 0 is not allowed: 1 is the default stream
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (self.pointer, False),
            "version": 3,
            "stream": stream,
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        return DLPACK_CUDA, self.device.ordinal

    def __dlpack__(self, *, stream: int | None = None, **_: Any) -> object:
        if stream != -1:  # -1: the consumer sees to the order itself
            self.device.let_wait(Handle(stream or 0))
        return _core.export_tensor(self.pointer, self.shape, self.dtype.str, self.__dlpack_device__(), self)

    def kept_with(self, owner: object) -> "DeviceArray":
        """The same memory, which also keeps ``owner``."""
        return DeviceArray(self.device, self.shape, self.dtype, self.pointer, name=self.name, owner=(self, owner))

    def numpy(self, count: int | None = None) -> Array:
        """A copy on the host, of the first ``count`` rows or all; waits for the device."""
        shape = self.shape if count is None else (count, *self.shape[1:])
        host = np.empty(shape, self.dtype)
        if host.nbytes:
            self.device.call("cuMemcpyDtoHAsync_v2", host.ctypes.data, self.pointer, host.nbytes, self.device.stream)
            self.device.wait()
        return host

    def fill(self, host: Array) -> None:
        """Copy from the host, which may be changed as soon as this returns."""
        host = np.ascontiguousarray(host, self.dtype)
        self._check_room(host.nbytes)
        if host.nbytes:
            self.device.call("cuMemcpyHtoDAsync_v2", self.pointer, host.ctypes.data, host.nbytes, self.device.stream)

    def clear(self) -> None:
        """Set all bytes to zero."""
        if self.nbytes:
            self.device.call("cuMemsetD8Async", self.pointer, 0, self.nbytes, self.device.stream)

    def _check_room(self, num_bytes: int) -> None:
        if num_bytes > self.nbytes:
            raise DeviceError(f"{self.name}: found {num_bytes} bytes, wanted at most {self.nbytes}")


class PinnedArray:
    """A host array that the device reads and writes without anybody waiting; touch it behind an `Event`."""

    def __init__(self, device: "Device", shape: Sequence[int], dtype: npt.DTypeLike) -> None:
        bytes_ = math.prod(shape) * np.dtype(dtype).itemsize
        pointer = ctypes.c_void_p()
        device.call("cuMemAllocHost_v2", ctypes.byref(pointer), bytes_)
        assert pointer.value is not None
        buffer = (ctypes.c_ubyte * bytes_).from_address(pointer.value)
        self.values: Array = np.ctypeslib.as_array(buffer).view(dtype).reshape(shape)
        self._pointer, self._device = pointer, device
        _finally(self, device.give_back, "cuMemFreeHost", pointer)

    def fetch(self, array: DeviceArray) -> None:
        """Copy from the device once it gets there."""
        device = self._device
        device.call("cuMemcpyDtoHAsync_v2", self._pointer, array.pointer, self.values.nbytes, device.stream)

    def send(self, array: DeviceArray) -> None:
        """Copy to the device once it gets there."""
        array._check_room(self.values.nbytes)
        device = self._device
        device.call("cuMemcpyHtoDAsync_v2", array.pointer, self._pointer, self.values.nbytes, device.stream)


class Event:
    """A point in the stream."""

    def __init__(self, device: "Device") -> None:
        self._device, self._handle = device, Handle()
        device.call("cuEventCreate", ctypes.byref(self._handle), NUMBERS["CU_EVENT_DEFAULT"])
        _finally(self, device.give_back, "cuEventDestroy_v2", self._handle)

    def record(self) -> None:
        """Put the point behind all work that was enqueued so far."""
        self._device.call("cuEventRecord", self._handle, self._device.stream)

    def wait(self) -> None:
        """Return when the device has passed the point."""
        self._device.call("cuEventSynchronize", self._handle)

    def has_passed(self) -> bool:
        """Whether the device has passed the point; does not wait."""
        return self._device.call("cuEventQuery", self._handle, allowed=("CUDA_ERROR_NOT_READY",)) == 0

    def milliseconds_since(self, earlier: "Event") -> float:
        """Time between two points that were passed."""
        found = ctypes.c_float()
        self._device.call("cuEventElapsedTime", ctypes.byref(found), earlier._handle, self._handle)
        return found.value


class Graph:
    """Recorded work, launched as one."""

    def __init__(self, device: "Device", handle: Handle) -> None:
        self._device, self._handle = device, Handle()
        try:
            device.call("cuGraphInstantiateWithFlags", ctypes.byref(self._handle), handle, 0)
        finally:
            device.call("cuGraphDestroy", handle)
        _finally(self, device.give_back, "cuGraphExecDestroy", self._handle)

    def launch(self) -> None:
        """Enqueue all of it."""
        self._device.call("cuGraphLaunch", self._handle, self._device.stream)


class Device:
    """One GPU: its memory, its stream, its kernels."""

    def __init__(self, driver: Driver, cubin_of: Callable[[str, str], bytes], *, ordinal: int = 0) -> None:
        """``cubin_of(stage, architecture)`` compiles a file of kernels (kernels/cuda/compile.py)."""
        self.driver, self.ordinal, self._cubin_of = driver, ordinal, cubin_of
        device = ctypes.c_int()
        count = ctypes.c_int()
        driver("cuDeviceGetCount", ctypes.byref(count))
        if not 0 <= ordinal < count.value:
            raise DeviceError(f"GPU {ordinal}: the driver found {count.value}; use device 'cpu', or attach one")
        driver("cuDeviceGet", ctypes.byref(device), ordinal)
        name = ctypes.create_string_buffer(128)
        driver("cuDeviceGetName", name, 128, device)
        self.name = name.value.decode()
        major, minor, self.num_multiprocessors = (
            self._attribute(device, attribute)
            for attribute in ("COMPUTE_CAPABILITY_MAJOR", "COMPUTE_CAPABILITY_MINOR", "MULTIPROCESSOR_COUNT")
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
        self._own_stream = Handle()
        self.call("cuStreamCreate", ctypes.byref(self._own_stream), NUMBERS["CU_STREAM_NON_BLOCKING"])
        self._used_stream = self._own_stream
        self._turn = Handle()
        self.call("cuEventCreate", ctypes.byref(self._turn), NUMBERS["CU_EVENT_DISABLE_TIMING"])
        self._recording = False
        self._modules: dict[str, Handle] = {}
        self._kernels: dict[str, tuple[Handle, int]] = {}

    def call(self, name: str, *arguments: Any, allowed: tuple[str, ...] = ()) -> int:
        """Call a function of the driver in the device's context; what it returned, 0 or an error that is allowed."""
        code = self._result_of(name, *arguments)
        if code and code not in [NUMBERS[error] for error in allowed]:
            raise self.driver.error(name, code)
        return code

    def give_back(self, name: str, handle: Address | Handle) -> None:
        """Call a function that frees something; a context that has failed refuses, and its memory goes with it."""
        self._result_of(name, handle)

    @property
    def stream(self) -> Handle:
        """Where work goes: torch's current stream if torch is in use, else our own, also while recording."""
        if self._recording:
            return self._own_stream
        torch = sys.modules.get("torch")
        stream = self._own_stream
        if torch is not None and torch.cuda.is_initialized():
            stream = Handle(torch.cuda.current_stream(self.ordinal).cuda_stream)
        if stream.value != self._used_stream.value:
            self.let_wait(stream)
            self._used_stream = stream
        return stream

    def let_wait(self, stream: Handle) -> None:
        """Let what is enqueued to another stream from now on wait for all our work so far, on the device."""
        self.call("cuEventRecord", self._turn, self._used_stream)
        self.call("cuStreamWaitEvent", stream, self._turn, 0)

    def wait_for(self, stream: Handle) -> None:
        """Let our work from now on wait for what was enqueued to another stream so far, on the device."""
        self.call("cuEventRecord", self._turn, stream)
        self.call("cuStreamWaitEvent", self.stream, self._turn, 0)

    def empty(self, shape: Sequence[int], dtype: npt.DTypeLike, *, name: str = "") -> DeviceArray:
        """Memory for an array, freed with it."""
        num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
        array = DeviceArray(self, shape, dtype, self._allocate(max(num_bytes, 16), name), name=name)
        _finally(array, self.give_back, "cuMemFree_v2", Address(array.pointer))
        return array

    def upload(self, host: Array, *, name: str = "") -> DeviceArray:
        """A copy of a host array."""
        array = self.empty(host.shape, host.dtype, name=name)
        array.fill(host)
        return array

    def pinned(self, shape: Sequence[int], dtype: npt.DTypeLike) -> PinnedArray:
        """Host memory for what the device reads or reports."""
        return PinnedArray(self, shape, dtype)

    def event(self) -> Event:
        """A point in the stream, not yet recorded."""
        return Event(self)

    def owns(self, address: int) -> bool:
        """Whether an address lies in the memory of this GPU."""
        found = ctypes.c_int()
        attribute = NUMBERS["CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL"]
        allowed = ("CUDA_ERROR_INVALID_VALUE",)  # not of any GPU
        code = self.call("cuPointerGetAttribute", ctypes.byref(found), attribute, address, allowed=allowed)
        return code == 0 and found.value == self.ordinal

    def launch(self, kernel: str, num_thread_blocks: int, job: DeviceArray, argument: int = 0) -> None:
        """Enqueue a kernel; each takes the address of a job and a number."""
        function, threads = self._kernel(kernel)
        pointer, number = Address(job.pointer), ctypes.c_int(argument)
        arguments = (ctypes.c_void_p * 2)(ctypes.addressof(pointer), ctypes.addressof(number))
        sizes = (max(num_thread_blocks, 1), 1, 1, threads, 1, 1, 0)
        self.call("cuLaunchKernel", function, *sizes, self.stream, arguments, None)

    def prepare(self, kernels: Sequence[str]) -> None:
        """Load kernels before they are used: loading makes the host wait."""
        for kernel in kernels:
            self._kernel(kernel)

    @contextmanager
    def recorded(self) -> Iterator[list[Graph]]:
        """Record what is enqueued within; the list then holds the graph.

        In the relaxed mode, because the garbage collector may free memory of others meanwhile, which other modes forbid.
        """
        graphs: list[Graph] = []
        handle = Handle()
        self._recording = True
        try:
            self.call("cuStreamBeginCapture_v2", self._own_stream, NUMBERS["CU_STREAM_CAPTURE_MODE_RELAXED"])
            try:
                yield graphs
            finally:
                self.call("cuStreamEndCapture", self._own_stream, ctypes.byref(handle))
        finally:
            self._recording = False
        graphs.append(Graph(self, handle))

    def wait(self) -> None:
        """Return when the device has done all that was enqueued."""
        self.call("cuStreamSynchronize", self.stream)

    def _result_of(self, name: str, *arguments: Any) -> int:
        """Call a function with the context current in this thread; what was current before is so again afterwards."""
        before = Handle()
        self.driver("cuCtxGetCurrent", ctypes.byref(before))
        if before.value == self._context.value:
            return self.driver.result_of(name, *arguments)
        self.driver("cuCtxSetCurrent", self._context)
        try:
            return self.driver.result_of(name, *arguments)
        finally:
            self.driver("cuCtxSetCurrent", before)

    def _attribute(self, device: ctypes.c_int, attribute: str) -> int:
        found = ctypes.c_int()
        self.driver("cuDeviceGetAttribute", ctypes.byref(found), NUMBERS[f"CU_DEVICE_ATTRIBUTE_{attribute}"], device)
        return found.value

    def _kernel(self, name: str) -> tuple[Handle, int]:
        if name not in self._kernels:
            stage = stage_of(name)
            if stage not in self._modules:
                module = Handle()
                self.call("cuModuleLoadData", ctypes.byref(module), self._cubin_of(stage, self.architecture))
                self._modules[stage] = module
            function = Handle()
            self.call("cuModuleGetFunction", ctypes.byref(function), self._modules[stage], name.encode())
            self._kernels[name] = function, threads_of(name)
        return self._kernels[name]

    def _allocate(self, num_bytes: int, name: str) -> int:
        pointer = Address()
        self.call("cuMemAlloc_v2", ctypes.byref(pointer), num_bytes)
        return pointer.value


def _finally(owner: object, work: Callable[..., None], *arguments: Any) -> None:
    """Give something back when its owner goes; what is left at the end of the process goes with it."""
    weakref.finalize(owner, work, *arguments).atexit = False
