"""What is seen all round from a place in a scene: a spherical picture, six faces of a cube."""

from dataclasses import replace
from typing import Final

import numpy as np

from splatree.render.framing.survey import Survey, weighted_quantiles
from splatree.render.framing.trial import draw, rays, trial_camera, trial_session
from splatree.render.session import Session
from splatree.shapes import Array, Float64

__all__ = ["Panorama", "horizontals", "widest_view"]

FACE_PX: Final = 32
"""Edge of a face, px."""

LIFTS: Final = (0.35, 0.5, 0.65)
"""Heights that are tried, between the 5 % and the 95 % quantile of the heights."""

SIDESTEPS: Final = ((0.0, 0.0), (0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3))
"""Steps to the north and the east that are tried, in radii."""

TRIED: Final = 4
"""Of these places so many are looked around from: those with the most room around them."""


class Panorama:
    """What is seen all round from a place."""

    def __init__(self, sample: Session, eye: Array, up: Array, radius: float) -> None:
        self.eye, self.up = eye, up
        north, east = horizontals(up)
        directions, alphas, depths, angles = [], [], [], []
        for forward, head in ((north, up), (east, up), (-north, up), (-east, up), (up, north), (-up, north)):
            camera = replace(trial_camera(eye, eye + forward, head, (FACE_PX, FACE_PX), 90), near=0.02 * radius)
            result = draw(sample, camera)
            looks = rays(camera)
            lengths = np.linalg.norm(looks, axis=-1, keepdims=True)
            directions.append((looks / lengths).reshape(-1, 3) @ camera.camera_from_world[:3, :3])
            alphas.append(result.alpha.ravel())
            depths.append(result.depth.ravel() * lengths.ravel())
            angles.append(lengths.ravel() ** -3)  # solid angle of a pixel
        self.directions, self.alphas = np.concatenate(directions), np.concatenate(alphas).astype(np.float64)
        self.angles = np.concatenate(angles)
        free = np.where(self.alphas > 0.5, np.concatenate(depths), np.inf)
        self.distances = np.minimum(free, 100 * radius)

    def free_share(self, share: float) -> float:
        """The length for which this share of the directions is free at most."""
        return weighted_quantiles(self.distances, self.angles, (share,))[0]

    def cover(self, low_deg: float, high_deg: float) -> float:
        """Share of the directions between two elevations that show something."""
        elevation = np.degrees(np.arcsin(np.clip(self.directions @ self.up, -1, 1)))
        band = (elevation >= low_deg) & (elevation <= high_deg)
        return float(np.average(self.alphas[band], weights=self.angles[band]))

    def free(self, direction: Array) -> float:
        """How far it is free along a direction: the 20 % quantile within 10°."""
        near = self.directions @ direction > np.cos(np.radians(10))
        return weighted_quantiles(self.distances[near], self.angles[near], (0.2,))[0]

    def longest_line(self) -> tuple[float, Float64[Array, "3"]]:
        """Free length and direction of the horizontal look that sees farthest, both ways counted."""
        north, east = horizontals(self.up)
        looks = [np.cos(t) * north + np.sin(t) * east for t in np.arange(32) / 32 * 2 * np.pi]
        free = [self.free(look) for look in looks]
        best = max(range(32), key=lambda i: (round(min(free[i], 1e6) + 0.9 * free[(i + 16) % 32], 6), -i))
        return free[best], looks[best]


def widest_view(survey: Survey, up: Array, centre: Array, radius: float) -> "Panorama":
    """What is seen from the place in the middle that is least closed in."""
    sample = trial_session(survey)
    views = [Panorama(sample, place, up, radius) for place in _middles(survey, up, centre, radius)]
    return max(views, key=lambda view: view.free_share(0.5))


def _middles(survey: Survey, up: Array, centre: Array, radius: float) -> list[Array]:
    """Places where a person could stand: the middle, and places around it and above it that are free."""
    north, east = horizontals(up)
    heights = (survey.means - centre) @ up
    within = np.linalg.norm(survey.means - centre, axis=1) < radius
    floor, top = weighted_quantiles(heights[within], survey.opacities[within], (0.05, 0.95))
    places = []
    for height in LIFTS:
        for across in SIDESTEPS:
            lift = floor + height * (top - floor)
            places.append(centre + lift * up + radius * (across[0] * north + across[1] * east))
    clear = [
        float(np.sort(np.linalg.norm(survey.means - p, axis=1))[: len(survey.means) // 500 + 1][-1]) for p in places
    ]
    return [places[i] for i in np.argsort(-np.array(clear), kind="stable")[:TRIED]]


def horizontals(up: Array) -> tuple[Float64[Array, "3"], Float64[Array, "3"]]:
    """Two unit vectors across ``up`` and across each other."""
    east = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    east /= np.linalg.norm(east)
    return np.cross(east, up), east
