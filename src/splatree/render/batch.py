"""Many views of one scene, drawn one at a time in one session: memory holds only the view in work."""

from collections.abc import Iterable, Iterator

from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.outofcore.store import Store
from splatree.progress import track
from splatree.render.session import NOTHING, open_session
from splatree.render.tensors import TensorScene
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, several
from splatree.scene.frame import Frame, RenderResult
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import Wanted

__all__ = ["render_batch", "trace_batch"]


@checked
def render_batch(
    scene: Scene | TensorScene | Store,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Iterator[RenderResult]:
    """Draw many views, one at a time and in order.

    Args:
        scene: what is drawn; or a store, which is read page by page.
        cameras: the views.
        options: how they are drawn.
        select: which nodes are drawn: options, or a baseline.
        device: where; as in `render`.
        threads: threads of the processor; 0 means all there are.

    Yields:
        The picture of each view.

    Raises:
        InputError: there is no such device, or a budget of nodes cannot be met.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example:
        >>> len(list(st.render_batch(scene, cameras))) == len(cameras)
        True
    """
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        for camera in track(several(cameras), "render views"):
            yield session.draw(camera)


@checked
def trace_batch(
    scene: Scene | TensorScene | Store,
    cameras: Iterable[Camera],
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    wanted: Wanted = NOTHING,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Iterator[Frame]:
    """Draw many views, one at a time and in order, and keep what each stage computed.

    Args:
        scene: what is drawn; or a store, which is read page by page.
        cameras: the views.
        options: how they are drawn.
        select: which nodes are drawn: options, or a baseline.
        wanted: outputs of the blend beside colour, alpha and depth.
        device: where; as in `render`.
        threads: threads of the processor; 0 means all there are.

    Yields:
        The frame of each view.

    Raises:
        InputError: there is no such device, or a budget of nodes cannot be met.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example:
        >>> sum(frame.bins.num_pairs for frame in st.trace_batch(scene, cameras)) > 0
        True
    """
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        for camera in track(several(cameras), "render views"):
            yield session.trace(camera, wanted)
