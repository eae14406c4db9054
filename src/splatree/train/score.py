"""Scores of a scene in training on photographs that are held out: always two numbers, as rendered and with the exposure fitted.

Held-out photographs are opened here alone. They are read before the first step, so that a damaged one is told there, not at the
first score, minutes later. Nothing of them comes back but numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatree.constants import SSIM_WINDOW_PX
from splatree.errors import FormatError
from splatree.io.photo_search import NoPhotosError
from splatree.metrics.gain import psnr_with_gain
from splatree.metrics.psnr import psnr
from splatree.metrics.ssim import ssim
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.train.options import Alpha
from splatree.train.step import Drawing, drawn
from splatree.train.targets import Target, Targets
from splatree.train.world import World

__all__ = ["HeldOut", "Score"]

_SHOWN = 8


@dataclass(frozen=True)
class Score:
    """How near pictures are to the held-out photographs; means over those that have the number."""

    psnr: float | None
    """As rendered, dB; None if masks leave no pixel of any photograph, or none is there."""
    psnr_fitted: float | None
    """With a gain for each channel that is fitted on the left half of each picture and scored on its right half, dB; None if no
    photograph has pixels in both."""
    ssim: float | None
    """Structural similarity as rendered; None where pictures are smaller than its window, or masked."""


class HeldOut:
    """Held-out views of a folder, with their photographs at one size.

    Raises:
        InputError: a photograph or its mask has another shape than its view.
        FormatError: a photograph is damaged.
    """

    def __init__(
        self, folder: Path, cameras: Sequence[Camera], masks: Path | None, alpha: Alpha, division: int, world: World
    ) -> None:
        self._num_views, self._division = len(cameras), division
        self._targets: Targets | None = None
        try:
            self._targets = Targets(folder, cameras, masks=masks, alpha=alpha)
            self._missing = self._targets.used.missing
            self._targets.placed(world.near, np.asarray(world.origin))
            self._targets.read_all(division)
        except NoPhotosError:  # those of the training views are there: a scene without scores is better than none
            self._missing = tuple(camera.name for camera in cameras)
        except FormatError as error:
            raise FormatError(
                f"{error}; it belongs to a held-out view: mend or remove it, or train without scores"
            ) from error

    @property
    def notes(self) -> tuple[str, ...]:
        """What is missing for scores, a sentence each."""
        names = ", ".join(self._missing[:_SHOWN]) + (", ..." if len(self._missing) > _SHOWN else "")
        count = f"{len(self._missing)} of the {self._num_views} held-out views"
        return (f"no photograph of {count}, which count in no score: {names}",) if self._missing else ()

    def score(self, gaussians: Gaussians, drawing: Drawing) -> Score:
        """Draw each view that has a photograph and compare it with that."""
        if self._targets is None:
            return Score(None, None, None)
        found = [_one(gaussians, drawing, self._targets.at(i, self._division)) for i in range(len(self._targets))]
        return Score(*(_mean(numbers) for numbers in zip(*found, strict=True)))


def _one(gaussians: Gaussians, drawing: Drawing, target: Target) -> tuple[float | None, ...]:
    image = drawn(gaussians, drawing.view(target.camera), drawing)[2].image
    photo, clipped = target.photo / np.float32(255), np.clip(image, 0, 1)
    fitted = psnr_with_gain(image, photo, target.mask)
    if target.mask is not None and not target.mask.any():
        return None, None, None
    if target.mask is not None:
        return psnr(clipped[target.mask][None], photo[target.mask][None]), fitted, None
    is_large = min(image.shape[:2]) >= SSIM_WINDOW_PX
    return psnr(clipped, photo), fitted, ssim(clipped, photo) if is_large else None


def _mean(numbers: Sequence[float | None]) -> float | None:
    there = [number for number in numbers if number is not None]
    return float(np.mean(there)) if there else None
