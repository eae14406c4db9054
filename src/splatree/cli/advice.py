"""What ``splatree info`` advises: which Gaussians look like outliers, and which command would drop them."""

from dataclasses import dataclass

import numpy as np

from splatree.edit.clean import CleanOptions, would_drop
from splatree.scene.scene import Scene
from splatree.shapes import Array

FAR = 10.0
"""Radii of half the scene beyond which a Gaussian counts as far."""
LARGE = 1.0
"""Radii of half the scene from which a standard deviation counts as large."""


@dataclass(frozen=True)
class Outliers:
    """Gaussians that look as if they did not belong into the scene."""

    kind: str
    """What they are."""
    number: int
    """Gaussians of this kind."""
    advice: str
    """Command that shows or drops them; INPUT and OUTPUT stand for the files."""


_DOUBT_MIN = 100
"""Gaussians from which on it is no chance that all opacities are from 0 to 1."""

_THICK = 0.1
"""Median standard deviation, in radii of half the scene, from which logarithms that are all above 0 are doubted."""


def doubts_of(scene: Scene, logits: Array, sizes: Array, half_radius: float) -> tuple[str, ...]:
    """What of a scene looks as if its file held other values than its format says, a sentence each.

    Trained logits reach below 0 and above 1, and logarithms of standard deviations below 0 unless the scene is huge.

    Args:
        scene: the scene.
        logits: of the opacity of each leaf.
        sizes: longest standard deviation of each leaf, world units.
        half_radius: radius that holds half of the leaves, world units.
    """
    if len(sizes) < _DOUBT_MIN or half_radius == 0:
        return ()
    doubts = []
    least, largest = float(logits.min()), float(logits.max())
    if least >= 0 and largest <= 1 and least < largest:
        doubts.append("its logits are all from 0 to 1: they may be opacities, and the picture wrong")
    if float(scene.gaussians.log_scales.min()) > 0 and float(np.median(sizes)) > _THICK * half_radius:
        doubts.append(
            "its Gaussians are all larger than 1, and as large as the scene: their logarithms may be plain standard deviations"
        )
    return tuple(doubts)


def outliers_of(scene: Scene, sizes: Array, opacities: Array, half_radius: float) -> tuple[Outliers, ...]:
    """The kinds of outliers that a scene has.

    Args:
        scene: the scene; its harmonics do not count.
        sizes: longest standard deviation of each leaf, world units.
        opacities: of each leaf, 0 to 1.
        half_radius: radius that holds half of the leaves, world units.
    """
    if len(sizes) == 0:
        return ()
    dropped = would_drop(scene, CleanOptions(max_distance=FAR, floaters=True))
    limit = float(f"{max(LARGE * half_radius, 1e-30):.2g}")
    far, floaters = dropped["farther than max_distance"], dropped["floaters"]
    if floaters > len(sizes) / 2:  # without a body there is nothing that they float around
        floaters = 0
    large, faint = int(np.sum(sizes > limit)), int(np.sum(opacities < scene.threshold))
    found = (
        Outliers(f"farther than {FAR:g} radii", far, f"splatree clean INPUT --max-distance {FAR:g} --dry-run"),
        Outliers(f"larger than {limit:g}", large, f"splatree clean INPUT --max-size {limit:g} --dry-run"),
        Outliers("in floaters", floaters, "splatree clean INPUT --floaters --dry-run"),
        Outliers("too faint to be drawn", faint, f"splatree convert INPUT OUTPUT --min-opacity {scene.threshold:.3g}"),
    )
    return tuple(kind for kind in found if kind.number)
