"""Many views of one scene, drawn one at a time in one session: memory holds only the view in work."""

from collections.abc import Iterable, Iterator

from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.progress import track
from splatree.render.session import NOTHING, open_session
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame, RenderResult
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import Wanted

__all__ = ["render_batch", "trace_batch"]


def render_batch(
    scene: Scene,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Iterator[RenderResult]:
    """Yield the picture of each view, in order; arguments as of `render`."""
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        for camera in track(list(cameras), "render views"):
            yield session.draw(camera)


def trace_batch(
    scene: Scene,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    wanted: Wanted = NOTHING,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Iterator[Frame]:
    """Yield each view, in order, with what each stage computed; arguments as of `trace`."""
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        for camera in track(list(cameras), "render views"):
            yield session.trace(camera, wanted)
