"""The numbers of one view of ``splatree eval``, their line in its table, and their means."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from splatree.render.evaluate import Evaluation

__all__ = ["View", "means_of", "row_of", "view_of"]


@dataclass(frozen=True)
class View:
    """One view; pictures are compared clipped to 0 to 1."""

    name: str
    """Name of the camera."""
    selected: int
    """Nodes drawn from the cut."""
    pairs: int
    """N_P of the cut."""
    pixel_error: float
    """τ_R, px, as raised to meet a budget."""
    psnr_vs_leaves: float
    """Cut against all leaves, dB; infinity (null in JSON) for equal pictures."""
    ssim_vs_leaves: float | None
    """The same, structural similarity."""
    lpips_vs_leaves: float | None
    """The same, LPIPS."""
    ms: dict[str, float]
    """Wall time of each stage for the cut."""
    leaves_selected: int
    """Nodes drawn of all leaves."""
    leaves_pairs: int
    """N_P of all leaves."""
    leaves_ms: dict[str, float]
    """Wall time of each stage for all leaves."""
    psnr_vs_photo: float | None = None
    """Cut against the photograph, dB."""
    psnr_fitted_vs_photo: float | None = None
    """The same of the right half, with a gain for each channel fitted on the left half: exposure does not count."""
    ssim_vs_photo: float | None = None
    """Cut against the photograph, structural similarity."""
    leaves_psnr_vs_photo: float | None = None
    """All leaves against the photograph, dB."""
    leaves_psnr_fitted_vs_photo: float | None = None
    """The same of the right half, with the gain fitted on the left half."""
    leaves_ssim_vs_photo: float | None = None
    """All leaves against the photograph, structural similarity."""
    lpips_vs_photo: float | None = None
    """Cut against the photograph, LPIPS."""
    leaves_lpips_vs_photo: float | None = None
    """All leaves against the photograph, LPIPS."""
    held_out: bool = True
    """Whether the view counts; a training view does not."""


def view_of(e: Evaluation) -> View:
    """The numbers of one view."""
    return View(
        name=e.camera.name,
        selected=e.cut.result.counters.num_selected,
        pairs=e.cut.result.counters.num_pairs,
        pixel_error=e.cut.selection.pixel_error,
        psnr_vs_leaves=e.cut_vs_leaves.psnr,
        ssim_vs_leaves=e.cut_vs_leaves.ssim,
        lpips_vs_leaves=e.cut_vs_leaves.lpips,
        ms=e.cut.result.milliseconds,
        leaves_selected=e.leaves.result.counters.num_selected,
        leaves_pairs=e.leaves.result.counters.num_pairs,
        leaves_ms=e.leaves.result.milliseconds,
        psnr_vs_photo=e.cut_vs_photo.psnr if e.cut_vs_photo else None,
        psnr_fitted_vs_photo=e.cut_vs_photo.psnr_fitted if e.cut_vs_photo else None,
        ssim_vs_photo=e.cut_vs_photo.ssim if e.cut_vs_photo else None,
        leaves_psnr_vs_photo=e.leaves_vs_photo.psnr if e.leaves_vs_photo else None,
        leaves_psnr_fitted_vs_photo=e.leaves_vs_photo.psnr_fitted if e.leaves_vs_photo else None,
        leaves_ssim_vs_photo=e.leaves_vs_photo.ssim if e.leaves_vs_photo else None,
        lpips_vs_photo=e.cut_vs_photo.lpips if e.cut_vs_photo else None,
        leaves_lpips_vs_photo=e.leaves_vs_photo.lpips if e.leaves_vs_photo else None,
    )


def row_of(view: View, *, verbose: bool = True) -> dict[str, object]:
    """One line of the table; milliseconds only with ``verbose``."""
    row: dict[str, object] = {
        "view": view.name,
        "nodes": view.selected,
        "of": view.leaves_selected,
        "pairs": view.pairs,
        "of ": view.leaves_pairs,
        "PSNR": view.psnr_vs_leaves,
        "SSIM": None if view.ssim_vs_leaves is None else f"{view.ssim_vs_leaves:.4f}",
    }
    if view.lpips_vs_leaves is not None:
        row["LPIPS"] = f"{view.lpips_vs_leaves:.4f}"
    if verbose:
        row |= {f"{stage} ms": ms for stage, ms in view.ms.items()}
    if view.psnr_vs_photo is not None:
        row |= {"PSNR photo": view.psnr_vs_photo, "fitted": view.psnr_fitted_vs_photo}
        row |= {"leaves photo": view.leaves_psnr_vs_photo, "leaves fitted": view.leaves_psnr_fitted_vs_photo}
    return row


def means_of(views: Sequence[View]) -> dict[str, float | None]:
    """Means over the views that have a number: one without a photograph has none to it, and an infinite PSNR, that of equal
    pictures, would hide all others."""
    means: dict[str, float | None] = {}
    for field in fields(View):
        values = [getattr(view, field.name) for view in views]
        numbers = [float(value) for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
        if numbers:
            means[field.name] = float(np.mean([x for x in numbers if math.isfinite(x)] or numbers))
    return means
