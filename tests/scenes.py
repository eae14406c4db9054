"""Small scenes made of random numbers, for tests. The same arguments give the same scene on every machine."""

from dataclasses import replace
from typing import Literal

import numpy as np

import splatree as st
from splatree.maths.forests import subtree_radii

Numbers = tuple[Literal["normal", "uniform"], float, float]
"""A distribution: normal with its mean and standard deviation, or uniform with its ends."""


def cloud(
    n: int,
    seed: int = 0,
    *,
    degree: int = 0,
    spread: float = 1.0,
    log_scales: Numbers = ("normal", -3.0, 0.5),
    logits: Numbers = ("normal", 0.0, 1.0),
    sh: float = 1.0,
) -> st.Gaussians:
    """A round cloud around the origin, with quaternions that are not normalised.

    Args:
        n: number of Gaussians.
        seed: of the random numbers.
        degree: of the harmonics.
        spread: standard deviation of the means, world units.
        log_scales: distribution of the logarithms of the scales.
        logits: distribution of the logits of the opacities.
        sh: standard deviation of the harmonics' coefficients.
    """
    rng = np.random.default_rng(seed)

    def drawn(numbers: Numbers, *shape: int) -> np.ndarray:
        kind, first, second = numbers
        return rng.normal(first, second, shape) if kind == "normal" else rng.uniform(first, second, shape)

    columns = (
        rng.normal(0, spread, (n, 3)),
        rng.normal(size=(n, 4)),
        drawn(log_scales, n, 3),
        drawn(logits, n),
        rng.normal(0, sh, (n, (degree + 1) ** 2, 3)),
    )
    return st.Gaussians(*(column.astype(np.float32) for column in columns))


def gaussians(
    n: int, seed: int, *, log_scales: tuple[float, float] = (-5, -1.5), spread: float = 1.0, degree: int = 1
) -> st.Gaussians:
    """A cloud for kernels: quaternions of lengths from 10⁻³ to 10³, scales from ``log_scales[0]`` to ``log_scales[1]``."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4)) * 10.0 ** rng.uniform(-3, 3, (n, 1))
    return st.Gaussians(
        (spread * rng.normal(size=(n, 3))).astype(np.float32),
        quats.astype(np.float32),
        rng.uniform(*log_scales, (n, 3)).astype(np.float32),
        rng.normal(0, 3, n).astype(np.float32),
        (0.3 * rng.normal(size=(n, (degree + 1) ** 2, 3))).astype(np.float32),
    )


def random_gaussians(n: int, degree: int = 3, seed: int = 0) -> st.Gaussians:
    """A cloud for files: columns as a trained scene has them, with scales from about e⁻⁶ to e⁻¹ in a scene of 10 units."""
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    sh = 0.3 * normal(n, (degree + 1) ** 2, 3)
    return st.Gaussians(10 * normal(n, 3), normal(n, 4), normal(n, 3) - 4, 3 * normal(n), sh)


def surface(n: int, seed: int = 0, degree: int = 0) -> st.Gaussians:
    """Flat Gaussians on a wavy square, in patches of colour: the scene from which levels are built."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-5, 5, size=(n, 2))
    means = np.column_stack([xy, np.sin(xy[:, 0])])
    sh = rng.normal(0, 0.2, size=(n, (degree + 1) ** 2, 3))
    sh[:, 0] += np.where(xy[:, :1] > 0, 1.0, -1.0)
    return st.Gaussians(
        means.astype(np.float32),
        rng.normal(size=(n, 4)).astype(np.float32),
        rng.normal([-2, -2, -5], 0.3, size=(n, 3)).astype(np.float32),
        rng.normal(1, 2, size=n).astype(np.float32),
        sh.astype(np.float32),
    )


def camera(width: int = 52, height: int = 37, *, distance: float = 4.0, **changes: float) -> st.Camera:
    """A camera in front of a cloud; ``shift_x``, ``shift_y`` (px) and ``near`` (world units) change it."""
    view = st.Camera.look_at((0.3, -0.4, -distance), (0, 0, 0), width=width, height=height)
    K = view.K.copy()
    K[0, 2] += changes.get("shift_x", 0.0)
    K[1, 2] += changes.get("shift_y", 0.0)
    return st.Camera(view.camera_from_world, K, width, height, near=changes.get("near", view.near))


def with_balls(scene: st.Scene) -> st.Scene:
    """A tree as files of before have it by a radius: drawn by the nodes' size on the screen, with balls as extents."""
    g, record = scene.gaussians, scene.tree.record
    assert record is not None
    balls = subtree_radii(g.means, g.reach(), scene.tree.depth)
    tree = replace(scene.tree, extents=balls, record=replace(record, profile="exact"))
    return replace(scene, tree=tree, blocks=None)
