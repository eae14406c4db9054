"""Measure how good the cuts of some levels look, so that a selection can be asked for a quality.

Views are made from near to far and round the scene. Each is drawn from all leaves and by cuts at growing pixel errors. The PSNRs
of the cuts, with what is merged and covered in each view, give the four numbers of a `QualityCurve` by least squares. A quarter
of the error of the fit is taken off, so that fewer views fall short of what they are asked for.

Pictures count between 28 and 48 dB: worse ones nobody asks for, and better ones hang on a few nodes.

Cost: at most 54 pictures of 320 × 180 px; 2 to 4 CPU-seconds a million Gaussians.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from splatree.errors import InputError
from splatree.lod.quality import COVERING_PX, covered_share, merged_share
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

PIXEL_ERRORS: Final = (2.5, 4.0, 6.5, 10.0, 16.0)
"""τ_R of the cuts, px."""

LOWEST_DB: Final = 28.0
"""Pictures below this do not count, and no coarser cut is drawn."""

HIGHEST_DB: Final = 48.0
"""Pictures above this do not count."""

FEWEST: Final = 8
"""Pictures without which no curve is fitted: twice as many as it has numbers."""

STEADY: Final = 0.03
"""Weight of keeping the numbers small, against a picture's 1: it matters only where views hardly differ."""

CAUTION: Final = 0.25
"""Share of the error of the fit that is taken off the predicted PSNR."""


def with_quality(scene: Scene, cameras: Cameras | Sequence[Camera] | None = None, *, threads: int = 0) -> Scene:
    """Measure how good the cuts of a scene look, and keep it with its levels: `SelectOptions.quality` needs that.

    Args:
        scene: a scene with levels.
        cameras: views like those that will be drawn; None: views are made, five from near to far and four round the scene.
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
    with open_session(scene, threads=threads) as session:
        for camera in track(views, "measure quality"):
            samples += _samples(session, camera)
    if len(samples) < FEWEST:
        raise InputError(
            f"with_quality: found {len(samples)} pictures from {LOWEST_DB:g} to {HIGHEST_DB:g} dB in {len(views)} views, wanted "
            f"at least {FEWEST}; name views that are nearer or farther"
        )
    known = dataclasses.replace(record, quality=_fitted(samples))
    return dataclasses.replace(scene, tree=dataclasses.replace(scene.tree, record=known))


def _made(scene: Scene) -> list[Camera]:
    flight, around = (PathOptions(views=views, width=320, height=180) for views in (5, 2))
    return [*flyout(scene, flight), *orbit(scene, around), *turn(frame_scene(scene), around)]


def _samples(session: Session, camera: Camera) -> list[tuple[float, ...]]:
    """(PSNR, τ_R, merged, covered) of the cuts of a view whose pictures count."""
    scene = session.scene
    wanted = np.clip(session.draw(camera, select=SelectOptions(pixel_error=0.0)).image, 0, 1)
    covered = covered_share(scene, session.select(camera, select=SelectOptions(COVERING_PX)).rows, camera)
    samples: list[tuple[float, ...]] = []
    for pixel_error in PIXEL_ERRORS:
        frame = session.trace(camera, select=SelectOptions(pixel_error))
        found = psnr(np.clip(frame.result.image, 0, 1), wanted)
        if found < LOWEST_DB:
            break
        if found <= HIGHEST_DB:
            samples.append((found, pixel_error, merged_share(scene, frame.selection.rows, camera), covered))
    return samples


def _fitted(samples: Sequence[tuple[float, ...]]) -> QualityCurve:
    psnrs, pixel_errors, *shares = np.array(samples).T
    columns = [np.ones(len(psnrs)), np.log(pixel_errors), *(10 * np.log10(np.maximum(s, LEAST_SHARE)) for s in shares)]
    # Numbers that must not be above 0 are held at it, one after the other: a free fit goes beyond where views hardly differ.
    free = [True] * len(columns)
    while True:
        kept = np.stack([column for column, is_free in zip(columns, free, strict=True) if is_free], axis=1)
        system = np.vstack([kept, STEADY * np.eye(kept.shape[1])])
        solved = np.linalg.lstsq(system, np.append(psnrs, np.zeros(kept.shape[1])), rcond=None)[0]
        numbers = np.zeros(len(columns))
        numbers[free] = solved
        rising = [i for i in (1, 2) if numbers[i] > 0]
        if not rising:
            break
        free[rising[0]] = False
    error = float(np.sqrt(np.mean((kept @ solved - psnrs) ** 2)))
    return QualityCurve(
        offset=float(numbers[0]) - CAUTION * error,
        by_pixel_error=float(numbers[1]),
        by_merged=float(numbers[2]),
        by_covered=float(numbers[3]),
        error_db=error,
        num_pictures=len(psnrs),
    )
