"""Frames of a scene on a GPU.

A view by the rule `cut` is selected and drawn there as one piece of work (kernels/cuda/renderer.py). Where rows come from
elsewhere, from a budget, a baseline or one of the other rules, they are brought to the device and drawn.
"""

import time

from splatree.kernels.cuda.device import renderer_of
from splatree.lod.select import Selector, cull_rule, cull_scene, notes_on
from splatree.lod.select import select as select_rows
from splatree.scene.cameras import Camera
from splatree.scene.frame import Counters, Frame, Picture, RenderResult, Selection
from splatree.scene.options import ResolvedOptions, SelectOptions
from splatree.scene.scene import Scene

__all__ = ["render_on_device", "trace_on_device"]


def render_on_device(
    scene: Scene, camera: Camera, options: ResolvedOptions, select: SelectOptions | Selector
) -> RenderResult:
    """Draw a view; the time is that of the whole frame with the copy to the host."""
    if not _is_one_piece(scene, select):
        return trace_on_device(scene, camera, options, select).result
    assert isinstance(select, SelectOptions)
    start, cpu = time.perf_counter(), time.process_time()
    renderer = renderer_of(scene)
    drawn = renderer.draw(camera, options, select)
    picture = Picture(drawn.image.numpy(), drawn.alpha.numpy(), drawn.depth.numpy(), renderer.tile_work())
    counts = drawn.counters
    return _result(
        picture,
        counts["num_selected"],
        counts["num_visible"],
        counts["num_pairs"],
        {"frame": 1e3 * (time.perf_counter() - start)},
        {"frame": 1e3 * (time.process_time() - cpu)},
    )


def trace_on_device(
    scene: Scene,
    camera: Camera,
    options: ResolvedOptions,
    select: SelectOptions | Selector,
    *,
    contributions: bool = False,
) -> Frame:
    """Draw a view and keep what each stage computed; times are those of the device."""
    renderer = renderer_of(scene)
    culling = None
    if _is_one_piece(scene, select):
        assert isinstance(select, SelectOptions)
        traced = renderer.trace(camera, options, select, contributions=contributions)
        notes = notes_on(select.pixel_error, select.radius, options.dilation_px2)
        selection = Selection(traced.rows, select.rule, select.radius, select.pixel_error, traced.num_visited, notes)
        times = traced.milliseconds, traced.cpu_milliseconds
    else:
        dilation, threshold = options.dilation_px2, options.least_threshold
        start, cpu = time.perf_counter(), time.process_time()
        if isinstance(select, SelectOptions):
            culling = cull_scene(
                scene, camera, select, dilation_px2=dilation, threshold=threshold, tile_rule=options.tile_rule
            )
            selection = select_rows(scene, camera, select, dilation_px2=dilation, threshold=threshold, culling=culling)
        else:
            selection = select(camera, dilation_px2=dilation, threshold=threshold)
        chosen = [{"select": 1e3 * took} for took in (time.perf_counter() - start, time.process_time() - cpu)]
        traced = renderer.trace(camera, options, SelectOptions(), rows=selection.rows, contributions=contributions)
        times = chosen[0] | traced.milliseconds, chosen[1] | traced.cpu_milliseconds
    picture = traced.picture
    result = _result(picture, len(selection), len(traced.splats), traced.bins.num_pairs, *times)
    return Frame(camera, culling, selection, traced.splats, traced.bins, picture.tiles, result, picture.contributions)


def _is_one_piece(scene: Scene, select: SelectOptions | Selector) -> bool:
    """Whether the device chooses the rows on its own; it leaves out blocks, so clusters left out exactly add nothing."""
    return (
        isinstance(select, SelectOptions)
        and select.rule == "cut"
        and select.budget is None
        and select.max_radius is None
        and cull_rule(scene, select) in ("none", "exact")
    )


def _result(
    picture: Picture,
    num_selected: int,
    num_visible: int,
    num_pairs: int,
    milliseconds: dict[str, float],
    cpu_milliseconds: dict[str, float],
) -> RenderResult:
    counters = Counters(num_selected, num_visible, num_pairs, picture.num_evaluated, picture.num_blended)
    return RenderResult(picture.image, picture.alpha, picture.depth, counters, milliseconds, cpu_milliseconds)
