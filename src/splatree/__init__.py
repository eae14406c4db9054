"""splatree makes large 3D Gaussian Splatting scenes small, fast and streamable."""

from splatree.errors import FormatError, InputError, MissingExtraError, OutputError, ShapeError, SplatreeError
from splatree.io.registry import read, write
from splatree.lod.select import select
from splatree.render.pipeline import render, trace
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.tree import GaussianTree

__all__ = [
    "Camera",
    "Cameras",
    "FormatError",
    "GaussianTree",
    "Gaussians",
    "InputError",
    "MissingExtraError",
    "OutputError",
    "RenderOptions",
    "Scene",
    "SelectOptions",
    "ShapeError",
    "SplatreeError",
    "read",
    "render",
    "select",
    "trace",
    "write",
]
