"""How much a picture jumps when levels switch under a camera that moves.

A camera moves from frame k − 1 to frame k. Two things change: what it sees, and the nodes that are drawn. Frame k is therefore
drawn twice: with its own cut, and with the cut of frame k − 1. The difference of these two pictures is the *pop* of frame k, and
nothing of the motion is in it. Both cuts are whole, so what comes into view is in both.

A mean over the picture hides a jump of one house front. Each pop is therefore also measured by the tile of 16 × 16 px in which
the mean change is largest.

Cost: a frame is selected twice and drawn twice.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from splatree.constants import TILE_PX
from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.metrics.psnr import psnr
from splatree.progress import track
from splatree.render.session import Session, open_session
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, Cameras, several
from splatree.scene.frame import Selection
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene
from splatree.scene.view import View
from splatree.shapes import Array

__all__ = ["CHANGE_SEEN", "Pop", "dolly", "measure_pops"]

CHANGE_SEEN = 4 / 255
"""Change of a channel above which a pixel counts as changed: four steps of an 8-bit picture."""


@dataclass(frozen=True)
class Pop:
    """What switching levels changes in one frame.

    Example:
        >>> pops = st.measure_pops(scene, st.dolly(scene, camera, 4))
        >>> len(pops), all(pop.tile_change <= pop.pixel_change for pop in pops)
        (3, True)
    """

    camera: str
    """Name of the frame's camera."""
    psnr: float
    """PSNR of the picture of the frame's own cut against that of the cut before, dB; infinity if nothing changes."""
    changed: float
    """Share of the pixels of which a channel changes by more than 4/255."""
    pixel_change: float
    """Largest change of a channel of one pixel, 0 to 1."""
    tile_change: float
    """Largest mean change of a tile of 16 × 16 px, 0 to 1."""
    tile_px: tuple[int, int]
    """Left and upper edge of that tile, px."""
    num_nodes: int
    """Nodes of the frame's own cut, in view or not."""
    num_switched: int
    """Nodes of it that are not in the cut before."""


@checked
def dolly(scene: Scene, camera: Camera, frames: int, *, step: float = 0.01) -> Cameras:
    """A camera that moves slowly forwards: each frame it covers a share of the distance to what it looks at.

    The distance is the median depth of the first picture, of all leaves.

    Args:
        scene: what is looked at.
        camera: the first frame.
        frames: number of frames.
        step: share of the distance that is left, covered from one frame to the next; negative: it moves back.

    Returns:
        The frames, named after the camera.

    Raises:
        InputError: fewer than two frames, a step of 1 and more, or nothing is in view.

    Example:
        >>> path = st.dolly(scene, camera, 3, step=0.1)
        >>> [view.name.split("_")[-1] for view in path]
        ['0000', '0001', '0002']
    """
    if frames < 2:
        raise InputError(f"frames: found {frames}, wanted at least 2")
    if not -1 < step < 1 or step == 0:
        raise InputError(f"step: found {step:g}, wanted a share of the distance between -1 and 1, not 0")
    with open_session(scene, select=SelectOptions(pixel_error=0.0)) as session:
        picture = session.draw(camera)
    seen = picture.alpha > 0.5
    if not seen.any():
        raise InputError(f"dolly: camera {camera.name!r}: found nothing in view, wanted something to move towards")
    distance = float(np.median(picture.depth[seen]))
    path = []
    for frame in range(frames):
        pose = camera.camera_from_world.copy()
        pose[2, 3] -= distance * (1 - (1 - step) ** frame)
        path.append(replace(camera, camera_from_world=pose, name=f"{camera.name or 'frame'}_{frame:04d}"))
    return Cameras(tuple(path))


@checked
def measure_pops(
    scene: Scene,
    cameras: Iterable[Camera],
    select: SelectOptions | None = None,
    render: RenderOptions | None = None,
    *,
    device: DeviceName | None = None,
    threads: int = 0,
) -> tuple[Pop, ...]:
    """Measure how much switching levels changes each frame of a moving camera.

    Args:
        scene: a scene with levels.
        cameras: the frames in order, as `dolly` makes them.
        select: pixel error or budget of each frame, or a quality of the first, whose τ_R is kept; None: the defaults.
        render: how the frames are drawn.
        device: where: `cpu`, `cuda` or `reference`; None: `cpu`.
        threads: threads of the processor; 0: all.

    Returns:
        The pop of each frame but the first.

    Raises:
        InputError: fewer than two cameras, or a rule of selection that does not select a cut.

    Example:
        >>> pops = st.measure_pops(scene, st.dolly(scene, camera, 3), st.SelectOptions(pixel_error=0))
        >>> [pop.psnr for pop in pops]
        [inf, inf]
    """
    select = select or SelectOptions()
    frames = several(cameras)
    if len(frames) < 2:
        raise InputError(f"cameras: found {len(frames)}, wanted at least two frames")
    if select.rule != "cut":
        raise InputError(
            f"rule: found {select.rule!r}, wanted 'cut': other rules have no cut that covers the next view"
        )
    pops = []
    with open_session(scene, device=device, options=render, threads=threads) as session:
        if select.quality is not None:
            found = session.select(frames[0], select=replace(select, budget=None)).pixel_error
            select = replace(select, quality=None, pixel_error=found)
        before = _cut(session, frames[0], select)
        for camera in track(frames[1:], "pops"):
            own = _cut(session, camera, select)
            one, other = (np.clip(session.draw(camera, select=_Fixed(cut)).image, 0, 1) for cut in (own, before))
            switched = len(own.rows) - len(np.intersect1d(own.rows, before.rows, assume_unique=True))
            pops.append(_pop(camera, one, other, (len(own.rows), switched)))
            before = own
    return tuple(pops)


def _cut(session: Session, camera: Camera, select: SelectOptions) -> Selection:
    """All nodes of the cut of a view, in view or not; a budget is met by what is in view."""
    pixel_error = select.pixel_error
    if select.budget is not None:
        pixel_error = session.select(camera, select=select).pixel_error
    whole = replace(select, pixel_error=pixel_error, budget=None, view_test="none", cull="none")
    return session.select(camera, select=whole)


@dataclass(frozen=True)
class _Fixed:
    """A selector that draws one cut in any view."""

    cut: Selection

    def __call__(self, view: View, *, threads: int = 0) -> Selection:
        return self.cut


def _pop(camera: Camera, own: Array, before: Array, counts: tuple[int, int]) -> Pop:
    change = np.abs(own.astype(np.float64) - before)
    tops, lefts = (np.arange(0, size, TILE_PX) for size in change.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(change.mean(axis=2), tops, axis=0), lefts, axis=1)
    sizes = np.outer(*(np.diff(edges, append=size) for edges, size in ((tops, len(change)), (lefts, change.shape[1]))))
    means = sums / sizes
    row, column = np.unravel_index(int(means.argmax()), means.shape)
    return Pop(
        camera=camera.name,
        psnr=psnr(own, before),
        changed=float((change.max(axis=2) > CHANGE_SEEN).mean()),
        pixel_change=float(change.max()),
        tile_change=float(means[row, column]),
        tile_px=(int(lefts[column]), int(tops[row])),
        num_nodes=counts[0],
        num_switched=counts[1],
    )
