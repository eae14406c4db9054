"""Pictures: photographs read for evaluation, renders written as PNG. Colours are the file's own, sRGB as it is."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from splatree.errors import FormatError, InputError, ShapeError
from splatree.io.exr import SOFTWARE, write_exr
from splatree.io.foreign import not_content
from splatree.io.replacing import replacing
from splatree.scene.arguments import checked
from splatree.shapes import Array, Float32, UInt8

if TYPE_CHECKING:
    from PIL import Image, PngImagePlugin

    _Converted = TypeVar("_Converted", Image.Image, Image.Image | None)

_HEAD_BYTES = 1024
"""Text entries stand before the pixels."""


_EFFORT = 2
"""Effort of zlib: pictures of a city are as small as by the usual 6, in a quarter of the time."""

_ORIENTATION = 0x0112
"""Tag of EXIF that says how a picture is to be turned and mirrored, 1 to 8."""


@checked
def read_image(
    path: str | os.PathLike[str], *, size: tuple[int, int] | None = None, turned: bool = False
) -> Float32[Array, "h w 3"]:
    """Read a picture as RGB, 0 to 1; alpha is blended over black.

    Args:
        path: PNG, JPEG, WebP or another format that Pillow opens.
        size: width and height, px, to which the picture is resampled: each pixel is the mean of what it covers. None: unchanged.
        turned: turn and mirror the picture as its EXIF orientation says. COLMAP and the code of 3DGS do not, other tools do.

    Returns:
        float32 (h w 3), in the colour space of the file.

    Raises:
        InputError: there is no such file.
        FormatError: the file is no picture, or is damaged.

    Example:
        >>> st.write_image(np.ones((4, 6, 3), np.float32), "white.png", force=True)
        >>> st.read_image("white.png").shape
        (4, 6, 3)
    """
    return read_pixels(path, size=size, turned=turned) / np.float32(255)


def read_pixels(
    path: str | os.PathLike[str], *, size: tuple[int, int] | None = None, turned: bool = False
) -> UInt8[Array, "h w 3"]:
    """As `read_image`, 0 to 255. Grey becomes RGB, and 16 bits a pixel are rounded to 8."""
    return np.array(_loaded(path, _as_rgb, size, turned))


def read_opacity(
    path: str | os.PathLike[str], *, size: tuple[int, int] | None = None, turned: bool = False
) -> UInt8[Array, "h w"] | None:
    """The alpha channel of a picture, 0 to 255, resampled as `read_image` does; None if it has none."""
    with_alpha = _loaded(path, lambda image: image.convert("RGBA") if _has_alpha(image) else None, size, turned)
    return None if with_alpha is None else np.asarray(with_alpha)[..., 3].copy()


def _loaded(
    path: str | os.PathLike[str],
    convert: "Callable[[Image.Image], _Converted]",
    size: tuple[int, int] | None,
    turned: bool,
) -> "_Converted":
    from PIL import Image, ImageOps

    file = _existing(path)
    try:
        with Image.open(file) as opened:
            image = convert(ImageOps.exif_transpose(opened) if turned else opened)
            if image is not None and size is not None and image.size != size:
                image = image.resize(size, Image.Resampling.BOX)
            return image
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{file}: {_fault(file, error)}") from error


def _has_alpha(image: "Image.Image") -> bool:
    return image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info


def _as_rgb(image: "Image.Image") -> "Image.Image":
    from PIL import Image

    if _has_alpha(image):
        rgba = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", rgba.size, (0, 0, 0, 255)), rgba)
    elif image.mode.startswith("I;16") or (image.mode == "I" and image.format == "PNG"):  # Pillow would clip at 255
        image = Image.fromarray(np.rint(np.asarray(image) / 257).astype(np.uint8))
    elif image.mode in ("I", "F"):
        raise FormatError(
            f"{getattr(image, 'filename', 'picture')}: found 32 bits a pixel, which have no defined range; wanted 8 or 16 bits"
        )
    return image.convert("RGB")


def image_head(path: str | os.PathLike[str]) -> tuple[tuple[int, int], int]:
    """Width and height in px as stored, and the EXIF orientation, 1 (upright) if there is none; from the header alone."""
    from PIL import Image

    file = _existing(path)
    try:
        with Image.open(file) as image:
            orientation = image.getexif().get(_ORIENTATION, 1)
            return image.size, orientation if orientation in range(1, 9) else 1
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        raise FormatError(f"{file}: {_fault(file, error)}") from error


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Width and height in px as stored, from the header alone."""
    return image_head(path)[0]


