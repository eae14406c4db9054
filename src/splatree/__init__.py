"""splatree makes large 3D Gaussian Splatting scenes small, fast and streamable."""

from splatree.errors import FormatError, InputError, MissingExtraError, OutputError, ShapeError, SplatreeError
from splatree.io.cameras import read_cameras, write_cameras
from splatree.io.images import read_image, write_image
from splatree.io.registry import read, write
from splatree.lod.build import BuildOptions, build_lod
from splatree.lod.select import select
from splatree.metrics.psnr import psnr
from splatree.metrics.ssim import ssim
from splatree.render.batch import render_batch, trace_batch
from splatree.render.evaluate import Evaluation, evaluate
from splatree.render.paths import PathOptions, flyout, orbit
from splatree.render.pipeline import render, trace
from splatree.render.video import open_video
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.frame import Frame, RenderResult, Selection
from splatree.scene.gaussians import Gaussians
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.thinning import Groups, MergeOptions, ThinOptions
from splatree.scene.tree import GaussianTree
from splatree.simplify.merge import merge
from splatree.simplify.thin import Thinned, thin

__all__ = [
    "BuildOptions",
    "Camera",
    "Cameras",
    "Evaluation",
    "FormatError",
    "Frame",
    "GaussianTree",
    "Gaussians",
    "Groups",
    "InputError",
    "MergeOptions",
    "MissingExtraError",
    "OutputError",
    "PathOptions",
    "RenderOptions",
    "RenderResult",
    "Scene",
    "SelectOptions",
    "Selection",
    "ShapeError",
    "SplatreeError",
    "ThinOptions",
    "Thinned",
    "build_lod",
    "evaluate",
    "flyout",
    "merge",
    "open_video",
    "orbit",
    "psnr",
    "read",
    "read_cameras",
    "read_image",
    "render",
    "render_batch",
    "select",
    "ssim",
    "thin",
    "trace",
    "trace_batch",
    "write",
    "write_cameras",
    "write_image",
]
