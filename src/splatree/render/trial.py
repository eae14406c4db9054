"""Try both methods of building levels on a sample of a scene: which gives the better picture of as many nodes?

The sample is the cube around the middle of the scene that holds a bounded number of its Gaussians: neighbours stay neighbours.
Levels of both methods are built over it. Made views from near to far draw it from all leaves, and from cuts that hold equal
shares of the leaves in view. The mean PSNR decides. Nothing depends on the time that it takes, so the same scene gets the same
answer on any number of threads.

Cost: at most two builds of the sample and 28 pictures of 320 × 180 px, 1.5 CPU-seconds for 60,000 Gaussians of degree 3;
nothing grows with the scene but the choice of the sample, 0.3 CPU-seconds a million Gaussians.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, get_args

import numpy as np

from splatree.errors import InputError
from splatree.lod.build import build_levels, leaves_of
from splatree.lod.options import BuildOptions
from splatree.metrics.psnr import psnr
from splatree.progress import task
from splatree.render.framing.survey import survey_of
from splatree.render.framing.upright import guess_up
from splatree.render.paths import PathOptions, bounds_of, flyout
from splatree.render.session import Session, open_session
from splatree.scene.cameras import Camera
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.thinning import Method
from splatree.scene.trial import MethodTrial
from splatree.shapes import Array

__all__ = ["FEWEST", "SAMPLE", "Tried", "try_both", "try_methods"]

SAMPLE: Final = 60_000
"""Gaussians of the sample: its levels reach from single Gaussians to the whole, and the trial takes about 1.5 CPU-seconds."""

FEWEST: Final = 4_096
"""Scenes of fewer Gaussians are not tried: any picture draws them whole."""

SHARES: Final = (0.05, 0.15, 0.4)
"""Nodes of the cuts, as shares of the leaves in view."""

FEWEST_NODES: Final = 100
"""No cut of fewer nodes is drawn: its PSNR is chance."""

FOR_UP: Final = 8_000
"""Gaussians that say which way is up: views that are wrong about it tell the methods apart as well."""

HIGHEST_DB: Final = 40.0
"""Better pictures count as this: a view that one method shows without loss must not outweigh those that both show with one."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A trial, and what it built on the way."""

    trial: MethodTrial
    """What was found."""
    trees: Mapping[Method, Scene]
    """Levels of the sample by each method."""


def try_methods(
    scene: Scene, options: BuildOptions | None = None, *, most: int = SAMPLE, threads: int = 0
) -> MethodTrial:
    """Measure on a sample which method of building levels gives the better picture of as many nodes.

    Args:
        scene: any scene; its leaves count.
        options: how levels would be built; the method is left out of account.
        most: Gaussians of the sample at most.
        threads: threads to use; 0: all. The result is the same for any number.

    Returns:
        The mean PSNR of both methods.

    Raises:
        InputError: the options suit one method alone, or the scene has no Gaussians.

    Source:
        docs/explanation/build.md, "Which method".

    Example:
        >>> trial = st.try_methods(scene)
        >>> trial.better in ("radius", "pairs")
        True
    """
    return try_both(leaves_of(scene), options or BuildOptions(), most=most, threads=threads).trial


def try_both(flat: Scene, options: BuildOptions, *, most: int = SAMPLE, threads: int = 0) -> Tried:
    """The trial of `try_methods` on a flat scene, with the levels that it built."""
    if (only := options.only_method) is not None:
        raise InputError(f"try_methods: found options that only levels by {only} use, wanted options of both methods")
    sample = _middle_of(flat, most)
    with task("try both methods", 3.0) as advance:
        trees: dict[Method, Scene] = {}
        for method in get_args(Method):
            trees[method] = build_levels(sample, dataclasses.replace(options, method=method), threads=threads)
            advance(1.0)
        psnrs = _psnrs(trees, threads)
        advance(1.0)
    means = {method: float(np.mean(found)) if found else 0.0 for method, found in psnrs.items()}
    trial = MethodTrial(
        radius_db=means["radius"],
        pairs_db=means["pairs"],
        num_gaussians=len(sample),
        num_pictures=len(psnrs["pairs"]),
    )
    return Tried(trial, trees)


def _middle_of(flat: Scene, most: int) -> Scene:
    """The Gaussians that are nearest to the middle, by the largest of their distances along the axes."""
    if len(flat) <= most:
        return flat
    centre, _ = bounds_of(flat)
    distances = np.abs(flat.gaussians.means - centre.astype(np.float32)).max(axis=1)
    rows = np.sort(np.argsort(distances, kind="stable")[:most])
    assert flat.ids is not None
    part = Scene.flat(flat.gaussians.take(rows), mode=flat.mode)
    return dataclasses.replace(part, ids=flat.ids[rows], source=flat.source)


def _psnrs(trees: Mapping[Method, Scene], threads: int) -> dict[Method, list[float]]:
    """PSNR of the cuts of each method, over views and shares."""
    found: dict[Method, list[float]] = {method: [] for method in trees}
    some = next(iter(trees.values()))
    views = _made(some)
    sessions = {method: open_session(tree, threads=threads) for method, tree in trees.items()}
    try:
        for view in views:
            frame = next(iter(sessions.values())).trace(view, select=SelectOptions(pixel_error=0.0))
            wanted, num_leaves = np.clip(frame.result.image, 0, 1), len(frame.selection.rows)
            for share in SHARES:
                budget = int(share * num_leaves)
                if budget < FEWEST_NODES:
                    continue
                try:
                    pictures = {method: _cut(session, view, budget) for method, session in sessions.items()}
                except InputError:  # more roots are in view than the budget allows
                    continue
                for method, picture in pictures.items():
                    found[method].append(min(psnr(picture, wanted), HIGHEST_DB))
    finally:
        for session in sessions.values():
            session.close()
    return found


def _made(scene: Scene) -> list[Camera]:
    """Views from within to far away, and one along the ground."""
    leaves = leaves_of(scene)
    few = Scene.flat(leaves.gaussians.take(np.arange(0, len(leaves), len(leaves) // FOR_UP + 1)))
    x, y, z = (float(part) for part in guess_up(survey_of(few), scene.source).up)
    flight, low = (
        PathOptions(views=views, up=(x, y, z), width=320, height=180, elevation_deg=height)
        for views, height in ((3, 30), (1, 5))
    )
    return [*flyout(scene, flight, nearest=0.4, farthest=5.0), *flyout(scene, low, nearest=0.7, farthest=0.7)]


def _cut(session: Session, view: Camera, budget: int) -> Array:
    return np.clip(session.draw(view, select=SelectOptions(pixel_error=0.0, budget=budget)).image, 0, 1)
