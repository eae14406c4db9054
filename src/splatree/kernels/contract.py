"""What a back end has to have: the stages of a frame, and what it may have beside them.

A back end is a package ``kernels/<name>/`` (kernels/devices.py finds it by its name) with these functions:

====================================  ========  =========================================================================
``frame_stages()``                    required  a module or an object with the functions of `FrameStages`
``hold(gaussians, ids, tree,          optional  a scene in the memory of the device, a `HeldScene`, which draws a frame as one
blocks, columns)``                              piece of work; without it a frame is drawn stage by stage
``reusing_stages()``                  optional  the stages for one session that draws: what they leave for the next stage may be
                                                overwritten by the next frame
``borrow(tensors)``                   optional  tensors of other libraries in the device's memory as columns of a scene
``kmeans_steps(points, *, threads,    optional  a function that assigns the points to centres: a step of K-means; ``zeros``
zeros)``                                        makes arrays with a row for each point
====================================  ========  =========================================================================

Each stage is a function from structs to a struct. Structs lie in the memory of the processor and are float32, so stages of
different back ends can be mixed. What is optional and missing is not supported: callers look for it and say so; nobody asks for
the name of a back end.

A fast kernel agrees with its reference within rounding; at a step (a threshold, a tile's edge) within a band around it. It gives
the same bits for any number of threads and any order of rows: a thread writes only what its chunk owns, rows are computed in
full vectors that never depend on their place, and equal keys are ordered by the row's id.
"""

from typing import Any, Protocol

from splatree.scene.frame import CutRange, Picture, Splats, TileBins
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, Moments, PhotoLoss, PictureGradients, SplatGradients
from splatree.scene.options import SelectOptions
from splatree.scene.tree import BlockIndex, GaussianTree
from splatree.scene.view import View
from splatree.shapes import Array, Bool, Float32, Float64, Int32, UInt8, UInt32

__all__ = [
    "BackwardStages",
    "FrameStages",
    "HeldScene",
    "QueuedFrame",
    "RangeStages",
    "TracedFrame",
    "TrainingStages",
]


class FrameStages(Protocol):
    """The stages of a frame; ``threads`` 0 means all there are, and is ignored where the host's threads do not work."""

    def select(
        self,
        gaussians: Gaussians,
        tree: GaussianTree,
        blocks: BlockIndex | None,
        view: View,
        options: SelectOptions,
        *,
        runs: Int32[Array, "r 2"] | None = None,
        threads: int = 0,
    ) -> tuple[Int32[Array, "v"], int]:
        """Rows drawn by the rule `cut`, ascending, and how many rows were looked at.

        With ``runs``, ascending first rows and ends, only rows in one of them are drawn; all others shadow as ever.
        """
        ...

    def project(
        self,
        gaussians: Gaussians,
        ids: UInt32[Array, "n"] | None,
        rows: Int32[Array, "v"],
        view: View,
        *,
        curves: Float32[Array, "n 4"] | None = None,
        threads: int = 0,
    ) -> Splats:
        """Splats of the rows that touch the image, and their order by depth; ``curves`` are those of the tree."""
        ...

    def bin(self, splats: Splats, view: View, *, threads: int = 0) -> TileBins:
        """Pairs of splat and tile, tile by tile and nearest first."""
        ...

    def blend(self, splats: Splats, bins: TileBins, view: View, *, threads: int = 0) -> Picture:
        """The picture of the tiles' lists, with the outputs that ``view.wanted`` names."""
        ...


class RangeStages(Protocol):
    """The optional stage of back ends that find the cuts of many τ_R at once: a budget is then met without a search."""

    def select_range(
        self,
        gaussians: Gaussians,
        tree: GaussianTree,
        blocks: BlockIndex | None,
        view: View,
        options: SelectOptions,
        *,
        coarsest: float,
        every: int = 1,
        runs: Int32[Array, "r 2"] | None = None,
        threads: int = 0,
    ) -> CutRange:
        """The cuts of all τ_R from that of the options to ``coarsest``, px and finite, by the rule `cut`.

        With ``every`` above 1 a share of the rows stands for all; only numbers of rows are then to be used.
        """
        ...


