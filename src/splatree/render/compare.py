"""How much of a scene was lost: two scenes drawn from the same views, picture beside picture.

The reference is drawn whole: all its leaves, without loss (splats end at 1/255, exactly). The other scene is drawn as it is meant
to be: by its own mode and threshold and, if it has levels, by a cut of them. Pictures are clipped to 0 to 1 before they are
compared, as a screen would show them.

Black around a scene is equal in both pictures and flatters PSNR. `Difference.psnr_covered` looks at the pixels alone that the
reference covers at least half.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.constants import ALPHA_THRESHOLD, SSIM_WINDOW_PX
from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.metrics.flip import flip_map
from splatree.metrics.ssim import ssim
from splatree.progress import track
from splatree.render.framing.frame import frame_scene
from splatree.render.paths import PathOptions, turn
from splatree.render.session import open_session
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.frame import RenderResult
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float32, check_fields

__all__ = ["ComparedView", "Difference", "compare", "compared", "comparison_views", "summary_of"]

CLOSER: Final = 0.4
"""Every second view from outside is taken from this share of the distance: what is lost in detail shows from near."""

MADE: Final = PathOptions(views=8)
"""Views that are made for a reference if nothing else is asked for."""

COVERED: Final = 0.5
"""Alpha of the reference from which a pixel counts as covered."""


@dataclass(frozen=True)
class Difference:
    """How far pictures are from those of the reference.

    Example:
        >>> view = next(st.compare(scene, st.read("city.ply"), cameras))
        >>> view.difference.name == view.camera.name
        True
    """

    name: str
    """Name of the view, or "all"."""
    psnr: float
    """Peak signal-to-noise ratio, dB, of the mean squared error; infinity if the pictures are equal."""
    psnr_covered: float | None
    """PSNR over the pixels that the reference covers; None if there are none."""
    ssim: float | None
    """Structural similarity (Wang 2004); None for pictures smaller than its window of 11 px."""
    flip: float
    """FLIP (Andersson 2020): 0 for pictures that look equal, at most 1."""
    num_drawn: int
    """Number of nodes drawn."""
    num_drawn_reference: int
    """Number of nodes of the reference drawn."""
    num_pixels: int
    """Number of pixels compared."""
    covered: float
    """Share of the pixels that the reference covers at least half."""


@dataclass(frozen=True, eq=False)
class ComparedView:
    """One view of two scenes.

    Example:
        >>> view = next(st.compare(scene, st.read("city.ply"), [camera.scaled(2)]))
        >>> view.image.shape == view.reference.shape
        True
    """

    camera: Camera
    """The view."""
    difference: Difference
    """How far the pictures are apart."""
    image: Float32[Array, "h w 3"]
    """Picture of the scene, clipped to 0 to 1."""
    reference: Float32[Array, "h w 3"]
    """Picture of the reference, clipped to 0 to 1."""
    errors: Float32[Array, "h w"]
    """FLIP of each pixel."""

    def __post_init__(self) -> None:
        check_fields(self)


@checked
def compare(
    scene: Scene,
    reference: Scene,
    cameras: Iterable[Camera] | None = None,
    *,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    device: DeviceName | None = None,
) -> Iterator[ComparedView]:
    """Compare a scene with the one that it was made from, view by view.

    Args:
        scene: what became of the reference: converted, thinned, built into levels.
        reference: what it was made from, in the same coordinates.
        cameras: views to draw; None: eight that are made for the reference (`comparison_views`).
        options: how both are drawn.
        select: how the nodes of ``scene`` are chosen, if it has levels; None: the defaults.
        device: where both are drawn; None: `cpu`.

    Yields:
        Both pictures and their difference, for each view in order.

    Raises:
        InputError: one of the scenes is empty, or there is no view.

    Example:
        >>> thinned = st.thin(st.read("city.ply"), st.ThinOptions(keep=0.5)).scene
        >>> views = list(st.compare(thinned, st.read("city.ply"), cameras))
        >>> views[0].difference.psnr > 10
        True
    """
    if not len(scene) or not len(reference):
        raise InputError(
            f"compare: found {len(scene)} and {len(reference)} Gaussians, wanted at least one in each scene"
        )
    views = list(comparison_views(reference) if cameras is None else cameras)
    if not views:
        raise InputError("compare: found no view, wanted at least one camera")
    lossless = replace(options or RenderOptions(), tile_rule="ellipse", pixels="hard", threshold=ALPHA_THRESHOLD)
    with (
        open_session(scene, device=device, options=options, select=select) as drawing,
        open_session(
            reference, device=device, options=lossless, select=SelectOptions(pixel_error=0.0, cull="none")
        ) as whole,
    ):
        for camera in track(views, "compare views"):
            yield compared(camera, drawing.draw(camera), whole.draw(camera))


def compared(camera: Camera, drawn: RenderResult, whole: RenderResult) -> ComparedView:
    """Compare a picture with one of the reference, which may be drawn otherwise."""
    image, wanted = np.clip(drawn.image, 0, 1), np.clip(whole.image, 0, 1)
    covered = whole.alpha >= COVERED
    errors = flip_map(image, wanted)
    squared = np.square(image.astype(np.float64) - wanted).mean(axis=2)
    difference = Difference(
        name=camera.name,
        psnr=_decibels(float(squared.mean())),
        psnr_covered=_decibels(float(squared[covered].mean())) if covered.any() else None,
        ssim=ssim(image, wanted) if min(image.shape[:2]) >= SSIM_WINDOW_PX else None,
        flip=float(errors.mean(dtype=np.float64)),
        num_drawn=drawn.counters.num_selected,
        num_drawn_reference=whole.counters.num_selected,
        num_pixels=errors.size,
        covered=float(covered.mean()),
    )
    return ComparedView(camera, difference, image, wanted, errors)


@checked
def comparison_views(reference: Scene, options: PathOptions | None = None) -> Cameras:
    """Make views of a scene, to compare others with it: all round; from outside, every second view is from nearer.

    Args:
        reference: the scene.
        options: number of views, size, elevation and field of view; None: the defaults.

    Returns:
        The views.

    Raises:
        InputError: the scene is empty.

    Example:
        >>> len(st.comparison_views(scene))
        8
    """
    options = options or MADE
    framing = frame_scene(reference, up=options.up, aspect=options.width / options.height)
    around = turn(framing, options)
    if framing.inside:
        return around
    distance = float(np.linalg.norm(framing.eye - framing.target))
    nearer = turn(framing.moved(distance=CLOSER * distance), options)
    return Cameras(tuple((nearer if i % 2 else around)[i] for i in range(len(around))))


def summary_of(differences: Sequence[Difference]) -> Difference:
    """All views as one: PSNR of the mean squared error over all pixels, the other numbers as means over the views.

    Raises:
        InputError: there is no view.
    """
    if not differences:
        raise InputError("summary_of: found no view, wanted at least one")
    pixels = np.array([d.num_pixels for d in differences], float)
    covered = pixels * [d.covered for d in differences]
    squares = [10 ** (-d.psnr / 10) for d in differences]
    covered_squares = [0.0 if d.psnr_covered is None else 10 ** (-d.psnr_covered / 10) for d in differences]
    ssims = [d.ssim for d in differences if d.ssim is not None]
    return Difference(
        name="all",
        psnr=_decibels(float(np.average(squares, weights=pixels))),
        psnr_covered=_decibels(float(np.average(covered_squares, weights=covered))) if covered.sum() else None,
        ssim=float(np.mean(ssims)) if ssims else None,
        flip=float(np.mean([d.flip for d in differences])),
        num_drawn=round(float(np.mean([d.num_drawn for d in differences]))),
        num_drawn_reference=round(float(np.mean([d.num_drawn_reference for d in differences]))),
        num_pixels=round(float(pixels.sum())),
        covered=float(covered.sum() / pixels.sum()),
    )


def _decibels(mean_square: float) -> float:
    return float("inf") if mean_square == 0 else float(-10 * np.log10(mean_square))
