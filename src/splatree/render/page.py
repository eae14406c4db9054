"""What HTML pages with pictures are made of: a template filled in, and a picture inside the page."""

import base64
import io
from importlib.resources import files
from string import Template

import numpy as np

from splatree.shapes import Array, Float32

__all__ = ["data_uri", "filled"]


def filled(template: str, **values: str) -> str:
    """A template of the package's data with its ``$names`` replaced; ``$style`` is the look that all pages share."""
    data = files("splatree") / "data"
    style = (data / "style.css").read_text(encoding="utf-8")
    return Template((data / template).read_text(encoding="utf-8")).substitute(values, style=style)


def data_uri(image: Float32[Array, "h w 3"]) -> str:
    """The picture as a JPEG in an address, so that the page needs no other file."""
    from PIL import Image

    buffer = io.BytesIO()
    pixels = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
    Image.fromarray(pixels).save(buffer, "JPEG", quality=90, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
