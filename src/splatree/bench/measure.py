"""What every experiment measures of one way to draw a subject: quality view by view, then time along a path."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from splatree.bench.experiment import Row
from splatree.bench.subject import Subject
from splatree.constants import ALPHA_THRESHOLD
from splatree.lod.select import Selector
from splatree.lod.select import select as select_rows
from splatree.metrics.flip import flip
from splatree.progress import track
from splatree.render.evaluate import score
from splatree.render.session import NOTHING, Session, open_session
from splatree.render.timing import Timing, time_frames
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.view import Wanted
from splatree.shapes import Array

__all__ = ["ALL_LEAVES", "CONTRIBUTIONS", "Judge", "Quality", "number", "shrinking_row"]

ALL_LEAVES = SelectOptions(pixel_error=0.0)
LOSSLESS = RenderOptions(threshold=ALPHA_THRESHOLD)
CONTRIBUTIONS = Wanted(contributions=True)
WARM_UP = 20
"""Frames drawn before those that are timed: caches, clocks and threads are then as they stay."""
PSNR_MAX = 100.0
"""dB; beyond it pictures differ by less than a thousandth of a step of 8 bits, and the mean would say nothing of other views."""


@dataclass(frozen=True)
class Quality:
    """Means over the views of one way to draw."""

    psnr: float
    """Mean peak signal-to-noise ratio, dB; a view above 100 dB, equal pictures too, counts as 100."""
    ssim: float
    """Structural similarity."""
    lpips: float | None
    """Learned perceptual similarity, if its network was given."""
    flip: float | None
    """Mean FLIP, 0 to 1, if it was asked for."""
    num_selected: float
    """Nodes chosen."""
    num_pairs: float
    """N_P."""


@dataclass(frozen=True, eq=False)
class Judge:
    """Compares pictures of a subject with its photographs, or with those of all leaves where there are none."""

    subject: Subject
    """Scene and views."""
    lpips: Callable[[Array, Array], float] | None = None
    """A loaded `splatree.metrics.lpips.Lpips`."""
    selection: SelectOptions = ALL_LEAVES
    """Nodes of the picture to compare with, which is drawn without loss, where there are no photographs."""
    wants_flip: bool = False
    """Whether FLIP is computed too: about a second a megapixel."""

    @cached_property
    def session(self) -> Session:
        """What draws the subject."""
        return open_session(self.subject.scene)

    @cached_property
    def references(self) -> Mapping[str, Array]:
        """The picture that each view is compared with, by the camera's name."""
        subject = self.subject
        if subject.photos is not None:
            return {
                camera.name: subject.photos[camera.name] for camera in subject.cameras if camera.name in subject.photos
            }
        views = track(list(subject.cameras), "draw references")
        return {
            camera.name: self.session.draw(camera, options=LOSSLESS, select=self.selection).image for camera in views
        }

    def of_shrinking(self, selection: SelectOptions) -> "Judge":
        """One that compares with the lossless picture of the same nodes, so that only what shrinking loses is counted."""
        return Judge(replace(self.subject, photos=None), selection=selection)

    def selector(self, select: SelectOptions | Selector) -> Selector:
        """Options as a selector, so that what is out of view is dropped whatever the tile rule."""
        return partial(select_rows, self.subject.scene, options=select) if isinstance(select, SelectOptions) else select

    def trace(
        self,
        camera: Camera,
        select: SelectOptions | Selector,
        options: RenderOptions | None = None,
        wanted: Wanted = NOTHING,
    ) -> Frame:
        """Draw a view with what each stage computed."""
        return self.session.trace(camera, wanted, options=options, select=self.selector(select))

    def quality(self, select: SelectOptions | Selector, options: RenderOptions | None = None) -> Quality:
        """Draw each view that has a reference, and compare."""
        rows = []
        for camera in self.subject.cameras:
            if camera.name not in self.references:
                continue
            result = self.trace(camera, select, options).result
            found = score(result.image, self.references[camera.name], self.lpips)
            seen = flip(np.clip(result.image, 0, 1), self.references[camera.name]) if self.wants_flip else 0.0
            numbers = (min(found.psnr, PSNR_MAX), found.ssim, found.lpips or 0.0, seen)
            rows.append((*numbers, result.counters.num_selected, result.counters.num_pairs))
        psnr, ssim, lpips, seen, num_selected, num_pairs = (
            float(x) for x in np.mean(np.array(rows, np.float64), axis=0)
        )
        return Quality(
            psnr, ssim, lpips if self.lpips else None, seen if self.wants_flip else None, num_selected, num_pairs
        )

    def timing(self, select: SelectOptions | Selector, options: RenderOptions | None = None, *, frames: int) -> Timing:
        """Draw a path through the views and time it, after as many frames, at most 20, to warm up."""
        return time_frames(
            self.subject.scene,
            self.subject.cameras,
            options,
            self.selector(select),
            views=frames,
            warm_up=min(WARM_UP, frames),
        )


def shrinking_row(
    judge: Judge, unshrunk: Judge, select: SelectOptions, options: RenderOptions, frames: int
) -> dict[str, object]:
    """What one way to end splats costs and saves; ``unshrunk`` is `Judge.of_shrinking` for the same selection."""
    quality, timing = judge.quality(select, options), judge.timing(select, options, frames=frames)
    return {
        "τ": options.threshold,
        "PSNR": quality.psnr,
        "SSIM": quality.ssim,
        "PSNR to unshrunk": unshrunk.quality(select, options).psnr,
        "N_P": round(quality.num_pairs),
        "FPS": timing.fps,
        "frame CPU-ms": timing.frame_cpu_ms,
    }


def number(row: Row, column: str) -> float:
    """An entry of a row that is a number."""
    value = row[column]
    assert isinstance(value, int | float)
    return float(value)
