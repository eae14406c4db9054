"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``.

``frame/``    what a frame runs: selection, culling, projection, binning, blending
``build/``    what builds levels and clusters: thinning, pairs, merging, visibility, K-means
``codec/``    what file formats need: columns, quantisation, palettes, rotation of harmonics
``runtime/``  what all of them stand on: threads, instruction sets, memory, files
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatree.kernels.contract import FrameStages
    from splatree.shapes import Array

__all__ = ["frame_stages", "kmeans_steps", "reusing_stages"]


def frame_stages() -> "FrameStages":
    """The stages of a frame."""
    from splatree.kernels.cpu.frame import stages

    return stages


def reusing_stages() -> "FrameStages":
    """The same for one session: splats are overwritten by those of the next frame."""
    from splatree.kernels.cpu.frame.reuse import ReusingStages

    return ReusingStages()


def kmeans_steps(points: "Array", *, threads: int, zeros: "Callable[..., Array]") -> "Callable[[Array], Any]":
    """A step of K-means: assigns the points to centres."""
    from splatree.kernels.cpu.build.kmeans import steps_of

    return steps_of(points, threads=threads, zeros=zeros)
