"""Choose τ, the opacity at which splats end, for a scene and its training views.

Policies (FilterGS 2026, §3.3, Eq. 8; G is the mean contribution of a pair, render/contribution.py):

- ``target`` (default): the largest τ whose mean loss of PSNR is within a budget in dB, over the nearer half of the views and over
  the farther half, by bisection: far views, which lose little, then do not pay for near ones;
- ``worst``: the largest τ at which no view loses more than the budget, so that near and far views keep the same promise;
- ``paper``: τ = λ_G / G, as Eq. 8 says: crowded scenes, where G is small, are shrunk more;
- ``release``: τ = λ_G · G, as the code of FilterGS computes: crowded scenes are shrunk less;
- ``fixed``: the render option ``threshold``, or 1/255.

Unless another tile rule is asked for, ``target`` and ``worst`` take `balanced`, the others the same τ for all splats, `ellipse`.
No τ goes below 1/255, down to which the blend draws anyway, nor above 0.5.

Views are near or far by the mean depth of what they see; the middle one is in both halves, and views of nothing are in none.

What a loss of x dB means. With photographs: the mean over views of PSNR(lossless, photo) − PSNR(shrunk, photo). Without: the
lossless picture is taken to be Q dB from the truth (``scene_psnr``), and the error of shrinking independent of that one, so that
their squares add up: a view that is P dB from its lossless picture loses

    10 log10(1 + 10^((Q − P) / 10)) dB

With Q = 30 a loss of 0.1 dB is reached at P = 46.3 dB.

Cost: one lossless drawing of each view, and one more at each of up to ten trials of τ. Lossless pictures are kept where there
are no photographs: 12 bytes a pixel and view, 24 views of 960 × 540 px take 150 MB.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final, Literal

import numpy as np

from splatree.constants import ALPHA_THRESHOLD
from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.metrics.psnr import psnr
from splatree.outofcore.store import Store
from splatree.progress import task
from splatree.render.contribution import Tiles, Unit, tile_contributions
from splatree.render.session import Session, open_session
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame
from splatree.scene.literals import check_literals
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene, TileRule
from splatree.shapes import Array

__all__ = ["CalibrateOptions", "Calibration", "Policy", "Trial", "calibrate", "calibrated"]

Policy = Literal["target", "worst", "paper", "release", "fixed"]
"""Named ways to choose τ."""

FOUND_BY_LOSS: Final = ("target", "worst")
"""Policies that draw pictures at one τ after the other."""

THRESHOLD_MAX: Final = 0.5
"""Largest τ that is chosen: above it splats of medium opacity vanish altogether."""

BISECTIONS: Final = 8
"""Halvings of ln(0.5 / (1/255)) = 4.85: τ is found to 2 %."""

METADATA_KEY: Final = "calibration"
"""Where a scene keeps how its threshold was chosen, as JSON."""

STORED_AS: Final = {"tile_rule": "extent"}
"""Fields of that record whose name in files is an older one."""


@dataclass(frozen=True)
class CalibrateOptions:
    """How τ is chosen.

    Example:
        >>> st.calibrate(scene, cameras, st.CalibrateOptions(policy="paper")).policy
        'paper'
    """

    policy: Policy = "target"
    """`target` meets a mean loss of PSNR, near by and far away, `worst` a loss that no view exceeds; `paper`
    is λ_G / G, and `release` λ_G · G; `fixed` is --threshold, or 1/255."""
    loss_db: float = 0.1
    """Loss of PSNR that is allowed, dB: for `target` the mean over the nearer and over the farther half of the views, for `worst`
    that of each view."""
    scene_psnr: float = 30.0
    """Without photographs: PSNR that the lossless pictures are assumed to have against the truth, dB."""
    lambda_g: float = 0.2
    """For `paper` and `release`: λ_G."""
    lists: TileRule = "ellipse"
    """For `paper` and `release`: tile rule of the lists over which G is the mean; `3sigma` as in the code of FilterGS."""
    tiles: Tiles = "all"
    """For `paper` and `release`: whether tiles without splats count, as 0."""
    unit: Unit = "pixels"
    """For `paper` and `release`: whether G is in pixels, 0 to 256, or in shares of a tile, 0 to 1."""
    max_views: int = 24
    """Draw at most this many of the views, spread evenly over them."""

    def __post_init__(self) -> None:
        check_literals(self)
        for name in ("loss_db", "scene_psnr", "lambda_g"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{name}: found {getattr(self, name)}, wanted more than 0")
        if self.max_views < 1:
            raise InputError(f"max_views: found {self.max_views}, wanted at least 1")


@dataclass(frozen=True)
class Trial:
    """What one τ costs and saves over the views."""

    threshold: float
    """τ."""
    loss_db: float
    """Mean loss of PSNR over the nearer or the farther half of the views, the larger, dB; the head of this module defines it."""
    worst_loss_db: float
    """Largest loss of a view, dB."""
    worst_view: str
    """Name of that view, or its number if it has none; empty if nothing was drawn."""
    psnr: float | None
    """PSNR of the mean squared error against the lossless pictures, dB; None if they are equal or photographs are judged by."""
    num_pairs: int
    """N_P over all views."""


@dataclass(frozen=True)
class Calibration:
    """A τ, and where it comes from.

    Example:
        >>> found = st.calibrate(scene, cameras)
        >>> found.threshold >= 1 / 255, found.num_pairs <= found.num_pairs_lossless
        (True, True)
    """

    policy: Policy
    """Policy by which τ was chosen."""
    threshold: float
    """τ: opacity at which a splat ends."""
    loss_db: float
    """Mean loss of PSNR at this τ over the nearer or the farther half of the views, the larger, dB."""
    worst_loss_db: float
    """Largest loss of a view at this τ, dB: what to expect of the worst view."""
    worst_view: str
    """Name of that view, or its number if it has none; empty if no τ above 1/255 is within the budget."""
    psnr: float | None
    """PSNR of the mean squared error against the lossless pictures, dB; None if the pictures are identical, or if the loss was
    measured against photographs."""
    num_pairs: int
    """N_P over all views at this τ."""
    num_pairs_lossless: int
    """N_P over all views at τ = 1/255."""
    contribution: float
    """G of the views, in the unit and over the lists and tiles that the options name."""
    photographs: bool
    """Whether losses were measured against photographs."""
    views: tuple[str, ...]
    """Names of the views that were drawn, or their numbers if they have none."""
    size_px: tuple[int, int]
    """Width and height of the first view."""
    options: CalibrateOptions
    """The options that were given."""
    tile_rule: TileRule
    """Tile rule that τ was chosen for. `target` takes `balanced` unless another one is asked for, the other policies
    `ellipse`."""
    pixels: str
    """What splats drew in their tiles: `hard` or `taper`."""
    pixel_error: float | None
    """τ_R of the selection, px; None if a quality chose it."""
    trials: tuple[Trial, ...]
    """Every τ that was tried, in order."""

    def __post_init__(self) -> None:
        check_literals(self)


def calibrate(
    scene: Scene | Store,
    cameras: Sequence[Camera],
    options: CalibrateOptions | None = None,
    render: RenderOptions | None = None,
    select: SelectOptions | None = None,
    *,
    photos: Mapping[str, Array] | None = None,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Calibration:
    """Choose τ, the opacity at which splats end, for a scene.

    τ depends on the size of the pictures and on the level of detail: calibrate with what will be drawn.

    Args:
        scene: any scene, or a store, of which the pages are read that the views need.
        cameras: views like those that will be drawn; those of the training if there are photographs. Keep views apart that
            will be scored.
        options: policy and its parameters; None: a loss of 0.1 dB.
        render: how the views are drawn, beside τ.
        select: which nodes are drawn.
        photos: photographs by the camera's name, float32 (h w 3). If there are any, only views that have one are drawn.
        device: where: `cpu`, `cuda` or `reference`; None: `cpu`.
        threads: threads of the processor; 0: all.

    Returns:
        τ with its loss, pairs, views and options; `calibrated` stores it in the scene.

    Raises:
        InputError: there is no view, or the tile rule is `3sigma`, which does not depend on τ.

    Source:
        FilterGS 2026, §3.3, Eq. 8, for the policies `paper` and `release`; docs/explanation/shrinking.md.

    Example:
        >>> found = st.calibrate(scene, cameras)
        >>> found.loss_db <= 0.1
        True
    """
    options, render, select = options or CalibrateOptions(), render or RenderOptions(), select or SelectOptions()
    if render.tile_rule == "3sigma":
        raise InputError("tile_rule: found '3sigma', which does not depend on τ; wanted another")
    tile_rule: TileRule = render.tile_rule or ("balanced" if options.policy in FOUND_BY_LOSS else "ellipse")
    render = replace(render, tile_rule=tile_rule)
    with_photo = [camera for camera in cameras if camera.name in photos] if photos else list(cameras)
    if not with_photo:
        found = f"{len(cameras)} views, none with a photograph" if cameras else "no view"
        raise InputError(f"calibrate: found {found}, wanted at least one view to draw")
    chosen = np.unique(np.linspace(0, len(with_photo) - 1, min(options.max_views, len(with_photo))).round().astype(int))
    views = [with_photo[i] for i in chosen]
    with open_session(scene, device=device, select=select, threads=threads) as session:
        studio = _Studio(session, views, options, render, photos or {})
        with task("calibrate", total=len(views) * (BISECTIONS + 2)) as studio.advance:
            studio.draw_lossless()
            best, trials = studio.choose()
    return Calibration(
        policy=options.policy,
        threshold=best.threshold,
        loss_db=best.loss_db,
        worst_loss_db=best.worst_loss_db,
        worst_view=best.worst_view,
        psnr=best.psnr,
        num_pairs=best.num_pairs,
        num_pairs_lossless=studio.num_pairs_lossless,
        contribution=studio.contribution,
        photographs=bool(photos),
        views=tuple(view.name or str(number) for number, view in zip(chosen, views, strict=True)),
        size_px=(views[0].width, views[0].height),
        options=options,
        tile_rule=tile_rule,
        pixels=render.pixels,
        pixel_error=select.pixel_error if select.quality is None else None,
        trials=tuple(trials),
    )


def calibrated(scene: Scene, calibration: Calibration, **provenance: str) -> Scene:
    """Store a calibration in a scene.

    Args:
        scene: the scene that was calibrated.
        calibration: what `calibrate` found.
        provenance: more entries, text by name, for the record in the metadata.

    Returns:
        The scene with τ as its ``threshold``, the tile rule, and in its metadata how τ was chosen.

    Example:
        >>> found = st.calibrate(scene, cameras)
        >>> st.calibrated(scene, found).threshold == found.threshold
        True
    """
    record = {STORED_AS.get(name, name): value for name, value in asdict(calibration).items() if name != "trials"}
    record |= provenance
    metadata = {**scene.source.metadata, METADATA_KEY: json.dumps(record)}
    return replace(
        scene,
        threshold=calibration.threshold,
        tile_rule=calibration.tile_rule,
        source=replace(scene.source, metadata=metadata),
    )


class _Studio:
    """Draws the views at one τ after the other, in one session."""

    def __init__(
        self,
        session: Session,
        views: Sequence[Camera],
        options: CalibrateOptions,
        render: RenderOptions,
        photos: Mapping[str, Array],
    ) -> None:
        self.session, self.views, self.options, self.render, self.photos = session, views, options, render, photos
        self.advance: Callable[[float], None] = lambda units: None
        self.num_pairs_lossless = 0
        self.contribution = 0.0

    def draw(self, view: Camera, render: RenderOptions) -> Frame:
        self.advance(1)
        return self.session.trace(view, options=render)

    def draw_lossless(self) -> None:
        """Draw all views with the exact test at 1/255; keep their pictures, or else how far they are from the photographs."""
        lossless = replace(self.render, tile_rule="ellipse", pixels="hard", threshold=ALPHA_THRESHOLD)
        self.pictures: list[Array] = []
        self.photo_psnrs: list[float] = []
        contributions = []
        depths = []
        for view in self.views:
            frame = self.draw(view, lossless)
            depths.append(_mean_depth(frame))
            self.num_pairs_lossless += frame.bins.num_pairs
            if self.photos:
                self.photo_psnrs.append(psnr(_shown(frame), self.photos[view.name]))
            else:
                self.pictures.append(_shown(frame))
            if self.options.lists != "ellipse":
                frame = self.session.trace(view, options=replace(lossless, tile_rule=self.options.lists))
            contributions.append(tile_contributions(frame).mean(tiles=self.options.tiles, unit=self.options.unit))
        self.contribution = float(np.mean(contributions))
        self.halves = _halves(depths)

    def choose(self) -> tuple[Trial, list[Trial]]:
        """The trial that the policy asks for, and all that were made."""
        if self.options.policy in FOUND_BY_LOSS:
            return self._largest_within_budget()
        wanted = {
            "paper": self.options.lambda_g / self.contribution if self.contribution else math.inf,
            "release": self.options.lambda_g * self.contribution,
            "fixed": self.render.threshold or ALPHA_THRESHOLD,
        }[self.options.policy]
        trial = self.attempt(min(max(wanted, ALPHA_THRESHOLD), THRESHOLD_MAX))
        return trial, [trial]

    def _largest_within_budget(self) -> tuple[Trial, list[Trial]]:
        best = Trial(ALPHA_THRESHOLD, 0.0, 0.0, "", None, self.num_pairs_lossless)
        if self.render.tile_rule == "tau":  # not what was drawn as lossless
            best = self.attempt(ALPHA_THRESHOLD)
        above = self.attempt(THRESHOLD_MAX)
        trials = [best, above]
        if self.keeps(above):
            return above, trials
        for _ in range(BISECTIONS):
            trial = self.attempt(math.sqrt(best.threshold * above.threshold))
            trials.append(trial)
            if self.keeps(trial):
                best = trial
            else:
                above = trial
        return best, trials

    def keeps(self, trial: Trial) -> bool:
        """Whether a trial is within the budget."""
        loss = trial.worst_loss_db if self.options.policy == "worst" else trial.loss_db
        return loss <= self.options.loss_db

    def attempt(self, threshold: float) -> Trial:
        """Draw all views with one τ."""
        losses, errors, num_pairs = [], [], 0
        for i, view in enumerate(self.views):
            frame = self.draw(view, replace(self.render, threshold=threshold))
            num_pairs += frame.bins.num_pairs
            if self.photos:
                losses.append(self.photo_psnrs[i] - psnr(_shown(frame), self.photos[view.name]))
            else:
                errors.append(10 ** (-psnr(_shown(frame), self.pictures[i]) / 10))
                losses.append(10 * math.log10(1 + errors[-1] * 10 ** (self.options.scene_psnr / 10)))
        error = float(np.mean(errors)) if errors else 0.0
        worst = int(np.argmax(losses))
        return Trial(
            threshold=threshold,
            loss_db=max(float(np.mean(np.array(losses)[half])) for half in self.halves),
            worst_loss_db=float(losses[worst]),
            worst_view=self.views[worst].name or str(worst),
            psnr=-10 * math.log10(error) if error else None,
            num_pairs=num_pairs,
        )


def _mean_depth(frame: Frame) -> float:
    """Mean depth of what a picture shows; infinity if it shows nothing."""
    alpha = frame.result.alpha.astype(np.float64)
    shown = float(alpha.sum())
    return float((alpha * frame.result.depth).sum()) / shown if shown > 0 else math.inf


def _halves(depths: Sequence[float]) -> tuple[Array, Array]:
    """Numbers of the nearer and of the farther half of the views; all, if none shows anything."""
    order = np.argsort(depths, kind="stable")
    order = order[: int(np.isfinite(depths).sum())] if np.isfinite(depths).any() else order
    size = -(-len(order) // 2)
    return order[:size], order[len(order) - size :]


def _shown(frame: Frame) -> Array:
    """The picture as a screen shows it."""
    return np.clip(frame.result.image, 0, 1)
