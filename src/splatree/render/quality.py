"""Measure how good the cuts of some levels look, so that a selection can be asked for a quality.

Views are made from near to far and round the scene. Each is drawn from all leaves, and by cuts of nodes that are smaller
and larger than 4 px, as far as their pictures count. The PSNRs of the cuts, with a sketch of each (lod/sketch.py), give the five
numbers of a `QualityCurve` by least squares. Where the error of the fit is large, so much is taken off that the worst of some
ten views falls short of what it is asked for by 2 dB at most.

Pictures count between 28 and 48 dB: worse ones nobody asks for, and better ones hang on a few nodes.

Nine views give some 50 pictures of 320 × 180 px with a sketch of each. In large scenes no further view is begun once ten nodes
for each Gaussian are drawn. 2 to 4 CPU-seconds for 0.15 to half a million Gaussians (benchmarks/promise.py).
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from splatree.errors import InputError
from splatree.lod.quality import COARSEST_PX, FINEST_PX
from splatree.lod.select import for_levels, smallest_radius
from splatree.lod.sketch import Sketcher
from splatree.metrics.psnr import psnr
from splatree.progress import track
from splatree.render.framing.frame import frame_scene
from splatree.render.paths import PathOptions, flyout, orbit, turn
from splatree.render.session import Session, open_session
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.options import SelectOptions
from splatree.scene.quality import LEAST_SHARE, QualityCurve
from splatree.scene.scene import Scene

__all__ = ["with_quality"]

FIRST_PX: Final = 4.0
"""Size of the nodes in the first cut of a view, px."""

STEP: Final = 1.7
"""Factor from the size of one cut to that of the next."""

LOWEST_DB: Final = 28.0
"""Pictures below this do not count, and no coarser cut of the view is drawn."""

HIGHEST_DB: Final = 48.0
"""Pictures above this do not count, and no finer cut of the view is drawn."""

FINE_PX: Final = (2.0, 4.0, 8.0)
"""Sizes of which the one that fits best is taken for that below which nodes are small."""

FAR_TOO_GOOD_DB: Final = 60.0
"""Above this the next cut is two steps coarser."""

NODES_DRAWN: Final = 10
"""Nodes drawn for each Gaussian of the scene after which no further view is begun, if there are pictures enough."""

FEWEST_NODES: Final = 8_000_000
"""The same for small scenes: two seconds' work."""

FEWEST: Final = 8
"""Pictures without which no curve is fitted."""

STEADY: Final = 0.03
"""Weight of keeping the numbers small, against a picture's 1: it matters only where views hardly differ."""

WORST_ERRORS: Final = 2.5
"""Errors of the fit by which the worst of some ten views falls short."""

WORST_DB: Final = 2.0
"""What the worst view may fall short of what it is asked for, dB: where errors are larger, the rest is taken off."""


def with_quality(scene: Scene, cameras: Cameras | Sequence[Camera] | None = None, *, threads: int = 0) -> Scene:
    """Measure how good the cuts of a scene look, and keep it with its levels: `SelectOptions.quality` needs that.

    Args:
        scene: a scene with levels.
        cameras: views like those that will be drawn; None: views are made, five from near to far and four round the scene. In
            large scenes not all are drawn: put those first that say most.
        threads: threads of the processor; 0: all.

    Returns:
        The scene with ``tree.record.quality``.

    Raises:
        InputError: the scene has no levels, or too few of the pictures are between 28 and 48 dB to fit a curve to.

    Example:
        >>> known = st.with_quality(scene, cameras)
        >>> fine = st.select(known, camera, st.SelectOptions(quality=45))
        >>> len(fine) >= len(st.select(known, camera, st.SelectOptions(quality=30)))
        True
    """
    record = scene.tree.record
    if record is None or scene.tree.num_levels < 2:
        raise InputError(
            "with_quality: found a scene without levels that a record describes, wanted one that build_lod made"
        )
    views = list(_made(scene) if cameras is None else cameras)
    samples: list[tuple[float, ...]] = []
    num_drawn = 0
    sketcher = Sketcher.of(scene)
    with open_session(scene, threads=threads) as session:
        for camera in track(views, "measure quality"):
            if len(samples) >= FEWEST and num_drawn > max(NODES_DRAWN * scene.tree.num_leaves, FEWEST_NODES):
                break
            of_view, num_nodes = _samples(session, sketcher, camera)
            samples += of_view
            num_drawn += num_nodes
    if len(samples) < FEWEST:
        raise InputError(
            f"with_quality: found {len(samples)} pictures from {LOWEST_DB:g} to {HIGHEST_DB:g} dB in {len(views)} views, wanted "
            f"at least {FEWEST}; name views that are nearer or farther"
        )
    known = dataclasses.replace(record, quality=_fitted(samples))
    return dataclasses.replace(scene, tree=dataclasses.replace(scene.tree, record=known))


