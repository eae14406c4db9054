"""Meet a quality: the coarsest τ_R whose cut looks as good as asked for, in the view that is drawn.

The quality is a PSNR against all leaves, and it is measured: a `Gauge` draws all leaves and the cuts that are tried, and compares
their pictures. Of a large picture it draws eight rows of tiles, evenly spread over those that show anything: a thumbnail, a pixel
a tile, says which. A squared error is a mean over pixels, and rows that show nothing have none. Eight rows say it to 0.6 dB (rms)
where the scene fills the picture, and exactly where it is in no more rows than these. With occlusion whole pictures are drawn.

The PSNR falls nearly evenly with ln size, where size² = τ_R² − (the radius of a point)². The search steps along ln size until two
cuts enclose the quality, and interpolates between them.

Cost: a picture that is tried takes 0.2 to 0.35 of a frame of 1080p of all leaves, and about a whole frame at 360p. A view alone
takes that of the leaves and of two or three cuts; the next view of a camera that moves, that of the leaves and of one or two.
What was measured of the last view is kept: asked for again, or for another quality, it costs nothing, or what is missing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from splatree.constants import TILE_PX
from splatree.metrics.psnr import psnr
from splatree.scene.options import SelectOptions
from splatree.scene.view import View, Wanted
from splatree.shapes import Array, Bool

__all__ = ["COARSEST_PX", "FINEST_PX", "Gauge", "pixel_error_for", "sample_of"]

SAMPLE_ROWS: Final = 8
"""Rows of tiles that are drawn of a picture: eight of 1080p are 15,000 × 16 px …"""

WHOLE_BELOW: Final = 32
"""… and of pictures of fewer rows than this all is drawn: strips of 16 px would cost as much."""

FIRST_PX: Final = 4.0
"""Size of nodes at which the search of a view alone begins."""

STEP: Final = math.sqrt(2)
"""Factor from one size that is tried to the next."""

COARSEST_PX: Final = 32.0
"""No cut of larger nodes is chosen for a quality."""

FINEST_PX: Final = 0.25
"""Below this size of merged nodes all leaves are drawn."""

FALL_DB: Final = 3.5
"""Typical loss of PSNR from one size to the next, by which the search goes on from one cut."""

NEAR_DB: Final = 0.5
"""A cut whose quality is within this of what is asked for is the last that is tried: the typical fall says the rest."""

NARROW_DB: Final = 6.0
"""Two cuts that enclose the quality and differ by less are interpolated between."""

NARROW_STEPS: Final = 1 / 8
"""Of two of nearly one size that differ by more, the finer one is taken: a single node then makes the difference."""

BEST_DB: Final = 100.0
"""Better pictures count as that."""


@dataclass(frozen=True)
class Sample:
    """What is drawn in place of a picture."""

    views: list[View]
    """Rows of tiles, as views of their own; or the whole view."""
    share: float
    """Share of the picture that they stand for; the rest shows nothing."""


class Gauge:
    """Measures the cuts of one scene against all leaves, and keeps what it measured of the last view."""

    def __init__(self, draw: Callable[[View, SelectOptions], Array]) -> None:
        """``draw`` draws a view of a selection by τ_R: its colours "h w 3"."""
        self._draw = draw
        self._asked: tuple[View, SelectOptions] | None = None
        self._sample = Sample([], 1.0)
        self._leaves: list[Array] = []
        self._known: dict[float, float] = {}

    def settled(
        self, select: SelectOptions, view: View, *, point_px: float, last: float | None = None
    ) -> SelectOptions:
        """The options with the τ_R that has their quality in this view, in place of the quality.

        Args:
            select: options with a quality, for the levels of the scene.
            view: the view that is measured.
            point_px: the radius that the profile gives to a point, px: with a τ_R below it only leaves are drawn.
            last: τ_R of a view nearby, px, at which the search begins; None: it begins at 4 px.
        """
        assert select.quality is not None
        by_size = replace(select, quality=None, budget=None)
        view = replace(view, wanted=Wanted(), least_light=0.0)
        if self._asked is None or self._asked[1] != by_size or not _are_equal(self._asked[0], view):
            self._asked, self._known = (view, by_size), {}
            # With occlusion the cut of a strip is not the strip of the cut: what hides it may lie outside.
            self._sample = Sample([view], 1.0) if by_size.occlusion else sample_of(view, self._is_shown(view, by_size))
            self._leaves = self._pictures(0.0)

        def psnr_at(pixel_error: float) -> float:
            if pixel_error not in self._known:
                found = np.concatenate([strip.ravel() for strip in self._pictures(pixel_error)])
                wanted = np.concatenate([strip.ravel() for strip in self._leaves])
                of_all = psnr(found, wanted) - 10 * math.log10(self._sample.share)
                self._known[pixel_error] = min(of_all, BEST_DB)
            return self._known[pixel_error]

        pixel_error = pixel_error_for(psnr_at, select.quality, point_px=point_px, last=last)
        return replace(select, quality=None, pixel_error=pixel_error)

    def _pictures(self, pixel_error: float) -> list[Array]:
        """What a screen shows of the sample."""
        assert self._asked is not None
        _, select = self._asked
        at = replace(select, pixel_error=pixel_error)
        return [np.clip(self._draw(strip, at), 0, 1) for strip in self._sample.views]

    def _is_shown(self, view: View, select: SelectOptions) -> Bool[Array, "r"]:
        """Which rows of tiles show anything, or are beside one that does, by a picture of a pixel a tile."""
        camera = view.camera
        num_rows, num_columns = -(-camera.height // TILE_PX), -(-camera.width // TILE_PX)
        if num_rows < WHOLE_BELOW:
            return np.ones(num_rows, bool)
        K = camera.K.copy()
        K[:2] /= TILE_PX
        thumbnail = replace(view, camera=replace(camera, K=K, width=num_columns, height=num_rows))
        shown = self._draw(thumbnail, replace(select, pixel_error=FIRST_PX))
        is_shown = np.pad((shown != np.asarray(view.background, np.float32)).any(axis=(1, 2)), 1)
        return np.asarray(is_shown[:-2] | is_shown[1:-1] | is_shown[2:])


def sample_of(view: View, is_shown: Bool[Array, "r"]) -> Sample:
    """Rows of tiles that stand for a picture; the whole view, if it is small.

    Args:
        view: the picture.
        is_shown: the rows of tiles that show anything; the others are the same in all cuts.
    """
    camera = view.camera
    rows = np.flatnonzero(is_shown)
    if len(is_shown) < WHOLE_BELOW or len(rows) == 0:
        return Sample([view], 1.0)
    strips = []
    for i in range(min(SAMPLE_ROWS, len(rows))):
        top = TILE_PX * int(rows[int((i + 0.5) * len(rows) / min(SAMPLE_ROWS, len(rows)))])
        K = camera.K.copy()
        K[1, 2] -= top
        strips.append(replace(view, camera=replace(camera, K=K, height=min(TILE_PX, camera.height - top))))
    return Sample(strips, len(rows) / len(is_shown))


def pixel_error_for(
    psnr_at: Callable[[float], float], quality: float, *, point_px: float, last: float | None = None
) -> float:
    """The τ_R whose cut has the quality: that of nodes of 32 px if it is better, and 0, all leaves, if no cut of merged nodes is
    as good.

    Args:
        psnr_at: the PSNR of the cut of a τ_R, px, against all leaves, dB, at most 100.
        quality: the PSNR that is wanted, dB.
        point_px: the radius that the profile gives to a point, px.
        last: τ_R at which the search begins, px; None: that of nodes of 4 px.
    """

    def pixel_error_of(step: float) -> float:
        return math.hypot(FIRST_PX * STEP**step, point_px)

    finest, coarsest = (math.log(size / FIRST_PX, STEP) for size in (FINEST_PX, COARSEST_PX))
    fine: tuple[float, float] | None = None  # step of a cut that is good enough, and by how much it is better
    coarse: tuple[float, float] | None = None  # of one that is not
    step = 0.0
    if last is not None and last > point_px:
        nearby = min(max(math.sqrt(last**2 - point_px**2), FINEST_PX), COARSEST_PX)
        step = math.log(nearby / FIRST_PX, STEP)
    while True:
        spare = psnr_at(pixel_error_of(step)) - quality
        if abs(spare) <= NEAR_DB:
            return pixel_error_of(min(step + spare / FALL_DB, coarsest))
        if spare > 0:
            fine = step, spare
            if step >= coarsest:
                return pixel_error_of(coarsest)
        else:
            coarse = step, spare
            if step <= finest:
                return 0.0
        if fine is None or coarse is None:
            step = min(max(step + math.copysign(max(1, round(abs(spare) / FALL_DB)), spare), finest), coarsest)
            continue
        width, drop = coarse[0] - fine[0], fine[1] - coarse[1]
        between = fine[0] + fine[1] / drop * width
        if drop <= NARROW_DB:
            return pixel_error_of(between)
        if width <= NARROW_STEPS:
            return pixel_error_of(fine[0])
        step = min(max(between, fine[0] + width / 4), coarse[0] - width / 4)


def _are_equal(one: View, other: View) -> bool:
    """Whether two views are of one camera and drawn in one way."""
    a, b = one.camera, other.camera
    return (
        all(getattr(one, field.name) == getattr(other, field.name) for field in fields(View) if field.name != "camera")
        and (a.width, a.height, a.near) == (b.width, b.height, b.near)
        and np.array_equal(a.K, b.K)
        and np.array_equal(a.camera_from_world, b.camera_from_world)
    )
