"""What every experiment measures of one way to draw a subject: quality view by view, then time along a path."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from splatree.bench.subject import Subject
from splatree.lod.select import Selector
from splatree.progress import track
from splatree.render.evaluate import score
from splatree.render.pipeline import render, trace
from splatree.render.timing import Timing, time_frames
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.shapes import Array

__all__ = ["Judge", "Quality"]

ALL_LEAVES = SelectOptions(pixel_error=0.0)
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

    @cached_property
    def references(self) -> Mapping[str, Array]:
        """The picture that each view is compared with, by the camera's name."""
        subject = self.subject
        if subject.photos is not None:
            return {
                camera.name: subject.photos[camera.name] for camera in subject.cameras if camera.name in subject.photos
            }
        views = track(list(subject.cameras), "draw all leaves")
        return {camera.name: render(subject.scene, camera, select=ALL_LEAVES).image for camera in views}

    def quality(self, select: SelectOptions | Selector, options: RenderOptions | None = None) -> Quality:
        """Draw each view that has a reference, and compare."""
        rows = []
        for camera in self.subject.cameras:
            if camera.name not in self.references:
                continue
            result = trace(self.subject.scene, camera, options, select).result
            found = score(result.image, self.references[camera.name], self.lpips)
            numbers = (min(found.psnr, PSNR_MAX), found.ssim, found.lpips or 0.0)
            rows.append((*numbers, result.counters.num_selected, result.counters.num_pairs))
        psnr, ssim, lpips, num_selected, num_pairs = (float(x) for x in np.mean(np.array(rows, np.float64), axis=0))
        return Quality(psnr, ssim, lpips if self.lpips else None, num_selected, num_pairs)

    def timing(self, select: SelectOptions | Selector, options: RenderOptions | None = None, *, frames: int) -> Timing:
        """Draw a path through the views and time it."""
        return time_frames(self.subject.scene, self.subject.cameras, options, select, views=frames)