def _made(scene: Scene) -> list[Camera]:
    """Nine views from near to far and round the scene, those first that differ most from each other."""
    framing = frame_scene(scene)
    up = tuple(framing.up.tolist())
    options, around = (PathOptions(views=views, width=320, height=180, up=up) for views in (5, 2))
    flight, circle, turned = flyout(scene, options), orbit(scene, around), turn(framing, around)
    return [flight[2], turned[0], circle[0], flight[4], flight[1], turned[1], circle[1], flight[3], flight[0]]


def _samples(session: Session, sketcher: Sketcher, camera: Camera) -> tuple[list[tuple[float, ...]], int]:
    """(PSNR, τ_R, merged, varied) of the cuts of a view whose pictures count; and how many nodes were drawn for them."""
    leaves = session.draw(camera, select=SelectOptions(pixel_error=0.0))
    wanted, counts = np.clip(leaves.image, 0, 1), [leaves.counters.num_selected]
    point_px = smallest_radius(for_levels(SelectOptions(), session.scene).resolved_profile)
    samples: list[tuple[float, ...]] = []

    def drawn(size_px: float) -> float:
        """The PSNR of a cut, which becomes a sample if it counts."""
        pixel_error = math.hypot(size_px, point_px)
        frame = session.trace(camera, select=SelectOptions(pixel_error))
        counts.append(len(frame.selection))
        found = psnr(np.clip(frame.result.image, 0, 1), wanted)
        if LOWEST_DB <= found <= HIGHEST_DB:
            counts.append(len(frame.selection))
            seen = sketcher.draw(frame.selection.rows, camera)
            samples.append((found, pixel_error, seen.merged, seen.varied))
        return found

    first = found = drawn(FIRST_PX)
    coarser = FIRST_PX
    while found >= LOWEST_DB:
        coarser *= STEP if found < FAR_TOO_GOOD_DB else STEP**2
        if coarser > COARSEST_PX:
            break
        found = drawn(coarser)
    finer = FIRST_PX / STEP
    while first <= HIGHEST_DB and finer >= FINEST_PX:
        first = drawn(finer)
        finer /= STEP
    return samples, sum(counts)


def _fitted(samples: Sequence[tuple[float, ...]]) -> QualityCurve:
    return min((_fitted_to(samples, fine_px) for fine_px in FINE_PX), key=lambda curve: curve.error_db)


def _fitted_to(samples: Sequence[tuple[float, ...]], fine_px: float) -> QualityCurve:
    psnrs, pixel_errors, *shares = np.array(samples).T
    sizes = np.log(pixel_errors), np.minimum(0, np.log(pixel_errors / fine_px))
    columns = [np.ones(len(psnrs)), *sizes, *(10 * np.log10(np.maximum(s, LEAST_SHARE)) for s in shares)]
    # Numbers that must not be above 0 are held at it, one after the other: a free fit goes beyond where views hardly differ.
    free = [True] * len(columns)
    while True:
        kept = np.stack([column for column, is_free in zip(columns, free, strict=True) if is_free], axis=1)
        system = np.vstack([kept, STEADY * np.eye(kept.shape[1])])
        solved = np.linalg.lstsq(system, np.append(psnrs, np.zeros(kept.shape[1])), rcond=None)[0]
        numbers = np.zeros(len(columns))
        numbers[free] = solved
        rising = [i for i in (1, 2, 4) if numbers[i] > 0] or ([3] if numbers[3] + numbers[4] > 0 else [])
        if not rising:
            break
        free[rising[0]] = False
    error = float(np.sqrt(np.mean((kept @ solved - psnrs) ** 2)))
    caution = max(0.0, WORST_ERRORS * error - WORST_DB)
    return QualityCurve(
        offset=float(numbers[0]) - caution,
        by_pixel_error=float(numbers[1]),
        by_fine=float(numbers[2]),
        fine_px=fine_px,
        by_merged=float(numbers[3]),
        by_varied=float(numbers[4]),
        error_db=error,
        num_pictures=len(psnrs),
    )
