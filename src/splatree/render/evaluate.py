"""What levels of detail and shrinking cost in quality, and what they save: the cut beside all leaves, view by view.

Each view is drawn twice at the same size and in the same run: as the options ask for, and from all leaves (``pixel_error`` 0, no
budget) without loss (splats end at 1/255, exactly). Where a photograph of the view is given, both pictures are also compared with
it. Pictures are clipped to 0 to 1 before they are compared, as a screen would show them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SSIM_WINDOW_PX
from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.metrics.gain import psnr_with_gain
from splatree.metrics.psnr import psnr
from splatree.metrics.ssim import ssim
from splatree.outofcore.store import Store
from splatree.progress import track
from splatree.render.session import open_session
from splatree.render.tensors import TensorScene
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, several
from splatree.scene.frame import Frame
from splatree.scene.given import given
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array


@dataclass(frozen=True)
class Score:
    """How near a picture is to another."""

    psnr: float
    """Peak signal-to-noise ratio, dB; infinity for equal pictures."""
    ssim: float | None
    """Structural similarity (Wang 2004); None for pictures smaller than its window of 11 px."""
    lpips: float | None = None
    """Learned perceptual similarity (Zhang 2018), smaller is nearer; None if it was not asked for."""
    psnr_fitted: float | None = None
    """Against photographs: PSNR of the right half, dB, with a gain for each channel that is fitted on the left half."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One view, drawn from the cut and from all leaves.

    Example:
        >>> found = next(iter(st.evaluate(scene, cameras)))
        >>> len(found.cut.selection) <= len(found.leaves.selection)
        True
    """

    camera: Camera
    """The view."""
    cut: Frame
    """Frame of the nodes that the options select."""
    leaves: Frame
    """Frame of all leaves, without loss."""
    cut_vs_leaves: Score
    """The loss that levels of detail and shrinking cause."""
    cut_vs_photo: Score | None = None
    """Score of the cut against the photograph; None if there is no photograph."""
    leaves_vs_photo: Score | None = None
    """Score of all leaves against the photograph: what the scene itself reaches; None if there is no photograph."""


@checked
def evaluate(
    scene: Scene | TensorScene | Store,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    photos: Mapping[str, Array] | None = None,
    lpips: Callable[[Array, Array], float] | None = None,
    device: DeviceName | None = None,
) -> Iterator[Evaluation]:
    """Compare the cut with all leaves, and both with photographs, view by view.

    Args:
        scene: any scene, or a store.
        cameras: the views.
        options: how the cut is drawn; all leaves are drawn without loss.
        select: which nodes are drawn: options, or a baseline (lod/baselines.py).
        photos: photographs by the camera's name, float32 (h w 3).
        lpips: a loaded `splatree.metrics.lpips.Lpips`; None: LPIPS is not computed.
        device: where: `cpu`, `cuda` or `reference`; None: `cpu`. Both pictures of a view are drawn in one session.

    Yields:
        Frames and scores of each view, in order.

    Raises:
        InputError: a budget of nodes cannot be met, or a photograph has another size than its camera.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example:
        >>> for found in st.evaluate(scene, cameras, select=st.SelectOptions(pixel_error=0)):
        ...     assert found.cut_vs_leaves.psnr > 40
    """
    drawn = given(options, RenderOptions, "evaluate: options")
    lossless = replace(drawn, tile_rule="ellipse", pixels="hard", threshold=ALPHA_THRESHOLD)
    all_leaves = SelectOptions(pixel_error=0.0, cull="none")
    with open_session(scene, device=device, options=options, select=select) as session:
        for camera in track(several(cameras), "evaluate views"):
            cut = session.trace(camera)
            leaves = session.trace(camera, options=lossless, select=all_leaves)
            photo = (photos or {}).get(camera.name)
            yield Evaluation(
                camera,
                cut,
                leaves,
                score(cut.result.image, leaves.result.image, lpips),
                None if photo is None else _photo_score(cut.result.image, photo, lpips),
                None if photo is None else _photo_score(leaves.result.image, photo, lpips),
            )


def _photo_score(image: Array, photo: Array, lpips: Callable[[Array, Array], float] | None) -> Score:
    """The score against a photograph, whose exposure may be another."""
    found = score(image, photo, lpips)
    return replace(found, psnr_fitted=psnr_with_gain(image, photo))


def score(image: Array, reference: Array, lpips: Callable[[Array, Array], float] | None = None) -> Score:
    """PSNR, SSIM and, if its network is given, LPIPS of two pictures as a screen shows them."""
    image, reference = np.clip(image, 0, 1), np.clip(reference, 0, 1)
    large = min(image.shape[:2]) >= SSIM_WINDOW_PX
    return Score(
        psnr(image, reference),
        ssim(image, reference) if large else None,
        None if lpips is None else lpips(image, reference),
    )
