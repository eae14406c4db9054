"""Scenes from tensors of other libraries, for programs that have Gaussians in memory already.

::

    scene = st.scene_from_tensors(means, quats, log_scales, logit_opacities, sh)      torch, CuPy, JAX …
    with st.open_session(scene) as session:
        image = torch.from_dlpack(session.draw_on_device(camera).image)               no copy either way

On a GPU the kernels read the tensors where they lie. A copy on the host is made once, for the index of the selection and for
whatever else is done with the scene: 56 bytes a Gaussian and 12 a coefficient of the harmonics.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.kernels.devices import DLPACK_KINDS, DeviceName, feature_of
from splatree.scene.arguments import checked
from splatree.scene.gaussians import Gaussians
from splatree.scene.literals import check_literals
from splatree.scene.names import Mode
from splatree.scene.scene import Scene
from splatree.shapes import Array

__all__ = ["TensorScene", "scene_from_tensors"]

ON_THE_PROCESSOR: DeviceName = "cpu"
"""Where NumPy's arrays lie."""


@dataclass(frozen=True, eq=False)
class TensorScene:
    """A scene whose columns lie in tensors. `open_session` draws it from where they lie.

    Example:
        >>> g = scene.gaussians
        >>> st.scene_from_tensors(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh).device
        'cpu'
    """

    scene: Scene
    """The scene in the memory of the processor: the tensors themselves, or a copy of what lies on a device."""
    device: DeviceName
    """The device whose memory the tensors lie in."""
    columns: Mapping[str, Any] = field(default_factory=dict)
    """The tensors as arrays of the device, by the names of `Gaussians`; empty if they lie in the processor's memory."""

    def __post_init__(self) -> None:
        check_literals(self)


@checked
def scene_from_tensors(
    means: Any, quats: Any, log_scales: Any, logit_opacities: Any, sh: Any, *, mode: Mode = "classic"
) -> TensorScene:
    """Make a scene of Gaussians that lie in tensors, all on one device.

    On a device the scene is drawn from these very tensors, which it keeps. Do not change them while the scene is used: the index
    that says what is in view is of the values that it found. In the memory of the processor the scene shares them too.

    Args:
        means: float32 (n 3), world units; in the encoding of `Gaussians`, as all columns.
        quats: float32 (n 4), wxyz.
        log_scales: float32 (n 3).
        logit_opacities: float32 (n).
        sh: float32 (n k 3), k in 1, 4, 9, 16.
        mode: how the scene was trained and is drawn.

    Returns:
        The scene, for `open_session`.

    Raises:
        InputError: what is not a tensor, lies elsewhere or requires gradients.
        ShapeError: another type or shape, or a layout that kernels cannot read; the message says how to change it.

    Example:
        >>> g = scene.gaussians
        >>> tensors = st.scene_from_tensors(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh)
        >>> with st.open_session(tensors) as session:
        ...     image = session.draw(camera).image
    """
    tensors = {
        "means": means,
        "quats": quats,
        "log_scales": log_scales,
        "logit_opacities": logit_opacities,
        "sh": sh,
    }
    places = {name: _place_of(name, tensor) for name, tensor in tensors.items()}
    if len(set(places.values())) > 1:
        found = ", ".join(f"{name} on {_in_words(place)}" for name, place in places.items())
        raise InputError(f"scene_from_tensors: found {found}, wanted all on one device")
    device, _ = places["means"]
    borrow = feature_of(device, "borrow")
    if borrow is None:
        arrays = {name: _on_host(name, tensor) for name, tensor in tensors.items()}
        return TensorScene(Scene.flat(Gaussians(**arrays), mode=mode), device)
    columns = borrow(tensors)
    copies = {name: column.numpy() for name, column in columns.items()}
    return TensorScene(Scene.flat(Gaussians(**copies), mode=mode), device, columns)


def _place_of(name: str, tensor: Any) -> tuple[DeviceName, int]:
    """The device that a tensor lies on, and its number there.

    Raises:
        InputError: it is no tensor, or lies elsewhere.
    """
    if hasattr(tensor, "__dlpack_device__"):
        kind, ordinal = tensor.__dlpack_device__()
        if int(kind) not in DLPACK_KINDS:
            raise InputError(
                f"{name}: found a tensor on a device of DLPack's kind {int(kind)}, wanted CUDA or the processor"
            )
        return DLPACK_KINDS[int(kind)], int(ordinal)
    if hasattr(tensor, "__cuda_array_interface__"):
        return DLPACK_KINDS[CUDA_KIND], 0  # it does not say which GPU; the back end asks the driver
    raise InputError(
        f"{name}: found {type(tensor).__name__}, wanted a tensor with DLPack or __cuda_array_interface__, as torch's"
    )


CUDA_KIND = 2
"""The kind of device of ``__cuda_array_interface__``, by DLPack's number."""


def _on_host(name: str, tensor: Any) -> Array:
    if isinstance(tensor, np.ndarray):
        return tensor
    try:
        return np.from_dlpack(tensor)
    except (BufferError, RuntimeError) as error:
        raise InputError(f"{name}: the tensor does not give its memory away: {error}; use .detach()") from error


def _in_words(place: tuple[DeviceName, int]) -> str:
    device, ordinal = place
    return "the processor" if device == ON_THE_PROCESSOR else f"GPU {ordinal}"
