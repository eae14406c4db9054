"""A quality along the way of a camera: τ_R is measured where the view has changed much, and kept in between.

A measurement draws all leaves and a cut or two (lod/quality.py), so a camera that moves does without it while its picture lies
within one that is larger by `GUARD` on each side and the eye has moved by at most `STEP` of the distance. What the picture shows
has then changed by about a tenth. The next measurement begins at the τ_R that was kept.
"""

from dataclasses import dataclass, replace
from typing import Final

from splatree.render.moving import guarded_by, may_keep, near_distance
from splatree.render.session import Session
from splatree.scene.cameras import Camera
from splatree.scene.options import SelectOptions

__all__ = ["Carried"]

GUARD: Final = 0.1
"""Share of the picture by which it may turn to any side until a quality is measured again."""

STEP: Final = 0.1
"""Share of the distance by which the eye may move until then."""


@dataclass(frozen=True, eq=False)
class _Measured:
    camera: Camera
    """The larger picture within which the τ_R holds."""
    select: SelectOptions
    """What was asked for, without its budget."""
    pixel_error: float
    """What was found, px."""
    distance: float
    """That nearly all nodes exceed, world units."""


class Carried:
    """The τ_R of a quality for one camera that moves."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._last: _Measured | None = None

    def settled(self, camera: Camera, select: SelectOptions) -> SelectOptions:
        """The options with a τ_R in place of a quality, if there is one: measured now, or kept from an earlier view."""
        if select.quality is None:
            return select
        asked, last = replace(select, budget=None), self._last
        if last is None or last.select != asked or not may_keep(last.camera, camera, distance=last.distance, step=STEP):
            before = None if last is None else last.pixel_error
            chosen = self._session.select(camera, select=asked, last=before)
            distance = near_distance(self._session.scene, chosen.rows, camera.position)
            last = self._last = _Measured(guarded_by(camera, GUARD), asked, chosen.pixel_error, distance)
        return replace(select, quality=None, pixel_error=last.pixel_error)
