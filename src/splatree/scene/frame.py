"""What each stage of a frame leaves behind: culling, selection, splats, tile bins, picture.

`render` drops the intermediates, `trace` keeps them in a `Frame`; tests, overlays, evaluation and simulators read these.

A picture can have more outputs than colour, alpha and depth. To add one of each pixel: a field of `scene.view.Wanted`; one of
`Picture` and its type in `PIXEL_OUTPUTS`; its definition in kernels/reference/blend.py; for the processor blend.h, blend.cpp and
bind_render.cpp in kernels/cpu/frame; for a GPU job.h and blend.cu in kernels/cuda.
"""

from dataclasses import dataclass

import numpy as np

from splatree.constants import TILE_PX
from splatree.scene.cameras import Camera
from splatree.scene.clusters import Culling
from splatree.scene.literals import check_literals
from splatree.scene.names import Profile
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Int32, Int64, check_fields, in_short


@dataclass(frozen=True, eq=False)
class Selection:
    """The rows drawn for a view: the nodes of a cut that can be in the picture.

    Example:
        >>> selection = st.select(scene, camera, st.SelectOptions(pixel_error=4))
        >>> selection.rule, selection.pixel_error
        ('cut', 4)
    """

    rows: Int32[Array, "v"]
    """Rows of the scene, ascending, none twice."""
    rule: str
    """Rule that chose the rows (docs/explanation/select.md)."""
    profile: Profile | None
    """Function that gave the radii; None: the method that chose the rows compares no radius."""
    pixel_error: float
    """τ_R, px: a node whose radius is at most this stands for its subtree. With a budget, the value that was reached."""
    num_visited: int = 0
    """Number of rows that the selection looked at."""
    notes: tuple[str, ...] = ()
    """Warnings about this selection, for instance that the pixel error is too small to choose any level."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        check_literals(self)
        check_fields(self)

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True, eq=False)
class CutRange:
    """The rows of all cuts of a range of limits, each with the limits at which it is drawn.

    A limit is what sizes of nodes are compared with: (τ_R / 3)², px²; with the profile `sphere` τ_R, px.
    """

    rows: Int32[Array, "v"]
    """Rows of the scene, ascending, none twice."""
    enters: Float32[Array, "v"]
    """The least limit that draws each row: its size, 0 if the finest limit does."""
    leaves: Float32[Array, "v"]
    """The limit from which on it is not drawn, as an ancestor is; beyond the coarsest limit if that draws it."""
    num_visited: int = 0
    """Number of rows that were looked at."""

    def __post_init__(self) -> None:
        check_fields(self)

    def at(self, limit: float) -> Int32[Array, "w"]:
        """The rows that a limit of the range draws."""
        return self.rows[(self.enters <= limit) & (limit < self.leaves)]


@dataclass(frozen=True, eq=False)
class Splats:
    """Projected Gaussians that touch the image, in the order of their rows, and their order by depth.

    A splat is one record of 64 bytes, a cache line, because the blend visits them in no order of memory; its columns have
    names below. The conic is kept as its triangular factor L = ((a, b), (0, c)), with which the opacity at offset d from the
    centre is o exp(-½ |L d|²): the quadratic form of a long thin splat would cancel in float32, a sum of squares cannot.
    """

    rows: Int32[Array, "v"]
    """Row of the scene that each splat comes from, ascending if the selection is."""
    records: Float32[Array, "v 16"]
    """Centre x y, factor a b c, opacity, its log2, colour r g b, depth, half width and height of the box, three unused."""
    order: Int32[Array, "v"]
    """Splats from the nearest to the farthest; equal depths by the row's id."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        check_fields(self)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def means_px(self) -> Float32[Array, "v 2"]:
        """Centre on the image, px; the centre of the first pixel is (½, ½)."""
        return self.records[:, 0:2]

    @property
    def factors(self) -> Float32[Array, "v 3"]:
        """Entries a, b, c of the triangular factor L of the conic LᵀL, px⁻¹."""
        return self.records[:, 2:5]

    @property
    def conics(self) -> Float32[Array, "v 3"]:
        """Inverse of the dilated 2D covariance, px⁻²: the entries 00, 01, 11 (computed)."""
        a, b, c = self.factors.T
        return np.stack([a * a, a * b, b * b + c * c], axis=1)

    @property
    def opacities(self) -> Float32[Array, "v"]:
        """Opacity at the centre after antialiasing compensation, 0 to 1."""
        return self.records[:, 5]

    @property
    def colors(self) -> Float32[Array, "v 3"]:
        """Linear sum of the harmonics + ½, clipped below at 0."""
        return self.records[:, 7:10]

    @property
    def depths(self) -> Float32[Array, "v"]:
        """View depth of the centre, world units."""
        return self.records[:, 10]

    @property
    def half_sizes_px(self) -> Float32[Array, "v 2"]:
        """Half width and half height, px, of the box outside of which no pixel is drawn."""
        return self.records[:, 11:13]


@dataclass(frozen=True, eq=False)
class TileBins:
    """For each tile of 16 × 16 px, the splats whose ellipse touches it, nearest first."""

    tile_start: Int64[Array, "t+1"]
    """Pairs of tile ``t`` are ``tile_start[t] : tile_start[t + 1]``; tiles row by row."""
    splat_from_pair: Int32[Array, "m"]
    """Index into the `Splats`."""
    num_tiles_x: int
    """Tiles in a row of the image."""
    num_tiles_y: int
    """Rows of tiles."""
    floors: Float32[Array, "v"] | None = None
    """Floor of each splat, 1/255 to τ: its largest opacity in a tile that it is not listed in; None: no splat is tapered."""

    def __post_init__(self) -> None:
        check_fields(self, t=self.num_tiles_x * self.num_tiles_y)

    @property
    def num_pairs(self) -> int:
        """N_P: pairs of splat and tile."""
        return len(self.splat_from_pair)


