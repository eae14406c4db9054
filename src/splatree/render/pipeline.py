"""A frame: cull → select → project → bin → blend.

::

    Camera ─► cull ─────► select ────► project ─► bin ─► blend ─► RenderResult
              clusters    LoD cut      splats     tiles  image

Each stage is a function from structs to a struct; `render` drops what lies between, `trace` keeps it. The picture is that of
standard 3D Gaussian Splatting (Kerbl 2023), and has the same bits for any number of threads and any order of rows.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from splatree.kernels import Backend, backend_for
from splatree.lod.select import Selector, cull_rule, cull_scene, for_levels
from splatree.lod.select import select as select_rows
from splatree.scene.cameras import Camera
from splatree.scene.frame import Counters, Frame, RenderResult
from splatree.scene.options import RenderOptions, ResolvedOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.warp import bend, covering_pinhole

__all__ = ["render", "trace"]

T = TypeVar("T")


def render(
    scene: Scene,
    camera: Camera,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    threads: int = 0,
    backend: Backend | None = None,
) -> RenderResult:
    """Draw a view of a scene.

    The level of detail follows ``select``, options or a baseline (lod/baselines.py); all leaves are drawn with
    ``SelectOptions(pixel_error=0)``. ``threads`` 0 means all there are. The backend is that of the scene's device; `reference`
    is NumPy float64: slow, to compare with.

    A camera with a lens is drawn by the pinhole that sees all that it shows, and the picture is bent (scene/warp.py).
    """
    if camera.lens is not None:
        pinhole = covering_pinhole(camera)
        flat = render(scene, pinhole, options, select, threads=threads, backend=backend)
        return _through_lens(flat, pinhole, camera)
    if (backend or scene.device) == "cuda":
        from splatree.render.device import render_on_device

        resolved = (options or RenderOptions()).resolved(scene)
        return render_on_device(scene, camera, resolved, _settled(select or SelectOptions(), scene, resolved))
    return trace(scene, camera, options, select, threads=threads, backend=backend).result


def trace(
    scene: Scene,
    camera: Camera,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    threads: int = 0,
    backend: Backend | None = None,
    contributions: bool = False,
) -> Frame:
    """Draw a view like `render` and keep what each stage computed.

    ``contributions`` also sums what each pair of splat and tile contributes to the picture (render/contribution.py). Of a camera
    with a lens, ``Frame.camera`` and all stages are those of the pinhole that stands for it; the picture alone is the camera's.
    """
    if camera.lens is not None:
        pinhole = covering_pinhole(camera)
        frame = trace(scene, pinhole, options, select, threads=threads, backend=backend, contributions=contributions)
        return replace(frame, result=_through_lens(frame.result, pinhole, camera))
    options, select = options or RenderOptions(), select or SelectOptions()
    resolved = options.resolved(scene)
    select = _settled(select, scene, resolved)
    if (backend or scene.device) == "cuda":
        from splatree.render.device import trace_on_device

        return trace_on_device(scene, camera, resolved, select, contributions=contributions)
    kernels = backend_for(backend or scene.device)
    milliseconds: dict[str, float] = {}
    cpu_milliseconds: dict[str, float] = {}

    def timed(stage: str, work: Callable[[], T]) -> T:
        start, cpu = time.perf_counter(), time.process_time()
        value = work()
        milliseconds[stage] = 1e3 * (time.perf_counter() - start)
        cpu_milliseconds[stage] = 1e3 * (time.process_time() - cpu)
        return value

    culling = None
    if isinstance(select, SelectOptions):
        if cull_rule(scene, select) != "none":
            culling = timed(
                "cull",
                lambda: cull_scene(
                    scene,
                    camera,
                    select,
                    dilation_px2=resolved.dilation_px2,
                    threshold=resolved.threshold,
                    tile_rule=resolved.tile_rule,
                    threads=threads,
                ),
            )
        choose: Selector = partial(select_rows, scene, options=select, culling=culling)
    else:
        choose = select
    selection = timed(
        "select",
        lambda: choose(camera, dilation_px2=resolved.dilation_px2, threshold=resolved.least_threshold, threads=threads),
    )
    splats = timed(
        "project",
        lambda: kernels.project(scene.gaussians, scene.ids, selection.rows, camera, resolved, threads=threads),
    )
    bins = timed("bin", lambda: kernels.bin(splats, camera, resolved, threads=threads))
    picture = timed(
        "blend",
        lambda: kernels.blend(splats, bins, camera, resolved, threads=threads, contributions=contributions),
    )
    counters = Counters(
        num_selected=len(selection),
        num_visible=len(splats),
        num_pairs=bins.num_pairs,
        num_evaluated=picture.num_evaluated,
        num_blended=picture.num_blended,
    )
    result = RenderResult(picture.image, picture.alpha, picture.depth, counters, milliseconds, cpu_milliseconds)
    return Frame(camera, culling, selection, splats, bins, picture.tiles, result, picture.contributions)


def _through_lens(flat: RenderResult, pinhole: Camera, camera: Camera) -> RenderResult:
    """The picture of a camera with a lens from that of its pinhole; alpha is bent like colour, depth where something is drawn."""
    image, alpha = bend(flat.image, pinhole, camera), bend(flat.alpha, pinhole, camera)
    weighted = bend(flat.depth * flat.alpha, pinhole, camera)
    depth = np.divide(weighted, alpha, out=np.zeros_like(alpha), where=alpha > 0)
    return replace(flat, image=image, alpha=alpha, depth=depth)


def _settled(select: SelectOptions | Selector, scene: Scene, options: ResolvedOptions) -> SelectOptions | Selector:
    """The options with what follows from the scene and from how it is drawn."""
    if not isinstance(select, SelectOptions):
        return select
    select = for_levels(select, scene)
    if select.view_test == "footprint" and options.is_square:
        return replace(
            select, view_test="none"
        )  # footprints are ellipses; the projection drops what squares do not show
    return select
