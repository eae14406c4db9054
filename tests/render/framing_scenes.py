"""Small scenes of the kinds that people photograph: a room, a street under a sky, an object, a city from above.

Surfaces are squares of flat Gaussians. Up is −y, as in most trained scenes, and one unit is a metre.
"""

import numpy as np

from splatree.constants import SH_C0
from splatree.maths.rotations import quat_from_matrix
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Scene


def patch(corner, along, across, color, *, step=0.1, opacity_logit=4.0):
    """A rectangle from a corner along two edges, covered with discs ``step`` apart in a chequered colour."""
    corner, along, across = (np.asarray(v, float) for v in (corner, along, across))
    nu, nv = (max(2, round(float(np.linalg.norm(v)) / step)) for v in (along, across))
    u, v = (a.ravel() for a in np.meshgrid((np.arange(nu) + 0.5) / nu, (np.arange(nv) + 0.5) / nv))
    means = corner + u[:, None] * along + v[:, None] * across
    axes = np.stack([along / np.linalg.norm(along), across / np.linalg.norm(across)])
    rotation = np.stack([*axes, np.cross(*axes)], axis=1)
    n = len(means)
    chequer = 0.15 * (((u * nu // 8) + (v * nv // 8)) % 2 - 0.5)
    colors = np.clip(np.asarray(color) + chequer[:, None], 0, 1)
    return Gaussians(
        means.astype(np.float32),
        np.tile(np.asarray(quat_from_matrix(rotation), np.float32), (n, 1)),
        np.tile(np.log(np.float32([0.6 * step, 0.6 * step, 0.02 * step])), (n, 1)),
        np.full(n, opacity_logit, np.float32),
        ((colors - 0.5) / SH_C0).astype(np.float32)[:, None],
    )


def box(low, high, color, *, faces="nsewtb", step=0.1):
    """Sides of a box: north and south across z, east and west across x, top (−y) and bottom (+y)."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    x, y, z = np.diag([x1 - x0, y1 - y0, z1 - z0])
    sides = {
        "n": ((x0, y0, z0), x, y),
        "s": ((x0, y0, z1), x, y),
        "w": ((x0, y0, z0), z, y),
        "e": ((x1, y0, z0), z, y),
        "t": ((x0, y0, z0), x, z),
        "b": ((x0, y1, z0), x, z),
    }
    return [patch(*sides[face], color, step=step) for face in faces]


def scene(parts):
    return Scene.flat(Gaussians.concatenate(parts))


def room(*, seed=0):
    """A closed room of 6 × 2.6 × 4 m with a table and a cupboard, and fog behind the walls."""
    rng = np.random.default_rng(seed)
    parts = box((-3, -2.6, -2), (3, 0, 2), (0.7, 0.65, 0.6))
    parts += box((-0.8, -0.75, -0.5), (0.8, -0.7, 0.5), (0.5, 0.3, 0.1), step=0.04)
    parts += box((2.2, -2.0, -1.9), (2.9, 0, -0.5), (0.3, 0.3, 0.5), step=0.06)
    fog = patch((-3, -2, 0), (6, 0, 0), (0, 2, 0), (0.5, 0.5, 0.5), step=0.4, opacity_logit=0.0)
    behind = np.float32(rng.normal(size=fog.means.shape) * [6, 4, 6])
    outside = (np.abs(behind) > [3.2, 2.8, 2.2]).any(axis=1)
    parts.append(
        Gaussians(behind, fog.quats, fog.log_scales, fog.logit_opacities, fog.sh).take(np.flatnonzero(outside))
    )
    return scene(parts)


def sky(radius, *, count=6000):
    """A dome of large discs above the horizon."""
    i = np.arange(count)
    y, turn = -(i + 0.5) / count, i * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - y * y)
    means = radius * np.stack([r * np.cos(turn), y, r * np.sin(turn)], axis=1)
    spread = radius * np.sqrt(2 * np.pi / count)
    colors = np.clip(np.array([0.5, 0.7, 1.0]) + 0.2 * y[:, None], 0, 1)
    return Gaussians(
        means.astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        np.full((count, 3), np.log(0.6 * spread), np.float32),
        np.full(count, 4.0, np.float32),
        ((colors - 0.5) / SH_C0).astype(np.float32)[:, None],
    )


def street():
    """Houses along both sides of a road of 40 m, under a sky."""
    parts = [patch((-20, 0, -4), (40, 0, 0), (0, 0, 8), (0.35, 0.35, 0.35), step=0.25)]
    for side in (-1, 1):
        for i in range(5):
            x, depth = -20 + 8 * i, 5 * side
            color = (0.5 + 0.08 * i, 0.45, 0.6 - 0.08 * i)
            parts += box((x, -5 - i % 2, min(4 * side, 4 * side + depth)), (x + 7, 0, max(4 * side, 4 * side + depth)),
                         color, faces="nsew", step=0.25)  # fmt: skip
    return scene([*parts, sky(80)])


def figure():
    """A tall thing of boxes on nothing, like a person."""
    parts = box((-0.3, -1.8, -0.2), (0.3, -0.8, 0.2), (0.2, 0.3, 0.7), step=0.03)
    parts += box((-0.15, -2.15, -0.15), (0.15, -1.85, 0.15), (0.8, 0.6, 0.5), step=0.02)
    parts += box((-0.28, -0.8, -0.1), (-0.05, 0, 0.1), (0.2, 0.2, 0.2), step=0.02)
    parts += box((0.05, -0.8, -0.1), (0.28, 0, 0.1), (0.2, 0.2, 0.2), step=0.02)
    return scene(parts)


def city(*, seed=0, step=1.5):
    """Blocks on a plain of 200 m, as a drone sees them, without sky."""
    rng = np.random.default_rng(seed)
    parts = [patch((-100, 0, -100), (200, 0, 0), (0, 0, 200), (0.4, 0.5, 0.35), step=step)]
    for x in range(-90, 90, 30):
        for z in range(-90, 90, 30):
            height = rng.uniform(5, 25)
            parts += box((x, -height, z), (x + 18, 0, z + 18), rng.uniform(0.2, 0.8, 3), faces="nsewt", step=step)
    return scene(parts)


def garden():
    """A table on a lawn, ringed by trees, under a sky: photographed on a circle around the table."""
    parts = [patch((-12, 0, -12), (24, 0, 0), (0, 0, 24), (0.3, 0.5, 0.2), step=0.25)]
    parts += box((-0.8, -0.8, -0.8), (0.8, -0.7, 0.8), (0.6, 0.45, 0.3), step=0.02)
    parts += box((-0.15, -1.1, -0.15), (0.15, -0.8, 0.15), (0.8, 0.2, 0.2), step=0.01)
    for turn in np.arange(16) / 16 * 2 * np.pi:
        x, z = 14 * np.cos(turn), 14 * np.sin(turn)
        parts += box((x - 2.5, -6, z - 2.5), (x + 2.5, 0, z + 2.5), (0.15, 0.35, 0.12), faces="nsewt", step=0.3)
    return scene([*parts, sky(60)])