@dataclass(frozen=True, eq=False)
class TileWork:
    """What the blend did in each tile of 16 × 16 px, tiles row by row.

    A pixel reads the entries of its tile's list from the first to the one that finishes it, or to the end of the list; the entry
    that finishes it, which would leave a transmittance below 1e-4, is read but not drawn. By this definition ``consumed`` and
    ``evaluated`` follow from the lists alone. They are counted so if `Wanted.last_pair` is set, and then every back end has the
    same numbers; otherwise they are what a back end really did to draw the picture, which depends on how it works: it may look
    only now and then whether a tile is finished, and may skip pixels that a splat cannot touch.
    """

    consumed: Int64[Array, "t"]
    """Entries that the pixels of the tile read: the largest number over its pixels."""
    evaluated: Int64[Array, "t"]
    """Evaluations of a splat's opacity at a pixel: the sum of the entries that each pixel reads."""
    blended: Int64[Array, "t"]
    """Evaluations that were added to a pixel; the same in every back end, whatever is wanted."""
    is_exact: bool = False
    """Whether ``consumed`` and ``evaluated`` are counted by the definition above."""

    def __post_init__(self) -> None:
        check_fields(self)


PIXEL_OUTPUTS: dict[str, type] = {"last_pair": np.int64, "median_depth": np.float32}
"""Outputs of each pixel beside colour, alpha and depth, by the names of `Wanted` and `Picture`, and their types."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What the blend leaves."""

    image: Float32[Array, "h w 3"]
    """Colour over the background."""
    alpha: Float32[Array, "h w"]
    """Share of light that the splats stop."""
    depth: Float32[Array, "h w"] | None
    """Blended view depth of the splats divided by alpha, world units; 0 where nothing is drawn; None if it was not wanted."""
    tiles: TileWork
    """What each tile took."""
    contributions: Float32[Array, "m"] | None = None
    """KPC: Σ α T over the pixels of each pair's tile, in px; None unless it was wanted."""
    last_pair: Int64[Array, "h w"] | None = None
    """Index in `TileBins.splat_from_pair` of the last pair that each pixel blended, −1 if it blended none; None unless it was
    wanted."""
    median_depth: Float32[Array, "h w"] | None = None
    """View depth of the splat at which the transmittance of each pixel falls below ½, world units; 0 where it never does; None
    unless it was wanted."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def num_evaluated(self) -> int:
        """Evaluations of a splat's opacity at a pixel."""
        return int(self.tiles.evaluated.sum())

    @property
    def num_blended(self) -> int:
        """Evaluations that were added to a pixel."""
        return int(self.tiles.blended.sum())


@dataclass(frozen=True)
class Counters:
    """How much work a frame took."""

    num_selected: int
    """Nodes of the cut that the selection handed on."""
    num_visible: int
    """Splats that touch the image."""
    num_pairs: int
    """N_P: pairs of splat and tile."""
    num_evaluated: int
    """Evaluations of a splat's opacity at a pixel."""
    num_blended: int
    """Evaluations that passed τ and were added to a pixel."""


@dataclass(frozen=True, eq=False)
class RenderResult:
    """A picture, and what it cost.

    Example:
        >>> result = st.render(scene, camera)
        >>> result.image.shape, sorted(result.milliseconds)
        ((36, 64, 3), ['bin', 'blend', ..., 'select'])
    """

    image: Float32[Array, "h w 3"]
    """Colour over the background, nominally 0 to 1, not clipped above."""
    alpha: Float32[Array, "h w"]
    """Share of light that the splats stop, 0 to 1."""
    depth: Float32[Array, "h w"]
    """Blended view depth of the splats divided by alpha, world units; 0 where nothing is drawn."""
    counters: Counters
    """How much work each stage did."""
    milliseconds: dict[str, float]
    """Wall time of each stage."""
    cpu_milliseconds: dict[str, float]
    """Processor time of each stage, all threads together. Other work on the machine disturbs it least."""

    __repr__ = in_short

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class Frame:
    """Everything that the stages of one frame computed.

    Example:
        >>> frame = st.trace(scene, camera)
        >>> len(frame.splats) <= len(frame.selection)
        True
    """

    view: View
    """Camera and options, with nothing left open."""
    culling: Culling | None
    """Clusters left out; None if no cluster was tested."""
    selection: Selection
    """Rows chosen."""
    splats: Splats
    """Rows projected, in depth order."""
    bins: TileBins
    """Splats of each tile."""
    picture: Picture
    """All outputs of the blend, and what it did in each tile."""
    result: RenderResult
    """The picture as `render` hands it out, with counters and times."""

    @property
    def camera(self) -> Camera:
        """The camera of the view."""
        return self.view.camera

    @property
    def tiles(self) -> TileWork:
        """What the blend did in each tile."""
        return self.picture.tiles

    @property
    def contributions(self) -> Float32[Array, "m"] | None:
        """KPC of each pair; None unless it was wanted."""
        return self.picture.contributions


def tiles_of(camera: Camera) -> tuple[int, int]:
    """Tiles across and down that cover the image."""
    return -(-camera.width // TILE_PX), -(-camera.height // TILE_PX)
