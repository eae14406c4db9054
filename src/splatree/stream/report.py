"""How good a written stream is: the quality of the picture against the bytes that a viewer loads for it.

A view is near, middle or far: 0.3, 1 and 3 radii of the scene from its centre, or one of given cameras. In each view the viewer's
own choice is repeated (`splatree.stream.readers`) for several budgets. What it chooses is decoded from the files, drawn as
the viewer draws it unless it is told otherwise, and compared with the library's picture of all leaves of the scene: PlayCanvas
widens splats too little (`readers.playcanvas_drawing`), Spark draws every scene as antialiased. Bytes are those of whole files
(sog, 3dtiles) or chunks (rad) that hold what is drawn. Beside it stands the exact cut of the tree with as many nodes, which no
chunks bind.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from splatree.io.formats.rad.container import open_rad
from splatree.io.formats.rad.nodes import nodes_of
from splatree.io.local import local_inputs
from splatree.io.reading import read
from splatree.lod.select import select
from splatree.metrics.psnr import psnr
from splatree.metrics.ssim import ssim
from splatree.progress import track
from splatree.render.paths import bounds_of
from splatree.render.pipeline import render
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.frame import RenderResult
from splatree.scene.gaussians import Gaussians
from splatree.scene.names import Mode
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene
from splatree.shapes import Array
from splatree.stream.chunk_quality import ChunkQuality, quality_of_chunks
from splatree.stream.rad import as_written
from splatree.stream.readers.cesium import open_tileset, select_cesium
from splatree.stream.readers.playcanvas import select_by_errors, select_playcanvas
from splatree.stream.readers.playcanvas_drawing import draw_playcanvas
from splatree.stream.readers.sog_stream import Ranges, open_sog_stream
from splatree.stream.readers.spark import chunks_loaded, select_spark
from splatree.stream.result import Streamed

__all__ = [
    "EVERY_ROW",
    "LevelQuality",
    "StreamReport",
    "ViewQuality",
    "named_views",
    "report_stream",
    "viewers_of",
    "views_of",
]

BUDGETS = (100_000, 300_000, 1_000_000, 3_000_000)
"""Gaussians that PlayCanvas and Spark may draw."""

ERRORS_PX = (256.0, 64.0, 16.0)
"""maximumScreenSpaceError of CesiumJS."""

_DISTANCES = {"near": 0.3, "middle": 1.0, "far": 3.0}
_ELEVATION_DEG = 25.0
EVERY_ROW = SelectOptions(pixel_error=0)
"""All leaves."""


@dataclass(frozen=True)
class ViewQuality:
    """One view at one setting of the viewer."""

    view: str
    """`near`, `middle`, `far`, or the name of a camera."""
    viewer: str
    """`playcanvas`, `spark` or `cesium`; `playcanvas 2.22` chooses by the errors of the stream, if it has them."""
    setting: float
    """The budget, Gaussians; of Cesium the error that it allows, px."""
    num_nodes: int
    """Gaussians that are drawn."""
    bytes: int
    """What is loaded for them."""
    psnr_db: float
    """Against all leaves of the scene, drawn by the library; infinite if every bit is the same. Viewers are taken as they
    come: PlayCanvas draws small splats thinner than the scene was trained with, Spark fainter; Cesium is drawn by the library."""
    exact_psnr_db: float | None
    """The same of the exact cut of at most as many nodes; None if the roots in view are more."""


@dataclass(frozen=True)
class LevelQuality:
    """One level of a streamed SOG, drawn everywhere."""

    level: int
    """0 is the finest."""
    view: str
    """The view that it is looked at in."""
    num_nodes: int
    """Gaussians."""
    bytes: int
    """Size of its units."""
    psnr_db: float
    """Against all leaves of the scene, both drawn by the library."""
    ssim: float
    """The same, 0 to 1."""


@dataclass(frozen=True)
class StreamReport:
    """How good a stream looks, at several budgets and level by level.

    Example:
        >>> report = st.report_stream(scene, st.stream(scene, "city_stream"), [camera.scaled(2)], budgets=[100])
        >>> len(report.levels) > 0
        True
    """

    views: tuple[ViewQuality, ...]
    """Views by settings, coarse to fine."""
    levels: tuple[LevelQuality, ...]
    """Levels, finest first; none of other formats than sog."""
    chunks: tuple[ChunkQuality, ...]
    """The levels of each chunk; none of other formats than sog."""

    def to_json(self) -> str:
        """The report as JSON; the PSNR of equal pictures, which is infinite, becomes null."""
        return json.dumps({name: [_finite(asdict(row)) for row in rows] for name, rows in vars(self).items()}, indent=1)


def _finite(row: dict[str, object]) -> dict[str, object]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


@dataclass(frozen=True, eq=False)
class Loaded:
    """What a viewer shows in a view."""

    num_nodes: int
    """Gaussians that it chooses."""
    num_bytes: int
    """What it loads for them."""
    shown: RenderResult
    """How it draws them."""


Show = Callable[[Camera, float], Loaded]
"""What a viewer shows for a camera at one of its settings."""


@checked
def report_stream(
    scene: Scene, written: Streamed, cameras: Iterable[Camera] | None = None, *, budgets: Sequence[int] = BUDGETS
) -> StreamReport:
    """Judge a stream by views of the scene that it was written from.

    Args:
        scene: the scene with the levels that the stream was cut from.
        written: what `stream` returned.
        cameras: views; None: near, middle and far.
        budgets: Gaussians that PlayCanvas and Spark may draw; budgets above the size of the scene are left out.

    Returns:
        The quality of each view at each budget, and of each level.

    Raises:
        InputError: the scene is empty.

    Example:
        >>> report = st.report_stream(scene, st.stream(scene, "city_stream"), [camera], budgets=[100])
        >>> len(report.views) > 0
        True
    """
    with local_inputs([written.output]) as local:  # a zipped stream is unpacked
        return _report(scene, replace(written, output=local.paths[0]), cameras, budgets)


def _report(scene: Scene, written: Streamed, cameras: Iterable[Camera] | None, budgets: Sequence[int]) -> StreamReport:
    views, viewers = named_views(scene, cameras), viewers_of(scene, written)
    settings: Sequence[float] = ERRORS_PX
    if written.format != "3dtiles":
        settings = [b for b in budgets if b < scene.tree.num_leaves] or [scene.tree.num_leaves]
    found: list[ViewQuality] = []
    levels: list[LevelQuality] = []
    for name, camera in track(list(views.items()), f"judge {written.output.name}"):
        truth = _picture(scene, camera)
        for (viewer, show), setting in product(viewers.items(), settings):
            loaded = show(camera, setting)
            image = np.clip(loaded.shown.image, 0, 1)
            quality = psnr(image, truth), _exact_quality(scene, camera, loaded.num_nodes, truth)
            found.append(ViewQuality(name, viewer, setting, loaded.num_nodes, loaded.num_bytes, *quality))
        if written.format == "sog" and not levels:
            levels = list(_levels(scene, written, name, camera, truth))
    chunks = quality_of_chunks(open_sog_stream(written.output)) if written.format == "sog" else ()
    return StreamReport(tuple(found), tuple(levels), chunks)


def named_views(scene: Scene, cameras: Iterable[Camera] | None) -> dict[str, Camera]:
    """The views of a report by their names: the cameras, or near, middle and far."""
    if cameras is None:
        return dict(views_of(scene))
    return {view.name or f"view {i}": view for i, view in enumerate(cameras)}


def views_of(scene: Scene) -> Iterator[tuple[str, Camera]]:
    """The views near, middle and far of a scene."""
    centre, radius = bounds_of(scene)
    elevation = np.radians(_ELEVATION_DEG)
    direction = np.array([0.3, -np.sin(elevation), -np.cos(elevation)])
    for name, distance in _DISTANCES.items():
        yield name, Camera.look_at(centre + distance * radius * direction, centre)


def viewers_of(scene: Scene, written: Streamed) -> dict[str, Show]:
    """The viewers that read the stream, and what each draws and loads in a view."""

    def drawn(gaussians: Gaussians, camera: Camera, num_bytes: int, mode: Mode) -> Loaded:
        shown = render(Scene.flat(gaussians, mode=mode), camera, select=EVERY_ROW)
        return Loaded(len(gaussians), num_bytes, shown)

    if written.format == "sog":
        stream = open_sog_stream(written.output)

        def by(select: Callable[[Ranges, Camera, int], Array], camera: Camera, budget: float) -> Loaded:
            levels = select(stream.ranges, camera, int(budget))
            gaussians, num_bytes = stream.gaussians_of(levels), int(stream.file_bytes[stream.files_of(levels)].sum())
            return Loaded(len(gaussians), num_bytes, draw_playcanvas(gaussians, camera))

        viewers: dict[str, Show] = {"playcanvas": partial(by, select_playcanvas)}
        if stream.ranges.errors is not None:
            viewers["playcanvas 2.22"] = partial(by, select_by_errors)
        return viewers
    if written.format == "rad":
        tree = as_written(scene, written.options)
        back, nodes = read(written.output), nodes_of(tree, written.output)
        sizes = np.array([chunk.num_bytes for chunk in open_rad(written.output).chunks])

        def of_spark(camera: Camera, budget: float) -> Loaded:
            view = select_spark(tree, camera, int(budget))
            num_bytes = int(sizes[chunks_loaded(nodes, view)].sum())
            return drawn(back.gaussians.take(view.drawn), camera, num_bytes, "antialiased")

        return {"spark": of_spark}
    tiles = open_tileset(written.output)
    decoded: dict[int, Gaussians] = {}

    def of_cesium(camera: Camera, most_px: float) -> Loaded:
        chosen = select_cesium(tiles, camera, most_px=most_px)
        for tile in chosen.drawn.tolist():
            if tile not in decoded:
                decoded[tile] = read(written.output / tiles.names[tile]).gaussians
        parts = [decoded[tile] for tile in chosen.drawn.tolist()]
        gaussians = Gaussians.concatenate(parts) if parts else Gaussians.empty(scene.gaussians.sh_degree)
        return drawn(gaussians, camera, int(tiles.bytes[chosen.loaded].sum()), scene.mode)

    return {"cesium": of_cesium}


def _exact_quality(scene: Scene, camera: Camera, budget: int, truth: Array) -> float | None:
    """PSNR of the exact cut within a budget."""
    fewest = len(select(scene, camera, SelectOptions(pixel_error=np.inf)).rows)
    if budget < max(fewest, 1):
        return None
    exact = render(scene, camera, select=SelectOptions(pixel_error=0, budget=budget)).image
    return psnr(np.clip(exact, 0, 1), truth)


def _levels(scene: Scene, written: Streamed, view: str, camera: Camera, truth: Array) -> Iterator[LevelQuality]:
    stream = open_sog_stream(written.output)
    num_levels, num_chunks = stream.ranges.counts.shape
    for level in range(num_levels):
        everywhere = np.full(num_chunks, level)
        gaussians = stream.gaussians_of(everywhere)
        image = _picture(Scene.flat(gaussians, mode=scene.mode), camera)
        num_bytes = int(stream.file_bytes[stream.files_of(everywhere)].sum())
        yield LevelQuality(level, view, len(gaussians), num_bytes, psnr(image, truth), ssim(image, truth))


def _picture(scene: Scene, camera: Camera) -> Array:
    return np.clip(render(scene, camera, select=EVERY_ROW).image, 0, 1)
