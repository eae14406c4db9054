"""Pictures drawn on the server, as files: colours, depth or alpha, as JPEG or PNG."""

import io
from typing import Literal

import numpy as np

from splatree.scene.frame import RenderResult
from splatree.shapes import Array, Float32, UInt8

__all__ = ["Layer", "Packing", "encode", "layer_of", "pixels_of"]

Layer = Literal["color", "depth", "alpha"]
"""What a picture shows."""

Packing = Literal["jpeg", "png"]
"""How a picture is sent: small, or bit for bit."""

FINE_QUALITY = 92
"""From this quality on a JPEG keeps its colours at full resolution."""


def encode(pixels: UInt8[Array, "h w 3"], packing: Packing, quality: int) -> bytes:
    """A picture as a file; ``quality`` 1 to 100 is that of the JPEG."""
    from PIL import Image

    file = io.BytesIO()
    if packing == "png":
        Image.fromarray(pixels).save(file, "PNG", compress_level=1)
    else:
        Image.fromarray(pixels).save(file, "JPEG", quality=quality, subsampling=0 if quality >= FINE_QUALITY else 2)
    return file.getvalue()


def layer_of(result: RenderResult, layer: Layer) -> UInt8[Array, "h w 3"]:
    """A layer of a picture in 8 bits: near is bright in a depth map, and what nothing covers is black."""
    if layer == "color":
        image = result.image
    elif layer == "alpha":
        image = np.repeat(result.alpha[..., None], 3, axis=2)
    else:
        image = _depth_map(result.depth, result.alpha)
    return pixels_of(image)


def pixels_of(image: Float32[Array, "h w 3"]) -> UInt8[Array, "h w 3"]:
    """Colours in 8 bits."""
    return np.asarray(np.rint(255 * np.clip(image, 0, 1)), np.uint8)


def _depth_map(depth: Array, alpha: Array) -> Float32[Array, "h w 3"]:
    """Logarithms of depths from the 2nd to the 98th percentile as greys, nearest white."""
    covered = (alpha > 0.05) & (depth > 0)
    if not covered.any():
        return np.zeros((*depth.shape, 3), np.float32)
    logs = np.log(np.where(covered, depth, 1))
    near, far = np.percentile(logs[covered], (2, 98))
    grey = np.where(covered, 0.08 + 0.92 * np.clip((far - logs) / max(far - near, 1e-6), 0, 1), 0)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.float32)
