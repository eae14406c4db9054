"""The hot stages: one contract, several implementations with the same file names.

A stage ``x`` is a function of the same name and signature in ``kernels/reference/x.py`` (NumPy float64, the specification)
and in ``kernels/cpu/frame/x.py`` (glue) over ``x.cpp`` beside it (loops) with the maths in ``kernels/shared/x.h``; on a GPU it is
``kernels/cuda/x.cu``, launched by ``kernels/cuda/renderer.py``:

==========  =====================================================================================
blocks      gaussians, tree                             → BlockIndex                     (per scene)
select      gaussians, tree, blocks, camera, options    → rows of the visible cut        (per frame)
project     gaussians, ids, rows, camera, options       → Splats and their depth order   (per frame)
bin         splats, camera, options                     → TileBins                       (per frame)
blend       splats, bins, camera, options               → Picture, contributions         (per frame)
thin        means, colors, importance, radius           → representative of each row     (per level)
merge       gaussians, groups, options                  → Gaussians, one a group         (per level)
==========  =====================================================================================

A fast kernel agrees with its reference within rounding; at a step (a threshold, a tile's edge) within a band around it. It
gives the same bits for any number of threads and any order of rows: a thread writes only what its chunk owns, rows are
computed in full vectors that never depend on their place, and equal keys are ordered by the row's id.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, NamedTuple

from splatree.errors import InputError
from splatree.kernels import reference
from splatree.kernels.cpu import frame

if TYPE_CHECKING:
    from splatree.scene.frame import Picture, Splats, TileBins

__all__ = ["Backend", "FrameStages", "backend_for"]

Backend = Literal["cpu", "cuda", "reference"]
"""Named implementations of the stages of a frame."""


class FrameStages(NamedTuple):
    """The stages of a frame after the selection, of one implementation."""

    project: Callable[..., "Splats"]
    """Gaussians of the selected rows to splats."""
    bin: Callable[..., "TileBins"]
    """Splats to tiles."""
    blend: Callable[..., "Picture"]
    """Tiles to the picture."""


def backend_for(name: Backend) -> FrameStages:
    """The stages of the implementation ``name``."""
    modules = {"cpu": frame, "reference": reference}
    if name == "cuda":
        from splatree.kernels.cuda.device import open_device
        from splatree.kernels.cuda.stages import Stages

        on_device = Stages(open_device(0))
        return FrameStages(on_device.project, on_device.bin, on_device.blend)
    if name not in modules:
        raise InputError(f"backend: found {name!r}, wanted one of {sorted([*modules, 'cuda'])}")
    stages = modules[name]
    return FrameStages(stages.project.project, stages.bin.bin, stages.blend.blend)
