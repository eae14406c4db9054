"""splatree makes large 3D Gaussian Splatting scenes small, fast and streamable.

Public names are loaded when they are first used, so importing splatree costs next to nothing.
"""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatree.clusters.build import ClusterOptions, build_clusters
    from splatree.clusters.cull import cull
    from splatree.edit.edit import edit
    from splatree.edit.options import EditOptions
    from splatree.errors import (
        DeviceError,
        FormatError,
        InputError,
        MissingExtraError,
        OutputError,
        ShapeError,
        SplatreeError,
    )
    from splatree.hardware.config import Machine
    from splatree.hardware.study import Simulation, simulate
    from splatree.io.cameras.files import read_cameras, write_cameras
    from splatree.io.convert import Converted, ConvertOptions, convert
    from splatree.io.formats.splatree.head import SceneHead, common_head
    from splatree.io.formats.splatree.rows import SceneRows, StoredScene, open_scene
    from splatree.io.formats.splatree.writer import SceneWriter, create_scene
    from splatree.io.images import read_image, write_image
    from splatree.io.options import ReadOptions, WriteOptions
    from splatree.io.registry import read, read_levels, write
    from splatree.lod.baselines import Baseline, BaselineOptions, baseline
    from splatree.lod.build import build_lod
    from splatree.lod.link import link_levels
    from splatree.lod.options import BuildOptions
    from splatree.lod.select import select
    from splatree.metrics.flip import flip
    from splatree.metrics.psnr import psnr
    from splatree.metrics.ssim import ssim
    from splatree.render.batch import render_batch, trace_batch
    from splatree.render.calibrate import CalibrateOptions, Calibration, calibrate, calibrated
    from splatree.render.compare import ComparedView, Difference, compare, comparison_views
    from splatree.render.compare_page import Comparison, write_comparison
    from splatree.render.contribution import (
        ContributionHistogram,
        TileContributions,
        contribution_histogram,
        tile_contributions,
    )
    from splatree.render.counters import FrameCounters, frame_counters, write_counters
    from splatree.render.evaluate import Evaluation, evaluate
    from splatree.render.framing.frame import Framing, frame_scene
    from splatree.render.paths import PathOptions, flyout, orbit, through, turn
    from splatree.render.pending import Pending
    from splatree.render.pipeline import render, trace
    from splatree.render.session import Session, open_session
    from splatree.render.tensors import TensorScene, scene_from_tensors
    from splatree.render.timing import Timing, time_frames
    from splatree.render.video import open_video
    from splatree.scene.cameras import Camera, Cameras
    from splatree.scene.clusters import ClusterIndex, Culling
    from splatree.scene.frame import Frame, RenderResult, Selection
    from splatree.scene.gaussians import Gaussians
    from splatree.scene.levels import LevelRecord
    from splatree.scene.options import RenderOptions, SelectOptions
    from splatree.scene.scene import Scene
    from splatree.scene.thinning import Groups, MergeOptions, ThinOptions
    from splatree.scene.tree import GaussianTree
    from splatree.scene.view import View, Wanted
    from splatree.simplify.merge import merge
    from splatree.simplify.thin import Thinned, thin
    from splatree.stream.options import StreamOptions
    from splatree.stream.result import Streamed
    from splatree.stream.serve import ServeOptions, StreamServer, serve
    from splatree.stream.stream import stream
    from splatree.view.options import ViewOptions
    from splatree.view.viewer import Viewer, view

__all__ = [
    "Baseline",
    "BaselineOptions",
    "BuildOptions",
    "CalibrateOptions",
    "Calibration",
    "Camera",
    "Cameras",
    "ClusterIndex",
    "ClusterOptions",
    "ComparedView",
    "Comparison",
    "ContributionHistogram",
    "ConvertOptions",
    "Converted",
    "Culling",
    "DeviceError",
    "Difference",
    "EditOptions",
    "Evaluation",
    "FormatError",
    "Frame",
    "FrameCounters",
    "Framing",
    "GaussianTree",
    "Gaussians",
    "Groups",
    "InputError",
    "LevelRecord",
    "Machine",
    "MergeOptions",
    "MissingExtraError",
    "OutputError",
    "PathOptions",
    "Pending",
    "ReadOptions",
    "RenderOptions",
    "RenderResult",
    "Scene",
    "SceneHead",
    "SceneRows",
    "SceneWriter",
    "SelectOptions",
    "Selection",
    "ServeOptions",
    "Session",
    "ShapeError",
    "Simulation",
    "SplatreeError",
    "StoredScene",
    "StreamOptions",
    "StreamServer",
    "Streamed",
    "TensorScene",
    "ThinOptions",
    "Thinned",
    "TileContributions",
    "Timing",
    "View",
    "ViewOptions",
    "Viewer",
    "Wanted",
    "WriteOptions",
    "baseline",
    "build_clusters",
    "build_lod",
    "calibrate",
    "calibrated",
    "common_head",
    "compare",
    "comparison_views",
    "contribution_histogram",
    "convert",
    "create_scene",
    "cull",
    "edit",
    "evaluate",
    "flip",
    "flyout",
    "frame_counters",
    "frame_scene",
    "link_levels",
    "merge",
    "open_scene",
    "open_session",
    "open_video",
    "orbit",
    "psnr",
    "read",
    "read_cameras",
    "read_image",
    "read_levels",
    "render",
    "render_batch",
    "scene_from_tensors",
    "select",
    "serve",
    "simulate",
    "ssim",
    "stream",
    "thin",
    "through",
    "tile_contributions",
    "time_frames",
    "trace",
    "trace_batch",
    "turn",
    "view",
    "write",
    "write_cameras",
    "write_comparison",
    "write_counters",
    "write_image",
]