@checked
def write_image(image: Float32[Array, "h w 3"], path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write RGB or grey, 0 to 1, as PNG with 8 bits a channel; values are clipped and rounded.

    Args:
        image: float32 (h w 3), or (h w).
        path: the new file, .png.
        force: replace the file if it exists.

    Raises:
        InputError: the suffix is not .png, or the picture holds NaN.
        ShapeError: the picture has another shape, no pixel, or no floats.
        OutputError: the file exists and ``force`` is not set, or it cannot be written.

    Example:
        >>> st.write_image(st.render(scene, camera).image, "picture.png", force=True)
    """
    from PIL import Image

    if Path(path).suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are written as PNG, wanted the suffix .png")
    if not isinstance(image, np.ndarray):
        raise ShapeError(f"write_image: found {type(image).__name__}, wanted a NumPy array (h w 3) or (h w) of floats")
    if not ((image.ndim == 3 and image.shape[2] == 3) or image.ndim == 2) or 0 in image.shape:
        raise ShapeError(f"write_image: found shape {image.shape}, wanted (h w 3) or (h w) with at least one pixel")
    if image.dtype.kind != "f":
        raise ShapeError(f"write_image: found dtype {image.dtype.name}, wanted floats from 0 to 1; divide bytes by 255")
    if np.isnan(image).any():
        raise InputError(f"{path}: found NaN in the picture, wanted numbers")
    pixels = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        Image.fromarray(pixels).save(file, format="PNG", compress_level=_EFFORT, pnginfo=_signed())


def write_plane(
    plane: Float32[Array, "h w"], path: str | os.PathLike[str], *, channel: str, force: bool = False
) -> None:
    """Write one float32 plane, of depth or alpha: as it is into an .exr, or as PNG of 16 bits.

    A PNG holds steps of ``largest value / 65535``, rounded; its text entry ``step`` says how much a step is.

    Args:
        plane: values of at least 0.
        path: a file with the suffix .png or .exr.
        channel: name of the channel in an .exr: "Z" for depth, "A" for alpha.
        force: replace the file if it exists.
    """
    from PIL import Image

    if Path(path).suffix.lower() == ".exr":
        write_exr({channel: plane}, path, force=force)
        return
    if Path(path).suffix.lower() != ".png":
        raise InputError(f"{path}: planes are written as PNG or EXR, wanted the suffix .png or .exr")
    if not np.isfinite(plane).all() or plane.min(initial=0) < 0:
        raise InputError(f"{path}: found values that are negative or not finite, wanted at least 0; write an .exr")
    step = max(float(plane.max(initial=0)), 1e-30) / 65535
    steps = np.rint(plane.astype(np.float64) / step).astype(np.uint16)
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        Image.fromarray(steps).save(file, format="PNG", pnginfo=_signed(step=f"{step:.9g}"))


def is_ours(path: Path) -> bool:
    """Whether a picture, PNG or EXR, says that splatree wrote it."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False
    signature = f"Software\0{SOFTWARE}".encode() if path.suffix.lower() == ".png" else b"software\0string\0"
    return signature in head and SOFTWARE.encode() in head


def _signed(**entries: str) -> "PngImagePlugin.PngInfo":
    """Text entries of a PNG: who wrote it, and others."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    for name, text in {"Software": SOFTWARE, **entries}.items():
        info.add_text(name, text)
    return info


def _fault(file: Path, error: Exception) -> str:
    with file.open("rb") as opened:
        content = not_content(opened.read(4096))
    return content or f"not a whole picture ({error})"


def _existing(path: str | os.PathLike[str]) -> Path:
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{file}: not found, wanted a picture")
    return file
