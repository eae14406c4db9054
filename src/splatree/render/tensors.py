"""Scenes from tensors, and pictures that stay on the GPU: for programs that have both there already.

::

    scene = st.scene_from_tensors(means, quats, log_scales, logit_opacities, sh)     torch, CuPy, JAX …
    image = torch.from_dlpack(st.draw(scene, camera).image)                          no copy either way

On a GPU the kernels read the tensors where they lie. A copy on the host is made once, for the index of the selection and for
whatever else is done with the scene: 56 bytes a Gaussian and 12 a coefficient of the harmonics.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cuda.device import keep_on_device, renderer_of
from splatree.kernels.cuda.renderer import DevicePicture
from splatree.kernels.cuda.tensors import borrowed, ordinal_of
from splatree.lod.select import for_levels
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Mode, Scene
from splatree.shapes import Array

__all__ = ["draw", "scene_from_tensors"]


def scene_from_tensors(
    means: Any, quats: Any, log_scales: Any, logit_opacities: Any, sh: Any, *, mode: Mode = "classic"
) -> Scene:
    """A scene of Gaussians that lie in tensors, of float32 in the shapes and encodings of `Gaussians`, all on one device.

    On a GPU the scene is drawn there from these very tensors, which it keeps. Do not change them while the scene is used: the
    index that says what can be seen is of the values that it found. In the memory of the processor the scene shares them too.

    Raises:
        InputError: what is not a tensor, lies elsewhere or requires gradients.
        ShapeError: another type or shape, or a layout that kernels cannot read; the message says how to change it.
    """
    columns = {
        "means": means,
        "quats": quats,
        "log_scales": log_scales,
        "logit_opacities": logit_opacities,
        "sh": sh,
    }
    places = {name: ordinal_of(name, column) for name, column in columns.items()}
    if len(set(places.values())) > 1:
        found = ", ".join(f"{name} on {_in_words(place)}" for name, place in places.items())
        raise InputError(f"scene_from_tensors: found {found}, wanted all on one device")
    ordinal = places["means"]
    if ordinal is None:
        return Scene.flat(Gaussians(*(_on_host(name, column) for name, column in columns.items())), mode=mode)
    return keep_on_device(
        ordinal, mode, lambda device: {n: borrowed(device, n, column) for n, column in columns.items()}
    )


def draw(
    scene: Scene, camera: Camera, options: RenderOptions | None = None, select: SelectOptions | None = None
) -> DevicePicture:
    """Draw a view of a scene that is on the GPU like `render`, and leave the picture there; waits until it is drawn.

    Its ``image``, ``alpha`` and ``depth`` are taken by ``torch.from_dlpack`` and the like without a copy. They keep their
    memory; once nothing keeps them, it serves the next picture. If torch is in use, all work goes to its current stream.

    Raises:
        InputError: the scene is on the processor, or the options are not of the rule `cut` without a budget.
    """
    if scene.device != "cuda":
        raise InputError("draw: found a scene on the processor, wanted one on the GPU: scene.to('cuda'); or use render")
    resolved = (options or RenderOptions()).resolved(scene)
    select = for_levels(select or SelectOptions(), scene)
    if resolved.is_square and select.view_test == "footprint":
        select = replace(select, view_test="none")  # the projection drops what squares do not show
    return renderer_of(scene).draw(camera, resolved, select)


def _on_host(name: str, tensor: Any) -> Array:
    if isinstance(tensor, np.ndarray):
        return tensor
    try:
        return np.from_dlpack(tensor)
    except (BufferError, RuntimeError) as error:
        raise InputError(f"{name}: the tensor does not give its memory away: {error}; use .detach()") from error


def _in_words(place: int | None) -> str:
    return "the processor" if place is None else f"GPU {place}"
