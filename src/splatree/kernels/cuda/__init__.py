"""The stages on a GPU: kernels (*.cu) compiled at first use, and Python that launches them through the driver.

::

    sources.py   what device code there is           library.py    the CUDA driver's functions (driver.h), and its errors
    compile.py   NVRTC, and the cache of its output  driver.py     a GPU: memory, streams, launches, graphs
    device.py    the GPU of this process             job.py        the struct that every kernel takes
    plan.py      the launches of a frame             workspace.py  its arrays
    renderer.py  a frame that stays on the device    stages.py     the stages one by one, as other back ends have them
    loss.py      the loss against a photograph       optimise.py   a step of the optimiser

Nothing here is loaded by ``import splatree``.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatree.kernels.contract import FrameStages, HeldScene
    from splatree.kernels.cuda.driver import DeviceArray
    from splatree.shapes import Array

__all__ = ["borrow", "frame_stages", "hold", "kmeans_steps"]


def frame_stages() -> "FrameStages":
    """The stages of a frame and of training on the first GPU."""
    from splatree.kernels.cuda.device import open_device
    from splatree.kernels.cuda.stages import Stages

    return Stages(open_device(0))


def hold(*scene: Any) -> "HeldScene":
    """A scene in the memory of a GPU (`device.hold`)."""
    from splatree.kernels.cuda import device

    return device.hold(*scene)


def borrow(tensors: Mapping[str, Any]) -> "dict[str, DeviceArray]":
    """Tensors on a GPU as arrays, without a copy (`device.borrow`)."""
    from splatree.kernels.cuda import device

    return device.borrow(tensors)


def kmeans_steps(points: "Array", *, threads: int, zeros: "Callable[..., Array]") -> "Callable[[Array], Any]":
    """A step of K-means on the first GPU: assigns the points to centres; ``threads`` and ``zeros`` are not used."""
    from splatree.kernels.cuda.device import open_device
    from splatree.kernels.cuda.kmeans import DevicePoints

    return DevicePoints(open_device(0), points).assign
