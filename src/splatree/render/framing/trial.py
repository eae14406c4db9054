"""Trial pictures: small, of the survey's sample, to see what a view would show."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from splatree.render.framing.survey import Survey
from splatree.render.session import Session, open_session
from splatree.scene.cameras import Camera
from splatree.scene.frame import RenderResult
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array, Float64

__all__ = ["FOCUS_RADII", "Trial", "draw", "judge", "rays", "trial_camera", "trial_session"]

FOCUS_RADII: Final = 1.6
"""What lies within so many radii of the centre belongs into a picture from outside."""

BEHIND: Final = 0.1
"""A leaf that lies at most this share of the radius behind the surface counts as seen."""


@dataclass(frozen=True)
class Trial:
    """What a trial picture is worth."""

    score: float
    """Share of the focus that it shows, more for detail, less for what stands before it."""
    blocked: float
    """Share of the picture that shows something before the focus."""


def judge(result: RenderResult, camera: Camera, focus: Array, centre: Array, radius: float) -> Trial:
    """How well a picture shows the focus."""
    rotation, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    x, y, z = rotation @ focus.T + shift[:, None]
    z = np.maximum(z, camera.near)
    column = np.floor(camera.K[0, 0] * x / z + camera.K[0, 2]).astype(int)
    row = np.floor(camera.K[1, 1] * y / z + camera.K[1, 2]).astype(int)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & (z > camera.near)
    surface = result.depth[row[inside], column[inside]]
    visible = float((z[inside] < surface + BEHIND * radius).sum()) / len(focus)
    offset = np.linalg.norm((rays(camera) * result.depth[..., None] - shift) @ rotation - centre, axis=-1)
    distance = float(np.linalg.norm(camera.position - centre))
    blocked = float((result.alpha * ((offset > FOCUS_RADII * radius) & (result.depth < distance))).mean())
    grey = np.clip(result.image, 0, 1).mean(axis=2)
    edges = np.abs(np.diff(grey, axis=0))[:, :-1] + np.abs(np.diff(grey, axis=1))[:-1]
    detail = float(edges.sum() / max(float(result.alpha.sum()), 1.0))
    return Trial(visible * (1 + 4 * detail) - 2 * blocked, blocked)


def rays(camera: Camera) -> Float64[Array, "h w 3"]:
    """Direction of each pixel in the camera's axes, with depth 1."""
    x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    return np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)


def trial_camera(eye: Array, target: Array, up: Array, size: tuple[int, int], fov_y_deg: float) -> Camera:
    camera = Camera.look_at(eye, target, up=up, width=size[0], height=size[1], fov_y_deg=fov_y_deg)
    return replace(camera, near=0.01 * float(np.linalg.norm(target - eye)))


def draw(sample: Session, camera: Camera) -> RenderResult:
    return sample.draw(camera)


def trial_session(survey: Survey) -> Session:
    """What draws the sample; where leaves were left out, those that stand for them are wider."""
    g = survey.gaussians
    wider = np.float32(0.5 * np.log(survey.spacing))
    scene = Scene.flat(replace(g, log_scales=g.log_scales + wider))
    return open_session(scene, select=SelectOptions(pixel_error=0))
