"""The GPU of this process, and scenes on it."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from splatree.kernels.cuda.compile import load_compiler
from splatree.kernels.cuda.driver import Device, DeviceArray
from splatree.kernels.cuda.library import load_driver
from splatree.kernels.cuda.renderer import Renderer
from splatree.kernels.cuda.tensors import borrowed, ordinal_of
from splatree.scene.gaussians import Gaussians
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.shapes import Array, UInt32

__all__ = ["borrow", "hold", "open_device"]


@cache
def open_device(ordinal: int) -> Device:
    """The GPU of that number, opened once.

    Raises:
        DeviceError: there is no driver, no GPU or no compiler, or one that is too old; the message says what to do.
    """
    driver = load_driver()
    version = driver.version()
    compiler = load_compiler(version)
    return Device(driver, lambda stage, architecture: compiler.cubin_of(stage, architecture, version), ordinal=ordinal)


def hold(
    gaussians: Gaussians,
    ids: UInt32[Array, "n"] | None,
    tree: GaussianTree,
    blocks: BlockIndex,
    columns: Mapping[str, DeviceArray],
) -> Renderer:
    """A scene in the memory of a GPU; ``columns`` are there already, all others are copied to the GPU that they are on."""
    device = next((column.device for column in columns.values()), None) or open_device(0)
    return Renderer(device, gaussians, tree, blocks, ids, columns=columns)


def borrow(tensors: Mapping[str, Any]) -> dict[str, DeviceArray]:
    """Tensors on one GPU as arrays that keep them, without a copy.

    Raises:
        InputError: a tensor does not give its memory away, or lies elsewhere.
        ShapeError: a tensor is not of float32, not contiguous or not aligned.
    """
    ordinals = {ordinal_of(name, tensor) for name, tensor in tensors.items()}
    (ordinal,) = ordinals
    assert ordinal is not None
    device = open_device(ordinal)
    return {name: borrowed(device, name, tensor) for name, tensor in tensors.items()}
