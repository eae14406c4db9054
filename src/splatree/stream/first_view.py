"""How a stream is looked at first: the view that the library would choose, found from the coarsest piece alone, and the mode."""

import json
from pathlib import Path

from splatree.io.formats.rad.reader import read_first_chunk
from splatree.io.reading import read
from splatree.render.framing.frame import Framing, frame_scene
from splatree.scene.names import Mode
from splatree.scene.scene import Scene

__all__ = ["first_view"]


def first_view(stream: Path) -> tuple[Framing, Mode]:
    """The first view of a stream, given its manifest or its ``.rad``, and how it is drawn.

    Raises:
        InputError: it holds no Gaussians.
        FormatError: it is damaged.
    """
    coarsest = _coarsest(stream)
    return frame_scene(coarsest), coarsest.mode


def _coarsest(stream: Path) -> Scene:
    """The coarsest level, the root tile, or the nodes of the first chunk."""
    if stream.suffix == ".rad":
        return read_first_chunk(stream)
    manifest = json.loads(stream.read_text("utf-8"))
    if stream.name == "tileset.json":
        return read(stream.parent / manifest["root"]["content"]["uri"])
    return read(stream.parent, level=int(manifest["lodLevels"]) - 1)
