"""Scenes that are hard to cut: clusters, lines, duplicates, far outliers, equal importance."""

import numpy as np
from hypothesis import strategies as hs

import splatree as st

SHAPES = ("surface", "clusters", "line", "duplicates", "outliers", "one place")


def hard_scene(n: int, shape: str, seed: int, *, degree: int = 0, equal: bool = False) -> st.Gaussians:
    """``n`` Gaussians along a shape; ``equal``: all of the same size and opacity, so that rows decide."""
    rng = np.random.default_rng(seed)
    means = rng.random((n, 3)) * [10, 10, 0.5]
    if shape == "clusters":
        means = rng.random((5, 3))[rng.integers(0, 5, n)] * 10 + rng.normal(size=(n, 3)) * 0.1
    elif shape == "line":
        means = np.stack([rng.random(n) * 10, np.full(n, 2.0), np.zeros(n)], axis=1)
    elif shape == "duplicates":
        means = means[rng.integers(0, max(1, n // 3), n)] if n else means
    elif shape == "outliers" and n:
        means[rng.integers(0, n, 1 + n // 50)] *= 1e6
    elif shape == "one place":
        means[:] = 3.25
    log_scales = np.full((n, 3), -3.0) if equal else rng.normal(-3, 0.5, (n, 3))
    return st.Gaussians(
        means.astype(np.float32),
        rng.normal(size=(n, 4)).astype(np.float32),
        log_scales.astype(np.float32),
        (np.ones(n) if equal else rng.normal(size=n)).astype(np.float32),
        rng.normal(0, 0.5, (n, (degree + 1) ** 2, 3)).astype(np.float32),
    )


@hs.composite
def hard_scenes(draw, *, most: int = 400, degree: int = 0):
    """A scene of up to ``most`` Gaussians."""
    return hard_scene(
        draw(hs.integers(1, most)),
        draw(hs.sampled_from(SHAPES)),
        draw(hs.integers(0, 2**32 - 1)),
        degree=degree,
        equal=draw(hs.booleans()),
    )
