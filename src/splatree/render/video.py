"""Pictures into a video file: H.264 in MP4 by the ffmpeg program that the extra ``video`` (imageio-ffmpeg) brings."""

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from splatree.errors import InputError, MissingExtraError, OutputError
from splatree.io.replacing import replacing
from splatree.scene.arguments import checked
from splatree.shapes import Array

CRF = 18
"""Constant rate factor of libx264: visually lossless by its documentation; 23 is its default, larger is worse."""


@checked
@contextmanager
def open_video(
    path: str | os.PathLike[str], *, fps: float = 30.0, force: bool = False
) -> Iterator[Callable[[Array], None]]:
    """Write pictures as a video: H.264 in an MP4.

    The file appears when all is written. Values outside 0 to 1 are clipped. The last line or column of an odd size is repeated,
    because the format stores colour for 2 × 2 px.

    Args:
        path: the new file, .mp4.
        fps: pictures a second.
        force: replace the file if it exists.

    Yields:
        A function that takes the next picture, float32 (h w 3); all pictures have one size.

    Raises:
        MissingExtraError: imageio-ffmpeg is not installed.
        InputError: the name does not end in .mp4, or pictures differ in size, or there are none.
        OutputError: the file exists and ``force`` is not set, or it could not be written; an old file is then whole.

    Example:
        >>> with st.open_video("flight.mp4") as add:
        ...     for result in st.render_batch(scene, cameras):
        ...         add(result.image)
    """
    path = Path(path)
    check_video(path, fps)
    program = _find_ffmpeg()
    encoder: subprocess.Popen[bytes] | None = None
    shape: tuple[int, ...] = ()
    with replacing(path, force=force) as partial:

        def add(image: Array) -> None:
            nonlocal encoder, shape
            if encoder is None:
                shape = image.shape
                encoder = _start(program, partial, shape[1] + shape[1] % 2, shape[0] + shape[0] % 2, fps)
            if image.shape != shape:
                raise InputError(
                    f"video {path}: found a picture of shape {image.shape} after {shape}, wanted equal sizes"
                )
            pixels = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
            pixels = np.pad(pixels, ((0, shape[0] % 2), (0, shape[1] % 2), (0, 0)), mode="edge")
            assert encoder.stdin is not None
            try:
                encoder.stdin.write(pixels.tobytes())
            except BrokenPipeError:
                raise OutputError(f"video {path}: {_message(encoder)}") from None

        try:
            yield add
            if encoder is None:
                raise InputError(f"video {path}: found no pictures, wanted at least one")
            message = _message(encoder)
            if encoder.returncode != 0:
                raise OutputError(f"video {path}: {message}")
        finally:
            if encoder is not None:
                encoder.kill()
                encoder.communicate()


def check_video(path: Path, fps: float) -> None:
    """Refuse a name or a rate that no video can have.

    Raises:
        InputError: the name does not end in .mp4, or there is less than one picture in 1000 s, or more than 1000 a second.
    """
    if path.suffix.lower() != ".mp4":
        raise InputError(f"video {path}: found suffix {path.suffix!r}, wanted .mp4")
    if not 1e-3 <= fps <= 1e3:
        raise InputError(f"video {path}: found {fps:g} frames a second, wanted 0.001 to 1000")


def _find_ffmpeg() -> str:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise MissingExtraError("imageio-ffmpeg", "video", "writing a video") from error
    return str(imageio_ffmpeg.get_ffmpeg_exe())


def _start(program: str, target: Path, width: int, height: int, fps: float) -> subprocess.Popen[bytes]:
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    coded = [
        "-c:v",
        "libx264",
        "-crf",
        str(CRF),
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
        "-f",
        "mp4",
        str(target),
    ]
    command = [program, "-loglevel", "error", "-y", *source, *coded]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)


def _message(encoder: subprocess.Popen[bytes]) -> str:
    """What a finished encoder complained about last."""
    _, said = encoder.communicate()
    lines = said.decode(errors="replace").strip().splitlines()
    return (
        f"ffmpeg stopped with {encoder.returncode}: {lines[0]}"
        if lines
        else f"ffmpeg stopped with {encoder.returncode}"
    )
