"""Which way is up in a scene.

Files rarely say it, so several weak hints are added up, each in units of the logarithm of odds:

- what the file says: a comment "Vertical axis: z", or a format that fixes its axes (SPZ, glTF);
- custom: most trained scenes have y down, some z up or y up, and many are tilted against y;
- the ground: a large share of flat Gaussians faces along the vertical, and the scene is flat along it;
- gravity: things stand on the ground, so heights reach farther above the middle than below;
- the standing plane: modelled and cleaned things have their feet at 0, in tools with y upright exactly (`y_of_a_thing`);
- the gaze: photographers look ahead or down, seldom up (`Survey.gaze_along`).

Candidates are the six axes and the directions that most flat Gaussians face, each way. An axis that wins is turned to the
nearest such direction, if there is one within 12°.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from splatree.maths.axes import y_of_a_thing
from splatree.render.framing.survey import Survey, weighted_quantiles
from splatree.scene.scene import Source
from splatree.shapes import Array, Float64

__all__ = ["Upright", "direction_in_words", "guess_up"]

Y_DOWN: Final = (0.0, -1.0, 0.0)
"""Up in the axes of COLMAP and of most 3DGS training."""

CUSTOM: Final = {Y_DOWN: 3.0, (0.0, 0.0, 1.0): 1.5, (0.0, 1.0, 0.0): 1.25}
"""Logarithm of the odds of the axes that tools use."""

OTHER_AXIS: Final = 0.75
"""The same for the other three, and for directions that are no axis and not near −y."""

TILT_DEG: Final = 40.0
"""COLMAP leaves a scene tilted against y by what its first photographs were tilted: odds fall with the square of the tilt."""

FACING_DEG: Final = 15.0
"""A Gaussian faces along an axis if its normal is this near to it; by chance 3.4 % do."""

ADJUST_DEG: Final = 12.0
"""An axis is turned to a ground that is this near to it; farther is a slope, or another wall."""

STATED: Final = 20.0
"""What a statement of the file counts: more than all hints together."""

STANDS: Final = 3.0
"""What feet at y = 0 count: more than custom has y down rather than up. Along x and z, things end at 0 by chance too often."""

_SPHERE = 200
"""Directions that are tried for the ground, spread evenly over a half sphere: 10° apart."""


@dataclass(frozen=True)
class Upright:
    """A direction that is up, and why."""

    up: tuple[float, float, float]
    """Unit vector."""
    reason: str
    """The hint that counted most, in words."""
    lead: float
    """Logarithm of the odds against the next candidate that is not within 30°."""


def guess_up(survey: Survey, source: Source | None = None) -> Upright:
    """The direction that is up in a scene, by the hints at the head of this module."""
    grounds = _faced_directions(survey)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    candidates = np.concatenate([axes, *(np.stack([g, -g]) for g in grounds)])
    stated = _stated(source or Source())
    hints = {
        "what the file says": np.array([_statement(u, stated) for u in candidates]),
        "the usual axes of 3DGS": np.array([_custom(u) for u in candidates]),
        "the ground that flat Gaussians make": np.array([_ground(survey, u) for u in candidates]),
        "what stands on the ground": np.array([_gravity(survey, u) for u in candidates]),
        "the feet at y = 0": STANDS * (y_of_a_thing(survey.means) * candidates[:, 1] > 0.99),
        "the directions it was photographed in": _looking_down(survey, candidates),
    }
    odds = np.sum(list(hints.values()), axis=0)
    best = int(np.argmax(odds))
    up = candidates[best]
    others = candidates @ up < math.cos(math.radians(30))
    gains = {name: values[best] - values[others].mean() for name, values in hints.items()}
    near = [g * np.sign(g @ up) for g in grounds if abs(g @ up) > math.cos(math.radians(ADJUST_DEG))]
    if near and _facing(survey, near[0]) > 0.15:
        up = near[0]
    return Upright(
        up=(float(up[0]), float(up[1]), float(up[2])),
        reason=max(gains, key=gains.__getitem__),
        lead=float(odds[best] - odds[others].max()),
    )


def direction_in_words(up: Float64[Array, "3"]) -> str:
    """+z, or the vector where it is no axis."""
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) > 0.999:
        return f"{'+' if up[axis] > 0 else '-'}{'xyz'[axis]}"
    return "({:.2f}, {:.2f}, {:.2f})".format(*up)


def _stated(source: Source) -> Mapping[tuple[float, ...], float]:
    """What the file says of its axes: odds of directions."""
    is_fixed = source.format == "gltf" or (source.format == "spz" and "assumed" not in source.metadata.get("axes", ""))
    if is_fixed:  # and reading turns them into those of a .ply
        return {Y_DOWN: 2.0}
    for line in json.loads(source.metadata.get("comments", "[]")):
        match = re.fullmatch(r"\s*(?:vertical|up)[ _-]?axis\s*[:=]?\s*([+-]?)([xyz])\s*", str(line), re.IGNORECASE)
        if match:
            axis = np.eye(3)["xyz".index(match[2].lower())]
            # Without a sign both ends are meant: Brush writes "y" for its y-down scenes.
            ends = [axis, -axis] if not match[1] else [axis if match[1] == "+" else -axis]
            return {tuple(map(float, end)): STATED for end in ends}
    return {}


def _statement(up: Array, stated: Mapping[tuple[float, ...], float]) -> float:
    return max((odds for axis, odds in stated.items() if up @ axis > math.cos(math.radians(ADJUST_DEG))), default=0.0)


def _custom(up: Array) -> float:
    tilt = math.degrees(math.acos(np.clip(up @ Y_DOWN, -1, 1)))
    odds = CUSTOM[Y_DOWN] * math.exp(-((tilt / TILT_DEG) ** 2))
    near = [value for axis, value in CUSTOM.items() if up @ axis > math.cos(math.radians(ADJUST_DEG))]
    return max([odds, OTHER_AXIS, *near])


def _facing(survey: Survey, up: Array) -> float:
    """Share of the flat surface that faces along an axis."""
    weights = survey.weights * survey.flatness
    return float(
        weights[np.abs(survey.normals @ up) > math.cos(math.radians(FACING_DEG))].sum()
        / max(float(weights.sum()), 1e-300)
    )


def _ground(survey: Survey, up: Array) -> float:
    """The share that faces along it, the share of a floor, and how flat the scene is against its next flattest side."""
    side_a = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side_a /= np.linalg.norm(side_a)
    spans = []
    for direction in (up, side_a, np.cross(up, side_a)):
        low, high = weighted_quantiles(survey.means @ direction, survey.opacities, (0.05, 0.95))
        spans.append(max(high - low, 1e-12))
    flat = float(np.clip(0.7 * math.log(min(spans[1:]) / spans[0]), 0, 1.5))
    return 4 * _facing(survey, up) + 4 * _floor(survey, up) + flat


def _floor(survey: Survey, up: Array) -> float:
    """Largest share of the flat surface that lies in one sheet across ``up``, with a tenth of the opacity below it at most."""
    heights = survey.means @ up
    low, tenth, high = weighted_quantiles(heights, survey.opacities, (0.01, 0.1, 0.9))
    weights = survey.weights * survey.flatness
    faces = np.abs(survey.normals @ up) > math.cos(math.radians(FACING_DEG))
    step = max(high - low, 1e-9) / 60
    edges = low + step * np.arange(-1, math.ceil((tenth - low) / step) + 3)
    sheets = np.histogram(heights[faces], bins=edges, weights=weights[faces])[0]
    return float((sheets[:-1] + sheets[1:]).max(initial=0) / max(float(weights.sum()), 1e-300))


def _gravity(survey: Survey, up: Array) -> float:
    """How much farther heights reach above the middle than below it, and whether the lowest of them is 0."""
    heights = survey.means @ up
    lowest, low, middle, high, highest = weighted_quantiles(heights, survey.opacities, (0.01, 0.1, 0.5, 0.9, 0.99))
    skew = (high + low - 2 * middle) / max(high - low, 1e-12)
    stands_on_0 = abs(lowest) < 0.06 * (highest - lowest)
    return 3 * skew + (0.5 if stands_on_0 else 0.0)


def _looking_down(survey: Survey, candidates: Array) -> Array:
    """Minus the share of looks that go up."""
    looks = _half_sphere(64)
    looks = np.concatenate([looks, -looks])
    shimmer = survey.gaze_along(looks)
    least = float(shimmer.min())
    if least <= 0:
        return np.zeros(len(candidates))
    contrast = np.minimum(shimmer / least - 1, 2.0)
    # Where all directions are alike nothing is known; a scene photographed from one side has a largest contrast of about 1.5.
    strength = min(1.0, float(contrast.max()))
    share = contrast / max(float(contrast.sum()), 1e-12)
    return np.asarray(-12 * strength * (share @ np.maximum(looks @ candidates.T, 0)))


def _faced_directions(survey: Survey) -> list[Float64[Array, "3"]]:
    """Up to three directions along which most of the flat surface faces, at least 30° apart: houses have three."""
    found: list[Array] = []
    tried = _half_sphere(_SPHERE)
    weights = survey.weights * survey.flatness
    along = np.abs(survey.normals @ tried.T) > math.cos(math.radians(FACING_DEG))  # [n d]
    shares = weights @ along
    for i in np.argsort(-shares):
        if all(abs(tried[i] @ other) < math.cos(math.radians(30)) for other in found):
            found.append(_refined(survey, weights, tried[i]))
        if len(found) == 3:
            break
    return found


def _refined(survey: Survey, weights: Array, direction: Array) -> Array:
    """The principal direction of the normals around a direction, with a narrower view each time."""
    for angle_deg in (20, 12, 8, 8):
        near = np.abs(survey.normals @ direction) > math.cos(math.radians(angle_deg))
        if not near.any():
            break
        n = survey.normals[near]
        direction = np.linalg.eigh((n * weights[near, None]).T @ n)[1][:, -1]
    return np.asarray(direction)


def _half_sphere(count: int) -> Float64[Array, "d 3"]:
    """Directions spread evenly over the half sphere z > 0 (Fibonacci's spiral)."""
    i = np.arange(count)
    z, turn = (i + 0.5) / count, i * math.pi * (3 - math.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
