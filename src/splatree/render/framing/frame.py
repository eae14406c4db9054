"""The first picture of a scene that comes without cameras: what is up, what to look at, and from where.

1. The vertical: `upright.guess_up`.
2. The focus: the median of the leaves' centres, weighted by opacity, and the radius that holds 90 % of the opacity, but at most
   2.5 times that which holds half. Far backgrounds and floaters lie outside of it.
3. Inside or outside: a scene is looked at from inside if a spherical picture from its middle shows walls all round and a
   ceiling or a sky above, all farther away than the middle of a solid thing would see its own skin. Harmonics, where there are
   any, tell from which side surfaces were photographed (`Survey.gaze`), which decides doubtful cases.
4. The eye: outside, on a circle around the focus, where small trial pictures show most of the focus and least of anything
   before it; inside, near one end of the longest free line, looking along it.

Cost: trial pictures of a sample of 60,000 leaves, thinner surfaces made wider: one to two seconds of processor time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.constants import NEAR
from splatree.errors import InputError
from splatree.render.framing.panorama import horizontals
from splatree.render.framing.standpoint import Standpoint, from_inside, from_outside, looks_enclosed
from splatree.render.framing.survey import Survey, survey_of, weighted_quantiles
from splatree.render.framing.upright import direction_in_words, guess_up
from splatree.scene.arguments import checked
from splatree.scene.cameras import SIDE_MAX_PX, Camera
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64, check_fields

__all__ = ["Framing", "frame_scene"]

FOCUS_SHARE: Final = 0.9
"""Share of the opacity within the radius …"""

CORE_SHARE: Final = 0.5
"""… which is at most CORE_FACTOR times the radius that holds this share: 1.3 times for a plain, 1.2 for a ball, 10 for a
garden with its horizon."""

CORE_FACTOR: Final = 2.5

NEAR_SHARE: Final = 0.01
"""The near plane is at most this share of the distance to the target: a scene in kilometres must not vanish in front of it."""


@dataclass(frozen=True, eq=False)
class Framing:
    """How to look at a scene at first: which way is up, where to stand, and at what to look.

    Example:
        >>> framing = st.frame_scene(scene)
        >>> framing.camera(64, 36).width, framing.inside
        (64, False)
    """

    up: Float64[Array, "3"]
    """Unit vector that points up."""
    centre: Float64[Array, "3"]
    """Middle of the dense part, world units."""
    radius: float
    """Radius of the dense part, world units."""
    inside: bool
    """Whether to look around from within (a room, a street, a garden under a sky) or at the scene from outside."""
    eye: Float64[Array, "3"]
    """Place from which the first picture is taken, world units."""
    target: Float64[Array, "3"]
    """Point that the first picture looks at, world units."""
    fov_y_deg: float
    """Vertical field of view, degrees."""
    reasons: tuple[str, ...]
    """Reasons for these choices, a sentence each."""
    is_sure: bool
    """Whether the hints for the vertical agree. If they do not, ask the user for --up."""

    def __post_init__(self) -> None:
        check_fields(self)

    def camera(self, width: int = 960, height: int = 540, *, fov_y_deg: float | None = None) -> Camera:
        """The first view, in a size in px; ``fov_y_deg`` in the place of the one chosen here."""
        camera = Camera.look_at(
            self.eye, self.target, up=self.up, width=width, height=height, fov_y_deg=fov_y_deg or self.fov_y_deg
        )
        distance = float(np.linalg.norm(self.target - self.eye))
        return replace(camera, near=min(NEAR, NEAR_SHARE * distance), name="first")

    def moved(
        self,
        *,
        eye: Sequence[float] | None = None,
        target: Sequence[float] | None = None,
        distance: float | None = None,
    ) -> "Framing":
        """The framing from another place, of another point, or at another distance between both; what is None stays.

        With a new eye alone the target stays, and the other way round. ``distance`` moves the eye along the line to the target.
        """
        to = self.target if target is None else np.asarray(target, np.float64)
        place = self.eye if eye is None else np.asarray(eye, np.float64)
        for name, point in (("eye", place), ("target", to)):
            if point.shape != (3,) or not np.isfinite(point).all():
                raise InputError(f"{name}: found {point.tolist()}, wanted x y z")
        if not np.linalg.norm(place - to) > 0:
            raise InputError(f"eye: found {place.tolist()}, which is the target; wanted another point")
        if distance is not None:
            if not 0 < distance < np.inf:
                raise InputError(f"distance: found {distance}, wanted more than 0")
            if eye is not None:
                raise InputError("distance: found it beside an eye, which already says how far; wanted one of them")
            place = to + distance * (place - to) / np.linalg.norm(place - to)
        return replace(self, eye=place, target=to)

    def raised(self, elevation_deg: float) -> "Framing":
        """The framing with its eye at another height above the horizon, as seen from the target, degrees."""
        back = self.eye - self.target
        flat = back - (back @ self.up) * self.up
        if not np.linalg.norm(flat) > 1e-9 * np.linalg.norm(back):
            flat = horizontals(self.up)[0]
        flat = flat / np.linalg.norm(flat)
        angle = np.radians(elevation_deg)
        direction = np.cos(angle) * flat + np.sin(angle) * self.up
        return replace(self, eye=self.target + np.linalg.norm(back) * direction)


@checked
def frame_scene(
    scene: Scene, *, up: Sequence[float] | None = None, inside: bool | None = None, aspect: float = 16 / 9
) -> Framing:
    """Decide how to look at a scene at first, from the scene alone.

    Args:
        scene: any scene; only its leaves count.
        up: direction that is up, of any length; None: it is guessed.
        inside: look from within (True) or from outside (False); None: decided by the scene.
        aspect: width over height of the picture to come, for the distance from outside.

    Returns:
        The framing, with the reasons for it.

    Raises:
        InputError: the scene is empty, or ``up`` is no direction.

    Example:
        >>> framing = st.frame_scene(scene, up=(0, -1, 0))
        >>> framing.up.tolist()
        [0.0, -1.0, 0.0]
    """
    if not 1 / SIDE_MAX_PX <= aspect <= SIDE_MAX_PX:
        raise InputError(f"aspect: found {aspect}, wanted width over height of a picture")
    survey = survey_of(scene)
    reasons = []
    if up is None:
        guess = guess_up(survey, scene.source)
        vertical, is_sure = np.array(guess.up), guess.lead > 1
        reasons.append(
            f"up is {direction_in_words(vertical)}, by {guess.reason}{'' if is_sure else '; this is a guess, see --up'}"
        )
    else:
        vertical, is_sure = np.asarray(up, np.float64), True
        if vertical.shape != (3,) or not 0 < np.linalg.norm(vertical) < np.inf:
            raise InputError(f"up: found {tuple(up)}, wanted a direction x y z")
        vertical = vertical / np.linalg.norm(vertical)
    centre, radius = focus_of(survey)
    if inside is None:
        inside, why = looks_enclosed(survey, vertical, centre, radius)
        reasons.append(why)
    stand: Standpoint = (from_inside if inside else from_outside)(survey, vertical, centre, radius, aspect)
    return Framing(
        up=vertical,
        centre=centre,
        radius=radius,
        inside=inside,
        eye=stand.eye,
        target=stand.target,
        fov_y_deg=stand.fov_y_deg,
        reasons=tuple(reasons),
        is_sure=is_sure,
    )


def focus_of(survey: Survey) -> tuple[Float64[Array, "3"], float]:
    """Centre and radius, world units, of the dense part."""
    weights = survey.opacities
    centre = np.array([weighted_quantiles(survey.means[:, axis], weights, (0.5,))[0] for axis in range(3)])
    distances = np.linalg.norm(survey.means - centre, axis=1)
    core, most = weighted_quantiles(distances, weights, (CORE_SHARE, FOCUS_SHARE))
    radius = min(most, CORE_FACTOR * core) or most
    if radius == 0:  # one Gaussian, or all at one place: its own size
        radius = 3 * float(np.exp(survey.gaussians.log_scales.max()))
    return centre, radius
