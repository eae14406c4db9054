"""``splatree demo``: the main job on a bundled piece of a real city, with pictures and a report.

Reads the scene, builds its tree, flies away from the ground, and draws each view twice, from the cut and from all leaves. The
report says how many nodes were drawn, what that cost and how near the pictures are.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from splatree.cli.console import Console, UsageError, counted, table
from splatree.cli.eval_views import row_of, view_of
from splatree.cli.flight import Demo, DemoView
from splatree.cli.pictures import make_folder
from splatree.cli.report import write_report
from splatree.io.reading import read
from splatree.io.replacing import check_free_in
from splatree.metrics.psnr import psnr
from splatree.progress import task
from splatree.render.build import build_lod
from splatree.render.evaluate import Evaluation, evaluate
from splatree.render.paths import PathOptions, bounds_of, flyout
from splatree.render.pipeline import trace
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

SCENE = "semarang_5_9.sog"
REPORT = "report.html"

CREDIT = (
    "Scene: a piece of “KARANGKIDUL KOTA SEMARANG 2” by Samuel Hiero, https://superspl.at/scene/b4b950fe, "
    "CC BY 4.0 (http://creativecommons.org/licenses/by/4.0/); levels of detail added by splatree."
)

PIXEL_ERRORS = (2.0, 3.0, 4.0, 6.0, 9.0, 14.0)
"""τ_R of the curves of quality over nodes drawn, px."""


@dataclass(frozen=True)
class Command:
    """Build, draw and judge a bundled piece of a real city; writes a report with pictures."""

    output: Annotated[Path, arg(aliases=["-o"])] = Path("splatree-demo")
    """Folder for report.html and its pictures; an earlier report there is replaced."""
    made: Annotated[PathOptions, arg(name="", help="")] = PathOptions(views=6, up=(0.0, -1.0, 0.0), elevation_deg=40.0)
    select: Annotated[SelectOptions, arg(name="", help="")] = SelectOptions()
    console: Annotated[Console, arg(name="", help="")] = Console()


def run(command: Command) -> Demo:
    """Read, build, fly, compare, report."""
    if command.select.quality is not None:
        raise UsageError(
            "found --quality, wanted --pixel-error or --budget: the demo shows what pixel errors look like"
        )
    check_free_in(command.output, [REPORT], force=True)
    seconds: dict[str, float] = {}
    with _timed(seconds, "read"), as_file(files("splatree") / "data" / SCENE) as path:
        scene = read(path)
    with _timed(seconds, "build"):
        scene = build_lod(scene)
    cameras = flyout(scene, command.made, nearest=0.25, farthest=8.0)
    trace(scene, cameras[0], select=command.select)  # the first frame also pays for indices and caches: not timed
    with _timed(seconds, "views"):
        evaluations = list(evaluate(scene, cameras, select=command.select))
    with _timed(seconds, "curves"), task("draw curves", len(cameras)) as advance:
        views = []
        for evaluation in evaluations:
            views.append(_demo_view(scene, evaluation, command.select))
            advance(1)
    make_folder(command.output)
    demo = Demo(
        num_gaussians=scene.tree.num_leaves,
        num_nodes=len(scene),
        levels=scene.tree.num_levels,
        nodes_per_depth=tuple(int(n) for n in np.bincount(scene.tree.depth)),
        mode=scene.mode,
        select=command.select,
        seconds=seconds,
        views=tuple(views),
        report=command.output / REPORT,
        credit=CREDIT,
    )
    write_report(demo, scene, evaluations)
    return demo


def show(demo: Demo) -> str:
    """The flight as a table."""
    rows = [{"distance": round(view.distance), **row_of(view)} for view in demo.views]
    took = ", ".join(f"{name} {duration:.1f} s" for name, duration in demo.seconds.items())
    return (
        f"{demo.num_gaussians:,} Gaussians became a tree of {demo.num_nodes:,} nodes in {counted(demo.levels, 'level')} "
        f"({took})\n"
        f"{table(rows)}\n{demo.credit}\nreport: {demo.report}"
    )


def _demo_view(scene: Scene, evaluation: Evaluation, select: SelectOptions) -> DemoView:
    cut, leaves = (np.clip(frame.result.image, 0, 1) for frame in (evaluation.cut, evaluation.leaves))
    covered = evaluation.leaves.result.alpha > 0.5
    curve = []
    for pixel_error in PIXEL_ERRORS:
        frame = trace(
            scene, evaluation.camera, select=replace(select, pixel_error=pixel_error, budget=None, quality=None)
        )
        curve.append((pixel_error, len(frame.selection), psnr(np.clip(frame.result.image, 0, 1), leaves)))
    return DemoView(
        **vars(view_of(evaluation)),
        distance=float(np.linalg.norm(evaluation.camera.position - bounds_of(scene)[0])),
        psnr_where_covered=psnr(cut[covered], leaves[covered]) if covered.any() else np.inf,
        curve=tuple(curve),
    )


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
