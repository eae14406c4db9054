"""Derivatives of a loss by what was drawn: glue over blend_backward.cpp, splat_sums.cpp and project_backward.cpp;
kernels/reference/backward.py is the definition."""

import numpy as np

from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame.view import pack_view
from splatree.kernels.reference.backward import refuse_tapers
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, PictureGradients, SplatGradients
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["blend_backward", "project_backward"]


def blend_backward(
    splats: Splats,
    bins: TileBins,
    view: View,
    picture: Picture,
    upstream: PictureGradients,
    *,
    threads: int = 0,
) -> SplatGradients:
    """Sums over the pixels of each splat; ``picture`` is what `blend` left for the same view."""
    refuse_tapers(bins, view)
    count = len(splats)
    out: dict[str, Array] = {"moments": np.empty((count, 6), np.float32), "colors": np.empty((count, 3), np.float32)}
    if upstream.depth is not None:
        out["depths"] = np.empty(count, np.float32)
    if upstream.errors is not None:
        out |= {name: np.empty(count, np.float32) for name in ("weights", "errors")}
    _core.blend_backward_tiles(splats, bins, view, picture, upstream, out, threads)
    return SplatGradients(**out)


def project_backward(
    gaussians: Gaussians, splats: Splats, gradients: SplatGradients, view: View, *, threads: int = 0
) -> GaussianGradients:
    """Derivatives by the columns of the Gaussians that the splats come from."""
    count, sh = len(splats), gaussians.sh
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh": sh.shape[1:]}
    out: dict[str, Array] = {name: np.empty((count, *shape), np.float32) for name, shape in shapes.items()}
    _core.project_backward_rows(gaussians, splats, gradients, pack_view(view), view, out, threads)
    return GaussianGradients(splats.rows, **out)
