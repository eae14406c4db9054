"""Many views of one scene, drawn one at a time: memory holds only the view in work."""

from collections.abc import Iterable, Iterator

from splatree.lod.blocks import with_blocks
from splatree.progress import track
from splatree.render.pipeline import trace
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame, RenderResult
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene

__all__ = ["render_batch", "trace_batch"]


def render_batch(
    scene: Scene,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | None = None,
    *,
    threads: int = 0,
) -> Iterator[RenderResult]:
    """Yield the picture of each view, in order."""
    for frame in trace_batch(scene, cameras, options, select, threads=threads):
        yield frame.result


def trace_batch(
    scene: Scene,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | None = None,
    *,
    threads: int = 0,
) -> Iterator[Frame]:
    """Yield each view, in order, with what each stage computed."""
    scene = with_blocks(scene, threads=threads)
    for camera in track(list(cameras), "render views"):
        yield trace(scene, camera, options, select, threads=threads)
