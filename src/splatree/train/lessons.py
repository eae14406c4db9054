"""Lessons for inner nodes: views, and what all leaves look like in them.

Views are made all round a scene: directions and heights (25 to 85°) evenly, distances evenly in their logarithm, from 0.2 to
12 radii, near ones aimed all over the scene. Each is a crop of 320 × 240 px of a picture of 640 × 480 px, so near views show
what a screen shows. Pictures of the teacher are kept as bytes: 230 kB a view.

Cost: all leaves are drawn once a view; 16 times the pixels with the teacher `large`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatree.kernels.devices import DeviceName
from splatree.progress import track
from splatree.render.framing.survey import survey_of
from splatree.render.framing.upright import guess_up
from splatree.render.paths import bounds_of, directions_above
from splatree.render.session import open_session
from splatree.scene.cameras import Camera
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array, UInt8
from splatree.train.refine_options import Teacher

__all__ = ["Lesson", "lessons_of", "made_views"]

SIZE, PICTURE = (320, 240), (640, 480)
"""Of a view, px, and of the picture that it is cut from."""

LARGER = 4
"""How much larger the teacher `large` draws."""

PIXELS_MAX = 4 * SIZE[0] * SIZE[1]
"""Cameras of larger pictures are scaled down to about so many pixels."""

DISTANCES = (0.2, 12.0)
"""Of made views, in radii of the scene."""

NEAR = 3.0
"""Made views nearer than so many radii are aimed all over the scene and cut from anywhere in the picture."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """One view to learn from."""

    camera: Camera
    """The view."""
    picture: UInt8[Array, "h w 3"]
    """What all leaves look like in it, 0 to 255."""


def lessons_of(
    scene: Scene, cameras: Sequence[Camera], teacher: Teacher, *, device: DeviceName = "cpu", threads: int = 0
) -> list[Lesson]:
    """Draw all leaves in each view; cameras have no lens."""
    lessons = []
    everything = SelectOptions(pixel_error=0.0)
    with open_session(scene, device=device, select=everything, threads=threads) as session:
        for camera in track(cameras, "draw the teacher's pictures"):
            pixels = camera.width * camera.height
            view = camera.scaled(math.sqrt(PIXELS_MAX / pixels)) if pixels > PIXELS_MAX else camera
            if teacher == "large":
                image = _averaged(np.clip(session.draw(view.scaled(LARGER)).image, 0, 1), view.height, view.width)
            else:
                image = np.clip(session.draw(view).image, 0, 1)
            lessons.append(Lesson(view, np.rint(255 * image).astype(np.uint8)))
    return lessons


def _averaged(image: Array, height: int, width: int) -> Array:
    return np.asarray(image.reshape(height, LARGER, width, LARGER, 3).mean(axis=(1, 3)))


def made_views(scene: Scene, count: int, seed: int) -> list[Camera]:
    """Views all round a scene."""
    centre, radius = bounds_of(scene)
    up = np.asarray(guess_up(survey_of(scene), scene.source).up, np.float64)
    rng = np.random.default_rng([seed, 1])
    return [_made_view(centre, radius, up, rng, i) for i in range(count)]


def _made_view(centre: Array, radius: float, up: Array, rng: np.random.Generator, number: int) -> Camera:
    direction = directions_above(up)
    distance = math.exp(rng.uniform(*np.log(DISTANCES)))
    toward = direction(rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(25, 85)))
    is_near = distance < NEAR
    east, north = rng.normal(0, 0.35 * radius * min(1.0, 1.2 / max(distance, 0.4)), 2)
    target = centre + east * direction(math.pi / 2, 0) + north * direction(0, 0) if is_near else centre
    camera = Camera.look_at(target + radius * distance * toward, target, up=up, width=PICTURE[0], height=PICTURE[1])
    room = np.subtract(PICTURE, SIZE)
    corner = rng.integers(0, room + 1) if is_near else room // 2
    K = camera.K.copy()
    K[:2, 2] -= corner
    near = min(camera.near, 0.01 * radius * distance)
    return replace(camera, K=K, width=SIZE[0], height=SIZE[1], near=near, name=f"made_{number:04d}")
