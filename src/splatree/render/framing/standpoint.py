"""Where to stand for the first picture of a scene, from inside or from outside (`framing.frame`)."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from splatree.render.framing.panorama import horizontals, widest_view
from splatree.render.framing.survey import Survey
from splatree.render.framing.trial import FOCUS_RADII, draw, judge, trial_camera, trial_session
from splatree.shapes import Array, Float64

__all__ = ["Standpoint", "from_inside", "from_outside", "looks_enclosed"]

WALL_COVER, ROOF_COVER = 0.8, 0.6
"""Share of the directions within 30° of the horizon, and above, that must show something for a scene to be closed."""

HOLLOW, FAR_SIGHT = 0.3, 0.9
"""From inside, the median direction is free for at least the first share of the radius, or one in ten for the second, as along a
street or up to a sky: the inside of a solid thing has neither."""

GAZE_SURE: Final = 0.15
"""Log ratio of view-dependent colour (`Survey.gaze`) that says from which side a scene was photographed: a drone's capture has
0.07 from its own middle and 0.7 from above."""

OUTSIDE_FOV_DEG, INSIDE_FOV_DEG = 50.0, 65.0
"""Vertical fields of view, degrees: from within more must fit."""

ELEVATIONS_DEG: Final = (20.0, 35.0, 50.0)
"""Heights of the eye above the focus that are tried from outside, degrees."""

AZIMUTHS: Final = 8
"""Directions that are tried from outside."""

INCLUDED, MARGIN = 0.998, 0.08
"""Share of that which is in the picture, and share of the picture that is left free at each edge."""

NEARER: Final = (1.0, 0.65, 0.4)
"""Shares of the fitting distance that are tried, the next while something stands before the focus."""

MOST_ASPECT: Final = 16
"""Trial pictures are at most so many times as wide as high, or as high as wide: a strip of 1:1000 says nothing more."""

BLOCKED: Final = 0.1
"""Share of a picture that something before the focus may take."""


@dataclass(frozen=True, eq=False)
class Standpoint:
    """A place to look from."""

    eye: Float64[Array, "3"]
    """Where the camera is, world units."""
    target: Float64[Array, "3"]
    """What it looks at."""
    fov_y_deg: float
    """Vertical field of view, degrees."""


def looks_enclosed(survey: Survey, up: Array, centre: Array, radius: float) -> tuple[bool, str]:
    """Whether a scene is to be looked at from within, and why."""
    view = widest_view(survey, up, centre, radius)
    walls, roof = view.cover(-30, 30), view.cover(30, 90)
    seen = f"from its middle {100 * walls:.0f} % of the horizon and {100 * roof:.0f} % of what is above are closed"
    if view.free_share(0.5) < HOLLOW * radius and view.free_share(0.9) < FAR_SIGHT * radius:
        return False, "looked at from outside: its middle is filled"
    north, east = horizontals(up)
    around = [centre + 2 * radius * (np.cos(t) * north + np.sin(t) * east + up) for t in np.arange(8) * np.pi / 4]
    within, without = survey.gaze(view.eye), max(survey.gaze(eye) for eye in around)
    if max(without, -within) > GAZE_SURE and without > within:
        return False, "looked at from outside: its harmonics say that it was photographed from there"
    if walls >= WALL_COVER and roof >= ROOF_COVER:
        return True, f"looked at from inside: {seen}"
    if within > max(GAZE_SURE, without + GAZE_SURE) and walls >= WALL_COVER / 2:
        return True, f"looked at from inside: its harmonics say that it was photographed from there, and {seen}"
    return False, f"looked at from outside: {seen}"


def from_outside(survey: Survey, up: Array, centre: Array, radius: float, aspect: float) -> Standpoint:
    """The view around the focus that shows most of it; from nearer where something stands before it all round."""
    sample = trial_session(survey)
    focus = survey.means[np.linalg.norm(survey.means - centre, axis=1) < FOCUS_RADII * radius]
    north, east = horizontals(up)
    best, best_score = None, -np.inf
    width = round(64 * min(max(aspect, 1 / MOST_ASPECT), MOST_ASPECT))
    for nearer in NEARER:
        for elevation in np.radians(ELEVATIONS_DEG):
            for turn in np.arange(AZIMUTHS) / AZIMUTHS * 2 * np.pi:
                flat = np.cos(turn) * north + np.sin(turn) * east
                backward = np.cos(elevation) * flat + np.sin(elevation) * up
                target, distance = _fitted(focus, centre, backward, up, aspect)
                eye = target + nearer * distance * backward
                camera = trial_camera(eye, target, up, (width, 64), OUTSIDE_FOV_DEG)
                trial = judge(draw(sample, camera), camera, focus, centre, radius)
                score = trial.score + 0.3 * survey.gaze(eye)
                if score > best_score + 1e-6:
                    best, best_score, blocked = (eye, target), score, trial.blocked
        if blocked < BLOCKED:
            break
    assert best is not None
    return Standpoint(*best, OUTSIDE_FOV_DEG)


def from_inside(survey: Survey, up: Array, centre: Array, radius: float, aspect: float) -> Standpoint:
    """Near one end of the longest free line through the middle, looking along it."""
    room = widest_view(survey, up, centre, radius)
    far, forward = room.longest_line()
    back = min(room.free(-forward), radius)
    eye = room.eye - 0.6 * back * forward
    target = room.eye + min(0.5 * far, radius) * forward - 0.08 * min(far, radius) * up
    return Standpoint(eye, target, INSIDE_FOV_DEG)


def _fitted(points: Array, centre: Array, backward: Array, up: Array, aspect: float) -> tuple[Array, float]:
    """Target and distance at which a camera that looks along −backward has the points in its picture, with a margin."""
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(backward, right), backward])
    x, y, z = axes @ (points - centre).T
    tan_y = np.tan(np.radians(OUTSIDE_FOV_DEG) / 2) * (1 - MARGIN)
    tans = (tan_y * aspect, tan_y)
    middle = [0.0, 0.0]
    for _ in range(3):  # the nearer side of a scene is larger in the picture, so the middle follows from the distance
        needed = [
            float(np.quantile(np.abs(v - m) / tan + z, INCLUDED))
            for v, m, tan in zip((x, y), middle, tans, strict=True)
        ]
        distance = max(max(needed), 1e-6)
        depth = np.maximum(distance - z, 1e-3 * distance)
        for i, v in enumerate((x, y)):
            low, high = np.quantile((v - middle[i]) / depth, (1 - INCLUDED, INCLUDED))
            middle[i] += 0.5 * (low + high) * distance
    return centre + middle[0] * axes[0] + middle[1] * axes[1], distance