class BackwardStages(Protocol):
    """The optional stages, of back ends that can train: ``getattr(stages, name, None)`` is None where one is not supported."""

    def blend_backward(
        self,
        splats: Splats,
        bins: TileBins,
        view: View,
        picture: Picture,
        upstream: PictureGradients,
        *,
        threads: int = 0,
    ) -> SplatGradients:
        """Sums over the pixels of each splat; ``picture`` is what `FrameStages.blend` left for the same view."""
        ...

    def project_backward(
        self, gaussians: Gaussians, splats: Splats, gradients: SplatGradients, view: View, *, threads: int = 0
    ) -> GaussianGradients:
        """Derivatives by the columns of the Gaussians that the splats come from."""
        ...

    def photo_loss(
        self,
        image: Float32[Array, "h w 3"],
        photo: UInt8[Array, "h w 3"],
        gain: Float64[Array, "3"],
        *,
        ssim_weight: float = 0.2,
        mask: Bool[Array, "h w"] | None = None,
        threads: int = 0,
    ) -> PhotoLoss:
        """How far a picture is from a photograph, and the derivative by the picture."""
        ...

    def step(
        self,
        gaussians: Gaussians,
        gradients: GaussianGradients,
        moments: Moments,
        rates: Float32[Array, "e"],
        *,
        ramp_steps: int = 1,
        threads: int = 0,
    ) -> None:
        """A step of the optimiser for the rows that were drawn; columns and moments change in place."""
        ...


class TrainingStages(FrameStages, BackwardStages, Protocol):
    """All stages of a back end that can train."""


class HeldScene(Protocol):
    """A scene in the memory of a device, which selects and draws views of it by the rule `cut` as one piece of work."""

    def select(self, view: View, options: SelectOptions) -> tuple[Int32[Array, "v"], int]:
        """Rows drawn, ascending, and how many rows were looked at."""
        ...

    def enqueue(self, view: View, options: SelectOptions) -> "QueuedFrame":
        """Select and draw without waiting; the outputs are colour, alpha and depth."""
        ...

    def trace(self, view: View, options: SelectOptions, *, rows: Int32[Array, "v"] | None = None) -> "TracedFrame":
        """Draw stage by stage, with ``view.wanted``, into the processor's memory; ``rows``, ascending, instead of selecting."""
        ...

    def update(self, gaussians: Gaussians, blocks: BlockIndex | None, names: tuple[str, ...]) -> None:
        """Take over the named columns of the Gaussians, which are as many as before, and the index of their blocks, if any."""
        ...


class QueuedFrame(Protocol):
    """A view that a device was asked to draw."""

    def finish(self) -> Any:
        """Wait for it; the picture where it lies, with ``image``, ``alpha`` and ``depth`` as arrays of the device."""
        ...

    def download(self) -> tuple[Picture, dict[str, int]]:
        """Wait for it; the picture in the processor's memory, and the counters ``num_selected num_visible num_pairs``."""
        ...


class TracedFrame(Protocol):
    """A frame with all that lies between."""

    @property
    def rows(self) -> Int32[Array, "v"]:
        """Rows drawn, ascending."""
        ...

    @property
    def num_visited(self) -> int:
        """Rows looked at by the selection; 0 if the rows were given."""
        ...

    @property
    def splats(self) -> Splats:
        """Those of the rows that touch the image."""
        ...

    @property
    def bins(self) -> TileBins:
        """Splats of each tile."""
        ...

    @property
    def picture(self) -> Picture:
        """The picture."""
        ...

    @property
    def milliseconds(self) -> dict[str, float]:
        """Time of each stage on the device."""
        ...

    @property
    def cpu_milliseconds(self) -> dict[str, float]:
        """Processor time of each stage."""
        ...
