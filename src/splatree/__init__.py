"""splatree makes large 3D Gaussian Splatting scenes small, fast and streamable.

Public names are loaded when they are first used, so importing splatree costs next to nothing. Type checkers read them in
__init__.pyi, which `scripts/names` writes from the list below.
"""

import importlib
import sys
from types import ModuleType
from typing import Any

_NAMES = {
    "clusters.build": ("ClusterOptions", "build_clusters"),
    "clusters.cull": ("cull",),
    "edit.clean": (
        "CleanOptions",
        "Cleaned",
        "clean",
    ),
    "edit.edit": ("edit",),
    "edit.options": ("EditOptions",),
    "errors": (
        "DeviceError",
        "FormatError",
        "InputError",
        "MissingExtraError",
        "OutputError",
        "ShapeError",
        "SplatreeError",
    ),
    "hardware.config": ("Machine",),
    "hardware.study": ("Simulation", "simulate"),
    "io.cameras.files": ("read_cameras", "write_cameras"),
    "io.cleaning": ("CleanedFile", "clean_file"),
    "io.convert": ("ConvertOptions", "Converted", "convert"),
    "io.formats.splatree.head": ("SceneHead", "common_head"),
    "io.formats.splatree.rows": ("SceneRows", "StoredScene", "open_scene"),
    "io.formats.splatree.writer": ("SceneWriter", "create_scene"),
    "io.images": ("read_image", "write_image"),
    "io.options": ("ReadOptions", "WriteOptions"),
    "io.reading": ("read", "read_levels"),
    "io.writing": ("write",),
    "lod.baselines": ("Baseline", "BaselineOptions", "baseline"),
    "lod.link": ("link_levels",),
    "lod.options": ("BuildOptions",),
    "lod.select": ("select",),
    "metrics.flip": ("flip",),
    "metrics.psnr": ("psnr",),
    "metrics.ssim": ("ssim",),
    "outofcore.build": ("BuiltFolder",),
    "outofcore.check": ("Checked", "check"),
    "outofcore.clustering": ("ClusteredFile", "cluster_file"),
    "outofcore.opened": ("open_store",),
    "outofcore.options": ("FolderOptions",),
    "outofcore.store": ("Store",),
    "outofcore.thin": ("ThinnedFile", "thin_file"),
    "render.batch": ("render_batch", "trace_batch"),
    "render.build": ("build_lod",),
    "render.calibrate": ("calibrate",),
    "render.calibration": ("CalibrateOptions", "Calibration", "calibrated"),
    "render.compare": ("ComparedView", "Difference", "compare", "comparison_views"),
    "render.compare_page": ("Comparison", "write_comparison"),
    "render.contribution": (
        "ContributionHistogram",
        "TileContributions",
        "contribution_histogram",
        "tile_contributions",
    ),
    "render.counters": ("FrameCounters", "frame_counters", "write_counters"),
    "render.evaluate": ("Evaluation", "evaluate"),
    "render.folder": ("build_folder",),
    "render.framing.frame": ("Framing", "frame_scene"),
    "render.moving": ("Motion", "MovedFrame", "Moving"),
    "render.paths": ("PathOptions", "flyout", "orbit", "through", "turn"),
    "render.pending": ("Pending",),
    "render.pipeline": ("render", "trace"),
    "render.popping": ("Pop", "dolly", "measure_pops"),
    "render.session": ("Session", "open_session"),
    "render.tensors": ("TensorScene", "scene_from_tensors"),
    "render.timing": ("Timing", "time_frames"),
    "render.trial": ("try_methods",),
    "render.video": ("open_video",),
    "scene.cameras": ("Camera", "Cameras"),
    "scene.clusters": ("ClusterIndex", "Culling"),
    "scene.frame": ("Frame", "RenderResult", "Selection"),
    "scene.gaussians": ("Gaussians",),
    "scene.levels": ("LevelRecord",),
    "scene.options": ("RenderOptions", "SelectOptions"),
    "scene.scene": ("Scene",),
    "scene.thinning": ("Groups", "MergeOptions", "ThinOptions"),
    "scene.tree": ("GaussianTree",),
    "scene.trial": ("MethodTrial",),
    "scene.view": ("View", "Wanted"),
    "simplify.merge": ("merge",),
    "simplify.thin": ("Thinned", "thin"),
    "stream.options": ("StreamOptions",),
    "stream.report": ("StreamReport", "report_stream"),
    "stream.report_page": ("write_stream_report",),
    "stream.result": ("Streamed",),
    "stream.serve": ("ServeOptions", "StreamServer", "serve"),
    "stream.stream": ("stream",),
    "train.options": ("RunFiles", "TrainOptions"),
    "train.refine": ("Refined", "refine"),
    "train.refine_options": ("RefineOptions",),
    "train.run": ("Trained", "train"),
    "train.state": ("Scored",),
    "view.options": ("ViewOptions",),
    "view.viewer": ("Viewer", "view"),
}
"""The public names by their modules, without `splatree.` before these."""

_HOME = {name: f"splatree.{module}" for module, names in _NAMES.items() for name in names}

__all__ = sorted(_HOME)


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