_HOME = {
    "Baseline": "splatree.lod.baselines",
    "BaselineOptions": "splatree.lod.baselines",
    "BuildOptions": "splatree.lod.options",
    "CalibrateOptions": "splatree.render.calibrate",
    "Calibration": "splatree.render.calibrate",
    "Camera": "splatree.scene.cameras",
    "Cameras": "splatree.scene.cameras",
    "ClusterIndex": "splatree.scene.clusters",
    "ClusterOptions": "splatree.clusters.build",
    "ComparedView": "splatree.render.compare",
    "Comparison": "splatree.render.compare_page",
    "ContributionHistogram": "splatree.render.contribution",
    "ConvertOptions": "splatree.io.convert",
    "Converted": "splatree.io.convert",
    "Culling": "splatree.scene.clusters",
    "DeviceError": "splatree.errors",
    "Difference": "splatree.render.compare",
    "EditOptions": "splatree.edit.options",
    "Evaluation": "splatree.render.evaluate",
    "FormatError": "splatree.errors",
    "Frame": "splatree.scene.frame",
    "FrameCounters": "splatree.render.counters",
    "Framing": "splatree.render.framing.frame",
    "GaussianTree": "splatree.scene.tree",
    "Gaussians": "splatree.scene.gaussians",
    "Groups": "splatree.scene.thinning",
    "InputError": "splatree.errors",
    "LevelRecord": "splatree.scene.levels",
    "Machine": "splatree.hardware.config",
    "MergeOptions": "splatree.scene.thinning",
    "MissingExtraError": "splatree.errors",
    "OutputError": "splatree.errors",
    "PathOptions": "splatree.render.paths",
    "Pending": "splatree.render.pending",
    "ReadOptions": "splatree.io.options",
    "RenderOptions": "splatree.scene.options",
    "RenderResult": "splatree.scene.frame",
    "Scene": "splatree.scene.scene",
    "SceneHead": "splatree.io.formats.splatree.head",
    "SceneRows": "splatree.io.formats.splatree.rows",
    "SceneWriter": "splatree.io.formats.splatree.writer",
    "SelectOptions": "splatree.scene.options",
    "Selection": "splatree.scene.frame",
    "ServeOptions": "splatree.stream.serve",
    "Session": "splatree.render.session",
    "ShapeError": "splatree.errors",
    "Simulation": "splatree.hardware.study",
    "SplatreeError": "splatree.errors",
    "StoredScene": "splatree.io.formats.splatree.rows",
    "StreamOptions": "splatree.stream.options",
    "StreamServer": "splatree.stream.serve",
    "Streamed": "splatree.stream.result",
    "TensorScene": "splatree.render.tensors",
    "ThinOptions": "splatree.scene.thinning",
    "Thinned": "splatree.simplify.thin",
    "TileContributions": "splatree.render.contribution",
    "Timing": "splatree.render.timing",
    "View": "splatree.scene.view",
    "ViewOptions": "splatree.view.options",
    "Viewer": "splatree.view.viewer",
    "Wanted": "splatree.scene.view",
    "WriteOptions": "splatree.io.options",
    "baseline": "splatree.lod.baselines",
    "build_clusters": "splatree.clusters.build",
    "build_lod": "splatree.lod.build",
    "calibrate": "splatree.render.calibrate",
    "calibrated": "splatree.render.calibrate",
    "common_head": "splatree.io.formats.splatree.head",
    "compare": "splatree.render.compare",
    "comparison_views": "splatree.render.compare",
    "contribution_histogram": "splatree.render.contribution",
    "convert": "splatree.io.convert",
    "create_scene": "splatree.io.formats.splatree.writer",
    "cull": "splatree.clusters.cull",
    "edit": "splatree.edit.edit",
    "evaluate": "splatree.render.evaluate",
    "flip": "splatree.metrics.flip",
    "flyout": "splatree.render.paths",
    "frame_counters": "splatree.render.counters",
    "frame_scene": "splatree.render.framing.frame",
    "link_levels": "splatree.lod.link",
    "merge": "splatree.simplify.merge",
    "open_scene": "splatree.io.formats.splatree.rows",
    "open_session": "splatree.render.session",
    "open_video": "splatree.render.video",
    "orbit": "splatree.render.paths",
    "psnr": "splatree.metrics.psnr",
    "read": "splatree.io.registry",
    "read_cameras": "splatree.io.cameras.files",
    "read_image": "splatree.io.images",
    "read_levels": "splatree.io.registry",
    "render": "splatree.render.pipeline",
    "render_batch": "splatree.render.batch",
    "scene_from_tensors": "splatree.render.tensors",
    "select": "splatree.lod.select",
    "serve": "splatree.stream.serve",
    "simulate": "splatree.hardware.study",
    "ssim": "splatree.metrics.ssim",
    "stream": "splatree.stream.stream",
    "thin": "splatree.simplify.thin",
    "through": "splatree.render.paths",
    "tile_contributions": "splatree.render.contribution",
    "time_frames": "splatree.render.timing",
    "trace": "splatree.render.pipeline",
    "trace_batch": "splatree.render.batch",
    "turn": "splatree.render.paths",
    "view": "splatree.view.viewer",
    "write": "splatree.io.registry",
    "write_cameras": "splatree.io.cameras.files",
    "write_comparison": "splatree.render.compare_page",
    "write_counters": "splatree.render.counters",
    "write_image": "splatree.io.images",
}


if not TYPE_CHECKING:  # to a type checker an unknown name is an error

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'splatree' has no attribute {name!r}")
        value = getattr(importlib.import_module(_HOME[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return list(__all__)


class _Package(ModuleType):
    def __setattr__(self, name: str, value: Any) -> None:
        # Loading the subpackage `splatree.render` would put it in the place of the function of that name.
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
