"""One step: draw a view, compare it with its photograph, and move every Gaussian that was drawn.

    project ─► bin ─► blend ─► loss ─► blend backward ─► project backward ─► step of the optimiser

Training draws with the stages of `render`, at τ = 1/255 and exact tiles: what is learned is what is drawn. Pixels of a small
photograph are means of k × k pixels of a large one. There a splat would have its dilation δ, and its mean over k × k pixels is
wider by their variance, so in pixels of the small one its dilation is

    δ_k = (δ + (k² − 1) / 12) / k²

With δ itself a run would learn from small photographs splats that are too thin for large ones.
"""

from dataclasses import dataclass

import numpy as np

from splatree.constants import DILATION_PX2
from splatree.kernels.contract import TrainingStages
from splatree.scene.cameras import Camera
from splatree.scene.frame import Picture, Splats, TileBins
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, PhotoLoss, PictureGradients
from splatree.scene.names import Mode
from splatree.scene.view import View
from splatree.shapes import Array, Float32, Float64
from splatree.train.densify import Rows, Sightings
from splatree.train.exposure import exposed, is_gain
from splatree.train.targets import Target

__all__ = ["Drawing", "drawn", "learn"]

SSIM_WEIGHT = 0.2
"""λ: share of structure in the loss (Kerbl 2023, Eq. 7)."""

ALPHA_WEIGHT = 0.5
"""Weight in the loss of the mean error of alpha, where it is matched."""

REGULARISER = 0.01
"""Weight in the loss of the mean opacity and of the mean scale in extents (Kheradmand 2024, Eq. 11): what nothing needs fades."""


@dataclass(frozen=True)
class Drawing:
    """How views are drawn in training."""

    stages: TrainingStages
    """Of the back end."""
    mode: Mode
    """`classic` or `antialiased`."""
    sh_degree: int
    """Degree of the harmonics that are drawn."""
    threads: int
    """Threads; 0: all there are."""
    times_smaller: int = 1
    """k: pixels of the pictures that the scene is meant for, along each side of a pixel that is drawn."""

    def view(self, camera: Camera) -> View:
        """The view of a camera."""
        pixels = self.times_smaller**2
        dilation_px2 = (DILATION_PX2 + (pixels - 1) / 12) / pixels
        return View(camera, mode=self.mode, sh_degree=self.sh_degree, dilation_px2=dilation_px2)


def drawn(gaussians: Gaussians, view: View, drawing: Drawing) -> tuple[Splats, TileBins, Picture]:
    """The picture of all Gaussians in a view, and what lies between."""
    stages, threads = drawing.stages, drawing.threads
    rows = np.arange(len(gaussians), dtype=np.int32)
    splats = stages.project(gaussians, None, rows, view, threads=threads)
    bins = stages.bin(splats, view, threads=threads)
    return splats, bins, stages.blend(splats, bins, view, threads=threads)


def learn(
    rows: Rows,
    seen: Sightings,
    target: Target,
    exposure: Float64[Array, "3 4"],
    rates: Float32[Array, "e"],
    extent: float,
    drawing: Drawing,
) -> tuple[PhotoLoss, Float32[Array, "h w 3"]]:
    """Make one step for one photograph: rows and what they were seen to do change in place.

    Args:
        rows: the scene and the optimiser's moments.
        seen: what rows were seen to do since the last densification.
        target: the photograph and its camera.
        exposure: what the photograph does to colours, by which the picture is changed before it is compared.
        rates: of each number of a row.
        extent: of the scene, world units.
        drawing: how views are drawn.

    Returns:
        The loss, and the picture as it was drawn before the step.
    """
    view, stages, threads = drawing.view(target.camera), drawing.stages, drawing.threads
    splats, bins, picture = drawn(rows.gaussians, view, drawing)
    M, has_gain = exposure[:, :3], is_gain(exposure)
    image, gain = (picture.image, np.diag(M)) if has_gain else (exposed(picture.image, exposure), np.ones(3))
    loss = stages.photo_loss(image, target.photo, gain, ssim_weight=SSIM_WEIGHT, mask=target.mask, threads=threads)
    by_image = loss.image if has_gain else np.ascontiguousarray(loss.image @ M.astype(np.float32))
    upstream = PictureGradients(by_image, _by_alpha(picture, target), errors=loss.errors)
    by_splats = stages.blend_backward(splats, bins, view, picture, upstream, threads=threads)
    seen.add(splats.rows, by_splats)
    gradients = stages.project_backward(rows.gaussians, splats, by_splats, view, threads=threads)
    _regularise(rows.gaussians, gradients, extent)
    stages.step(rows.gaussians, gradients, rows.moments, rates, threads=threads)
    return loss, picture.image


def _by_alpha(picture: Picture, target: Target) -> Float32[Array, "h w"] | None:
    """Derivative of `ALPHA_WEIGHT` · mean |alpha − that of the photograph|; None where the photograph's is not matched."""
    if target.opacity is None:
        return None
    weight = np.float32(ALPHA_WEIGHT / picture.alpha.size)
    wrong = np.sign(picture.alpha - target.opacity * np.float32(1 / 255))
    return wrong * (weight if target.mask is None else weight * target.mask)


def _regularise(gaussians: Gaussians, gradients: GaussianGradients, extent: float) -> None:
    """Add the derivatives of REGULARISER · (mean opacity + mean scale / extent), in place."""
    weight = np.float32(REGULARISER / len(gaussians))
    opacity = 1 / (1 + np.exp(-gaussians.logit_opacities[gradients.rows]))
    gradients.logit_opacities[:] += weight * opacity * (1 - opacity)
    gradients.log_scales[:] += weight / np.float32(extent) * np.exp(gaussians.log_scales[gradients.rows])
