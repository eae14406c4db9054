"""Pictures of cameras with a lens: drawn by the pinhole that sees all that the camera shows, then bent (scene/warp.py)."""

from dataclasses import replace

import numpy as np

from splatree.scene.cameras import Camera, check_is_camera
from splatree.scene.frame import RenderResult
from splatree.scene.warp import bend, covering_pinhole

__all__ = ["pinhole_of", "through_lens"]


def pinhole_of(camera: Camera) -> Camera:
    """The camera that the stages of a frame are asked for: the camera itself, or the pinhole that stands for its lens."""
    check_is_camera(camera)
    return camera if camera.lens is None else covering_pinhole(camera)


def through_lens(flat: RenderResult, pinhole: Camera, camera: Camera) -> RenderResult:
    """The picture of a camera from that of its pinhole; alpha is bent like colour, depth where something is drawn."""
    if camera.lens is None:
        return flat
    image, alpha = bend(flat.image, pinhole, camera), bend(flat.alpha, pinhole, camera)
    weighted = bend(flat.depth * flat.alpha, pinhole, camera)
    depth = np.divide(weighted, alpha, out=np.zeros_like(alpha), where=alpha > 0)
    return replace(flat, image=image, alpha=alpha, depth=depth)
