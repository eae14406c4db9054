"""Meet a quality: the coarsest τ_R whose cut is predicted to look as good as asked for.

The quality is a PSNR against all leaves. The levels of a scene know a curve for it (scene/quality.py), which asks for a sketch of
each cut that is tried (lod/sketch.py). A view alone is searched from 4 px on: three or four cuts. The next view of a moving
camera begins at the τ_R of the last: one or two.
"""

import math
from collections.abc import Callable
from typing import Final

from splatree.errors import InputError
from splatree.lod.sketch import Sketcher
from splatree.scene.cameras import Camera
from splatree.scene.quality import QualityCurve
from splatree.scene.scene import Scene
from splatree.shapes import Array

__all__ = ["COARSEST_PX", "FINEST_PX", "curve_of", "pixel_error_for"]

FIRST_PX: Final = 4.0
"""Size of nodes at which the search of a view alone begins."""

COARSEST_PX: Final = 32.0
"""No cut of larger nodes is chosen for a quality: curves are fitted to smaller ones."""

FINEST_PX: Final = 0.25
"""Below this size of merged nodes all leaves are drawn."""

PRECISION_DB: Final = 0.25
"""A cut whose predicted quality is within this of what is asked for is not searched further."""

TRIALS: Final = 10
"""Most cuts that are tried."""

CLOSE: Final = 0.03
"""A search ends where ln size is known to this: one large node may change the prediction by more than its precision."""

FALL_DB: Final = 6.0
"""Typical loss of PSNR for a unit of ln size, by which the search goes on from one cut."""


def pixel_error_for(
    rows_at: Callable[[float], tuple[Array, int]],
    sketcher: Sketcher,
    camera: Camera,
    quality: float,
    *,
    point_px: float,
    last: float | None = None,
) -> float:
    """The largest τ_R whose cut is predicted to have the quality; 0, all leaves, where no cut of merged nodes has it.

    Args:
        rows_at: the selection at a τ_R, px.
        sketcher: draws sketches of these rows.
        camera: the view.
        quality: PSNR against all leaves that is wanted, dB.
        point_px: the radius that the profile gives to a point, px: with a τ_R below it only leaves are drawn.
        last: τ_R of a view nearby, at which the search begins, px; None: 4 px.

    Raises:
        InputError: the levels have no curve of their quality.
    """
    curve = curve_of(sketcher.scene)

    def spare_at(size_px: float) -> float:
        """By how much a cut is predicted to be better than asked for, dB."""
        pixel_error = math.hypot(size_px, point_px)
        seen = sketcher.draw(rows_at(pixel_error)[0], camera)
        return curve.psnr(pixel_error, merged=seen.merged, varied=seen.varied) - quality

    fine: tuple[float, float] | None = None  # ln size of a cut that is good enough, and by how much it is better
    coarse: tuple[float, float] | None = None  # of one that is not
    nearby = FIRST_PX if last is None or not math.isfinite(last) else math.sqrt(max(last**2 - point_px**2, 0))
    size = min(max(nearby, FINEST_PX), COARSEST_PX)
    for _ in range(TRIALS):
        spare = spare_at(size)
        if spare >= 0:
            fine = math.log(size), spare
            if spare < PRECISION_DB or size >= COARSEST_PX:
                break
        else:
            coarse = math.log(size), spare
            if size <= FINEST_PX:
                return 0.0
        if fine is not None and coarse is not None and coarse[0] - fine[0] < CLOSE:
            break
        size = min(max(math.exp(_between(fine, coarse)), FINEST_PX), COARSEST_PX)
    return math.hypot(math.exp(fine[0]), point_px) if fine is not None else 0.0


def _between(fine: tuple[float, float] | None, coarse: tuple[float, float] | None) -> float:
    """ln size of the next cut to try: beyond the one that is known, or between two."""
    aim = PRECISION_DB / 2
    if fine is not None and coarse is not None:
        share = (fine[1] - aim) / (fine[1] - coarse[1]) if math.isfinite(fine[1]) else 0.5
        return fine[0] + min(max(share, 0.1), 0.9) * (coarse[0] - fine[0])
    known, direction = (fine, 1.0) if fine is not None else (coarse, -1.0)
    assert known is not None
    return known[0] + direction * min(max(abs(known[1] - aim) / FALL_DB, 0.05), 1.5)


def curve_of(scene: Scene) -> QualityCurve:
    """The curve that the levels of a scene have."""
    record = scene.tree.record
    if record is None or record.quality is None:
        raise InputError(
            "quality: found levels whose quality was not measured, wanted a curve of it; build them with splatree build, "
            "call with_quality, or use pixel_error or budget"
        )
    return record.quality
