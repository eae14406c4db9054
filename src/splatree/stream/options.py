"""How a stream is made; the command line's help is these docstrings."""

import math
from dataclasses import dataclass, fields
from typing import Literal

from splatree.errors import InputError
from splatree.scene.literals import check_literals
from splatree.stream.earth import ecef_from_enu
from splatree.stream.levels import RATIO, check_ladder

__all__ = ["StreamFormat", "StreamOptions"]

StreamFormat = Literal["sog", "rad", "3dtiles"]
"""What viewers load: `sog`, a folder for PlayCanvas, SuperSplat and Babylon.js; `rad`, a file for Spark; `3dtiles`, a folder for
CesiumJS."""


@dataclass(frozen=True)
class StreamOptions:
    """How a stream is cut, and what is kept of the scene.

    Example:
        >>> written = st.stream(scene, "city_stream", options=st.StreamOptions(levels=2))
        >>> len(written.levels)
        2
    """

    ratio: float = RATIO
    """For `sog`: nodes of a level for each node of the next coarser one."""
    levels: int | None = None
    """For `sog`: number of levels; None: as many as it takes until a level has 1/64 of the Gaussians."""
    chunk_leaves: int | None = None
    """For `sog`: Gaussians of a chunk, for which a viewer chooses one level. None: 16,384, and in scenes of less than two
    million so many that there are about 128 chunks, at least 2,048."""
    unit_rows: int | None = None
    """For `sog`: Gaussians of a file of the two finest levels; files of coarser levels have twice as many. None: four chunks."""
    node_px: float | None = None
    """For `sog` and `rad`: extent, px, at which merged nodes are expected to be drawn in a cut of half as many nodes as leaves;
    in smaller cuts they are √2 larger for each halving of the nodes. A viewer with a budget draws nodes larger than they are
    stored for, and shapes and opacities follow from that. None: 12 for `sog`, 4 for `rad`, whose nodes are chosen one by one.
    0 keeps those of the tree, for scenes that the viewer's budget holds whole."""
    errors: bool = False
    """For `sog`: write how far each level of a chunk is from its finest one, by pictures from six sides. PlayCanvas 2.22 chooses
    levels by it in the mode `error`; other versions do not read it."""
    zip: bool = False
    """For `sog`: write one file instead of a folder, a ZIP whose name ends in .ssog, for LichtFeld Studio. Viewers on the web
    need the folder."""
    chunked: bool = False
    """For `rad`: write each chunk of 65,536 nodes as a file of its own beside the header, for hosts that do not answer requests
    for ranges of bytes."""
    tile_nodes: int = 32_768
    """For `3dtiles`: largest number of Gaussians of a tile."""
    origin: tuple[float, float, float] | None = None
    """For `3dtiles`: latitude and longitude, degrees, and height, metres, of the scene's origin; None: 0 0 0. The scene's −y
    points up and its z south."""
    sh_degree: int | None = None
    """Remove the harmonics above this degree; None: keep all."""

    def __post_init__(self) -> None:
        check_literals(self)
        for name, least in (("chunk_leaves", 1), ("unit_rows", 1), ("node_px", 0), ("tile_nodes", 1)):
            value = getattr(self, name)
            if value is not None and not least <= value < math.inf:
                raise InputError(f"{name}: found {value}, wanted at least {least}")
        check_ladder(self.ratio, self.levels)
        if self.sh_degree not in (None, 0, 1, 2, 3):
            raise InputError(f"sh_degree: found {self.sh_degree}, wanted 0 to 3")
        if self.origin is not None:
            ecef_from_enu(*self.origin)

    def check_used(self, format: StreamFormat) -> None:
        """Refuse options that the format does not use.

        Raises:
            InputError: one of them is given.
        """
        default = StreamOptions()
        for field in fields(self):
            value = getattr(self, field.name)
            if format not in _USED_BY[field.name] and value != getattr(default, field.name):
                users = " and ".join(_USED_BY[field.name])
                raise InputError(f"{field.name}: found {value} for the format {format}, but only {users} uses it")


_USED_BY: dict[str, tuple[StreamFormat, ...]] = {
    "ratio": ("sog",),
    "levels": ("sog",),
    "chunk_leaves": ("sog",),
    "unit_rows": ("sog",),
    "node_px": ("sog", "rad"),
    "errors": ("sog",),
    "zip": ("sog",),
    "chunked": ("rad",),
    "tile_nodes": ("3dtiles",),
    "origin": ("3dtiles",),
    "sh_degree": ("sog", "rad", "3dtiles"),
}
