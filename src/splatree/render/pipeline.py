"""One view at a time: `render` and `trace` open a session, draw and close it.

A frame is cull → select → project → bin → blend (render/session.py). Programs that draw many views of a scene open a session
themselves: it makes the copies on a device, the arrays of a frame and the index of the scene once.
"""

from splatree.kernels.devices import DeviceName
from splatree.lod.select import Selector
from splatree.outofcore.store import Store
from splatree.render.session import NOTHING, open_session
from splatree.render.tensors import TensorScene
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera
from splatree.scene.frame import Frame, RenderResult
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import Wanted

__all__ = ["render", "trace"]


@checked
def render(
    scene: Scene | TensorScene | Store,
    camera: Camera,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    device: DeviceName | None = None,
    threads: int = 0,
) -> RenderResult:
    """Draw a view of a scene.

    Args:
        scene: what is drawn; or a store, which is read page by page.
        camera: the view.
        options: how it is drawn.
        select: which nodes are drawn: options, or a baseline (lod/baselines.py); all leaves with
            ``SelectOptions(pixel_error=0)``.
        device: where: `cpu`, `cuda`, or `reference`, the definitions in NumPy, which are slow; None: `cpu`, or the device that
            the scene's tensors lie on.
        threads: threads of the processor; 0 means all there are. The picture has the same bits for any number.

    Returns:
        The picture, with counters and times.

    Raises:
        InputError: there is no such device, or a budget of nodes cannot be met.
        DeviceError: the device is not there, has failed, or has too little memory.

    Source: Kerbl 2023, the rasterizer of 3D Gaussian Splatting.

    Example:
        >>> image = st.render(scene, camera).image
        >>> image.shape == (camera.height, camera.width, 3)
        True
    """
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        return session.draw(camera)


@checked
def trace(
    scene: Scene | TensorScene | Store,
    camera: Camera,
    options: RenderOptions | None = None,
    select: SelectOptions | Selector | None = None,
    *,
    wanted: Wanted = NOTHING,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Frame:
    """Draw a view like `render` and keep what each stage computed.

    Args:
        scene: what is drawn; or a store, which is read page by page.
        camera: the view.
        options: how it is drawn.
        select: which nodes are drawn: options, or a baseline.
        wanted: outputs of the blend beside colour, alpha and depth.
        device: where; as in `render`.
        threads: threads of the processor; 0 means all there are.

    Returns:
        Selection, splats, tile lists, picture and times.

    Raises:
        InputError: there is no such device, or a budget of nodes cannot be met.
        DeviceError: the device is not there, has failed, or has too little memory.

    Example:
        >>> frame = st.trace(scene, camera, wanted=st.Wanted(contributions=True))
        >>> len(frame.contributions) == frame.bins.num_pairs
        True
    """
    with open_session(scene, device=device, options=options, select=select, threads=threads) as session:
        return session.trace(camera, wanted)
