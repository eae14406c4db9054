"""Tensors of other libraries as arrays of a device, without a copy: by DLPack, or else by ``__cuda_array_interface__``.

Both name an address and a layout; DLPack also keeps the memory and sees to it that our stream waits for what fills it. A layout
that kernels cannot read is an error that says how to change it, never a copy that nobody asked for.
"""

import math
from typing import Any

import numpy as np

from splatree.errors import InputError, ShapeError
from splatree.kernels.cpu import _core
from splatree.kernels.cuda.driver import DLPACK_CUDA, Device, DeviceArray
from splatree.kernels.cuda.library import Handle

__all__ = ["borrowed", "ordinal_of"]

ALIGNMENT = 16
"""Kernels read four floats at once."""


def ordinal_of(name: str, tensor: Any) -> int | None:
    """The GPU that a tensor lies on; None: it lies in the memory of the processor.

    Raises:
        InputError: it is no tensor, or lies elsewhere.
    """
    if hasattr(tensor, "__dlpack_device__"):
        kind, ordinal = tensor.__dlpack_device__()
        if kind == DLPACK_CUDA:
            return int(ordinal)
        if kind == 1:  # the processor
            return None
        raise InputError(
            f"{name}: found a tensor on a device of DLPack's kind {int(kind)}, wanted CUDA or the processor"
        )
    if hasattr(tensor, "__cuda_array_interface__"):
        return 0  # it does not say which; `borrowed` asks the driver
    raise InputError(
        f"{name}: found {type(tensor).__name__}, wanted a tensor with DLPack or __cuda_array_interface__, as torch's"
    )


def borrowed(device: Device, name: str, tensor: Any) -> DeviceArray:
    """A float32 tensor on the device as an array, which keeps it.

    Raises:
        InputError: the tensor does not give its memory away, as one that requires gradients, or it lies elsewhere.
        ShapeError: it is not of float32, not contiguous or not aligned.
    """
    pointer, shape, contiguous, dtype, owner = (
        _by_dlpack(device, name, tensor) if hasattr(tensor, "__dlpack__") else _by_interface(device, name, tensor)
    )
    if dtype != "float32":
        raise ShapeError(f"{name}: found a tensor of {dtype}, wanted float32; convert it with .float()")
    if not contiguous:
        raise ShapeError(f"{name}: found a strided tensor, wanted a contiguous one; use .contiguous()")
    if pointer % ALIGNMENT:
        raise ShapeError(
            f"{name}: found a tensor at an address that is no multiple of {ALIGNMENT} bytes, as a part of another; use .clone()"
        )
    return DeviceArray(device, shape, np.float32, pointer, name=name, owner=owner)


def _by_dlpack(device: Device, name: str, tensor: Any) -> tuple[int, list[int], bool, str, object]:
    try:
        capsule = tensor.__dlpack__(stream=device.stream.value or 1)  # 0 is not allowed: 1 is the default stream
    except (BufferError, RuntimeError) as error:
        raise InputError(f"{name}: the tensor does not give its memory away: {error}; use .detach()") from error
    pointer, shape, contiguous, dtype, _, keeper = _core.import_tensor(capsule)
    return pointer, shape, contiguous, dtype, keeper


def _by_interface(device: Device, name: str, tensor: Any) -> tuple[int, list[int], bool, str, object]:
    found = tensor.__cuda_array_interface__
    dtype, shape, pointer = np.dtype(found["typestr"]), found["shape"], found["data"][0]
    if math.prod(shape) and not device.owns(pointer):
        raise InputError(
            f"{name}: found an address that is not in the memory of GPU {device.ordinal}, wanted all there"
        )
    steps = [dtype.itemsize * int(np.prod(shape[i + 1 :])) for i in range(len(shape))]
    strides = found.get("strides")
    contiguous = strides is None or all(n == 1 or a == b for n, a, b in zip(shape, strides, steps, strict=True))
    if found.get("stream") is not None:
        device.wait_for(Handle(found["stream"]))
    return pointer, list(shape), contiguous, dtype.name, tensor
