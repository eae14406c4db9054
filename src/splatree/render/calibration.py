"""A τ that was chosen for a scene: how it was to be chosen, what each trial cost and saved, and what came out.

A loss that no view exceeds is that of the views that were drawn. If another view is like them, so that all orders of the n + 1
are equally likely, it is the worst of them with probability 1 / (n + 1): so often it loses more than the worst of n. How much
more, the views that were drawn do not tell (docs/explanation/shrinking.md).
"""

import json
import math
from dataclasses import asdict, dataclass, replace
from typing import Final, Literal

from splatree.errors import InputError
from splatree.render.contribution import Tiles, Unit
from splatree.scene.arguments import checked
from splatree.scene.literals import check_literals
from splatree.scene.scene import Scene, TileRule

__all__ = ["METADATA_KEY", "CalibrateOptions", "Calibration", "Policy", "Trial", "calibrated"]

Policy = Literal["target", "worst", "paper", "release", "fixed"]
"""Named ways to choose τ."""

METADATA_KEY: Final = "calibration"
"""Where a scene keeps how its threshold was chosen, as JSON."""

STORED_AS: Final = {"tile_rule": "extent"}
"""Fields of that record whose name in files is an older one."""


PSNR_MAX = 200.0
"""dB: float32 has 150."""


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
        if self.scene_psnr > PSNR_MAX:
            raise InputError(f"scene_psnr: found {self.scene_psnr} dB, wanted at most {PSNR_MAX:g}")
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
    """Largest loss of a view that was drawn at this τ, dB. Of other views like these, `exceeded` lose more."""
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

    @property
    def exceeded(self) -> float:
        """Share of other views, of the kind of those that were drawn, that is expected to lose more than the worst of these."""
        return 1 / (len(self.views) + 1)


@checked
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
