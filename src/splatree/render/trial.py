"""Try both methods of building levels on a sample of a scene: which gives the better picture of as many nodes?

The sample is the cube around the middle of the scene that holds a bounded number of its Gaussians: neighbours stay neighbours.
Levels of both methods are built over it. Three made views from outside draw it from all leaves, and from cuts that hold equal
shares of the leaves in view. The mean PSNR decides; the picture in which a radius loses most is kept, too. Views from within
tell nothing: the sample is cut out of its scene, and its cut faces are walls that hide the rest. Nothing depends on the time
that it takes, so the same scene gets the same answer on any number of threads.

Cost: at most two builds of the sample and 27 pictures of 320 × 180 px, 1.5 CPU-seconds for 60,000 Gaussians of degree 3;
nothing grows with the scene but the choice of the sample, 0.3 CPU-seconds a million Gaussians.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, get_args

import numpy as np

from splatree.errors import InputError
from splatree.io.chunks import Chunks
from splatree.lod.build import build_levels, leaves_of
from splatree.lod.options import BuildOptions
from splatree.metrics.psnr import psnr
from splatree.progress import task
from splatree.render.framing.survey import survey_of
from splatree.render.framing.upright import guess_up
from splatree.render.paths import PathOptions, bounds_of, bounds_of_sample, flyout, sample_stride
from splatree.render.session import Session, open_session
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.thinning import Method
from splatree.scene.trial import MethodTrial
from splatree.shapes import Array, Int64

__all__ = ["FEWEST", "SAMPLE", "Tried", "middle_of", "middle_of_chunks", "try_both", "try_methods"]

SAMPLE: Final = 60_000
"""Gaussians of the sample: its levels reach from single Gaussians to the whole, and the trial takes about 1.5 CPU-seconds."""

FEWEST: Final = 4_096
"""Scenes of fewer Gaussians are not tried: any picture draws them whole."""

SHARES: Final = (0.05, 0.15, 0.4, 0.8)
"""Nodes of the cuts, as shares of the leaves in view. At the largest, levels by a radius lose most."""

FEWEST_NODES: Final = 100
"""No cut of fewer nodes is drawn: its PSNR is chance."""

FOR_UP: Final = 8_000
"""Gaussians that say which way is up: views that are wrong about it tell the methods apart as well."""

HIGHEST_DB: Final = 59.0
"""Better pictures count as this: it is what rounding to 8 bits leaves of an exact picture, 12 × 255² to 1."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A trial, and what it built on the way."""

    trial: MethodTrial
    """What was found."""
    trees: Mapping[Method, Scene]
    """Levels of the sample by each method."""


@checked
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
    return try_both(middle_of(leaves_of(scene), most), options or BuildOptions(), threads=threads).trial


def try_both(sample: Scene, options: BuildOptions, *, threads: int = 0) -> Tried:
    """The trial of `try_methods` on a flat sample, with the levels that it built."""
    if (only := options.only_method) is not None:
        raise InputError(f"try_methods: found options that only levels by {only} use, wanted options of both methods")
    with task("try both methods", 3.0) as advance:
        trees: dict[Method, Scene] = {}
        for method in get_args(Method):
            trees[method] = build_levels(sample, replace(options, method=method), threads=threads)
            advance(1.0)
        psnrs = _psnrs(trees, _made(sample), threads)
        advance(1.0)
    means = {method: float(np.mean(found)) if found else 0.0 for method, found in psnrs.items()}
    trial = MethodTrial(
        radius_db=means["radius"],
        pairs_db=means["pairs"],
        num_gaussians=len(sample),
        num_pictures=len(psnrs["pairs"]),
        radius_loss_db=max(
            (pairs - radius for radius, pairs in zip(psnrs["radius"], psnrs["pairs"], strict=True)), default=0.0
        ),
    )
    return Tried(trial, trees)


def middle_of(flat: Scene, most: int) -> Scene:
    """The Gaussians that are nearest to the middle, by the largest of their distances along the axes."""
    if len(flat) <= most:
        return flat
    assert flat.ids is not None
    gaussians, rows = nearest_to(bounds_of(flat)[0], [flat.gaussians], most)
    return replace(Scene.flat(gaussians, mode=flat.mode), ids=flat.ids[rows], source=flat.source)


def middle_of_chunks(chunks: Chunks, most: int = SAMPLE) -> Scene:
    """The same of a scene that is read in chunks, twice if there are more."""
    stride, first, sample = sample_stride(len(chunks)), 0, []
    for chunk in chunks:
        sample.append(chunk.take(np.arange(-first % stride, len(chunk), stride)))
        first += len(chunk)
    centre, _ = bounds_of_sample(Gaussians.concatenate(sample))
    gaussians, rows = nearest_to(centre, chunks, most)
    return replace(Scene.flat(gaussians, mode=chunks.mode), ids=rows.astype(np.uint32), source=chunks.source)


def nearest_to(centre: Array, chunks: Iterable[Gaussians], most: int) -> tuple[Gaussians, Int64[Array, "s"]]:
    """The Gaussians nearest to a centre by the largest of their distances along the axes, and their rows, ascending."""
    kept: list[Gaussians] = []
    distances, rows, first = np.empty(0, np.float32), np.empty(0, np.int64), 0
    for chunk in chunks:
        near = np.abs(chunk.means - centre.astype(np.float32)).max(axis=1)
        distances = np.concatenate([distances, near])
        rows = np.concatenate([rows, first + np.arange(len(chunk))])
        first += len(chunk)
        chosen = np.sort(np.argsort(distances, kind="stable")[:most])
        num_before = len(distances) - len(chunk)
        before, now = chosen[chosen < num_before], chosen[chosen >= num_before] - num_before
        kept = [*([kept[0].take(before)] if kept else []), chunk.take(now)]
        kept = [Gaussians.concatenate(kept)]
        distances, rows = distances[chosen], rows[chosen]
    return kept[0], rows


def _psnrs(trees: Mapping[Method, Scene], views: list[Camera], threads: int) -> dict[Method, list[float]]:
    """PSNR of the cuts of each method, over views and shares."""
    found: dict[Method, list[float]] = {method: [] for method in trees}
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


def _made(sample: Scene) -> list[Camera]:
    """Views from outside: two from above, to far away, and one along the ground. The order of the rows counts: it is as read."""
    few = Scene.flat(sample.gaussians.take(np.arange(0, len(sample), len(sample) // FOR_UP + 1)))
    x, y, z = (float(part) for part in guess_up(survey_of(few), sample.source).up)
    flight, low = (
        PathOptions(views=views, up=(x, y, z), width=320, height=180, elevation_deg=height)
        for views, height in ((2, 30), (1, 5))
    )
    return [*flyout(sample, flight, nearest=2.2, farthest=5.0), *flyout(sample, low, nearest=1.0, farthest=1.0)]


def _cut(session: Session, view: Camera, budget: int) -> Array:
    return np.clip(session.draw(view, select=SelectOptions(pixel_error=0.0, budget=budget)).image, 0, 1)
