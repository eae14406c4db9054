"""Fuzz of culling: Gaussians of all sizes and shapes around cameras of all kinds; does a rule lose one that would be drawn?

Positions are log-radial around the eye, from 0.01 to 10,000; standard deviations 1e-4 to 100 with axes of up to 100 : 1; fields
of view 30 to 120°; principal points off the centre; sizes no multiples of 16; eyes away from the origin. Clusters hold one
Gaussian, some, or very many around the camera. Each exact rule is held against the survivors of its own rasteriser
(clusters/survivors.py); the rules of the paper are held against those of Kerbl 2023 and must lose some, or the fuzz is blind.
"""

from dataclasses import dataclass

import numpy as np

from splatree.bench.experiment import Report, Row, Table
from splatree.bench.provenance import machine, program
from splatree.clusters.build import ClusterOptions, build_clusters
from splatree.clusters.cull import cull
from splatree.clusters.survivors import survivors
from splatree.errors import InputError
from splatree.progress import track
from splatree.scene.cameras import Camera
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import Cull
from splatree.scene.scene import Scene
from splatree.scene.view import view_of

__all__ = ["Options", "run"]

ROWS = 20_000
"""Gaussians of a scene at most."""
ROWS_PER_CLUSTER = (1, 8, 64, 2000)
"""Taken in turn."""
JUDGED_BY: dict[Cull, Cull] = {
    "exact": "exact",
    "exact-inria": "exact-inria",
    "exact-gsplat": "exact-gsplat",
    "paper": "exact-inria",
    "paper-guard": "exact-inria",
    "paper-distance": "exact-inria",
}
"""Rule to the rasteriser whose survivors it must not lose."""


@dataclass(frozen=True)
class Options:
    """Look for a Gaussian that a rule of culling leaves out though it would be drawn: none may be found for exact rules."""

    gaussians: int = 400_000
    """Gaussians tried with each rule."""
    frames: int | None = None
    """Random views, each with Gaussians of its own around it; None: one for 20,000 Gaussians."""
    seed: int = 0
    """Of the random scenes."""

    def __post_init__(self) -> None:
        if self.gaussians < 1:
            raise InputError(f"gaussians: found {self.gaussians}, wanted at least 1")
        if self.seed < 0:
            raise InputError(f"seed: found {self.seed}, wanted 0 or more")
        if self.frames is not None and not 1 <= self.frames <= self.gaussians:
            raise InputError(f"frames: found {self.frames}, wanted 1 to {self.gaussians}, the number of Gaussians")


def run(options: Options) -> Report:
    """Make scene after scene, and count what each rule loses."""
    counts = {rule: np.zeros(3, np.int64) for rule in JUDGED_BY}  # survivors, left out, lost
    for i, size in enumerate(track(_rows_of_views(options), "fuzz culling")):
        rng = np.random.default_rng([options.seed, i])
        camera = random_camera(rng)
        scene = Scene.flat(random_gaussians(rng, camera, size))
        number = max(1, size // ROWS_PER_CLUSTER[i % len(ROWS_PER_CLUSTER)])
        scene = build_clusters(scene, number, ClusterOptions(iterations=1))
        view = view_of(scene, camera)
        seen = {by: survivors(scene.gaussians, view, by) for by in set(JUDGED_BY.values())}
        for rule, by in JUDGED_BY.items():
            assert scene.clusters is not None
            culling = cull(scene.clusters, view, rule)
            left_out = np.ones(size, bool)
            left_out[culling.rows] = False
            counts[rule] += (seen[by].sum(), left_out.sum(), (seen[by] & left_out).sum())
    rows = [_row(rule, options.gaussians, *counts[rule].tolist()) for rule in JUDGED_BY]
    notes = ("The paper's rules are the negative control: the fuzz sees what they lose.",)
    title = "Survivors that rules of culling leave out"
    about = {"gaussians": f"{options.gaussians:,}, seed {options.seed}", "machine": machine(), "version": program()}
    return Report("cullfuzz", title, about, [Table("cullfuzz", title, rows, notes=notes)])


def _rows_of_views(options: Options) -> list[int]:
    """Gaussians around each view: they add up to those asked for."""
    if options.frames is None:
        return [min(ROWS, options.gaussians - begin) for begin in range(0, options.gaussians, ROWS)]
    least, more = divmod(options.gaussians, options.frames)
    return [least + (i < more) for i in range(options.frames)]


def _row(rule: Cull, tried: int, survived: int, left_out: int, lost: int) -> Row:
    return {
        "rule": rule,
        "judged by": JUDGED_BY[rule],
        "Gaussians": tried,
        "survivors": survived,
        "left out": left_out,
        "of the others, %": 100 * (left_out - lost) / max(1, tried - survived),
        "lost": lost,
    }


def random_camera(rng: np.random.Generator) -> Camera:
    """A pinhole with a wild principal point, somewhere, looking anywhere."""
    width, height = (int(x) for x in rng.integers(17, 1200, 2))
    eye, target = rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-2, 3)
    view = Camera.look_at(
        eye, target, up=rng.normal(size=3), width=width, height=height, fov_y_deg=float(rng.uniform(30, 120))
    )
    K = view.K.copy()
    K[0, 0] *= rng.uniform(0.7, 1.4)
    K[:2, 2] += rng.uniform(-0.4, 0.4, 2) * (width, height)
    return Camera(view.camera_from_world, K, width, height)


def random_gaussians(rng: np.random.Generator, camera: Camera, n: int) -> Gaussians:
    """Gaussians at all distances from the eye, of all sizes, long and flat ones among them."""
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = camera.position + directions * 10.0 ** rng.uniform(-2, 4, (n, 1))
    log_scales = rng.uniform(np.log(1e-4), np.log(1e2), (n, 1)) - rng.uniform(0, np.log(100), (n, 3))
    columns = (means, rng.normal(size=(n, 4)), log_scales, rng.normal(0, 3, n), np.zeros((n, 1, 3)))
    return Gaussians(*(column.astype(np.float32) for column in columns))
