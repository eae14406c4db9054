"""Choose τ, the opacity at which splats end, for a scene and its training views.

Policies (FilterGS 2026, §3.3, Eq. 8; G is the mean contribution of a pair, render/contribution.py):

- ``target`` (default): the largest τ whose mean loss of PSNR is within a budget in dB, over the nearer half of the views and over
  the farther half, by bisection: far views, which lose little, then do not pay for near ones;
- ``worst``: the largest τ at which no view loses more than the budget, so that near and far views keep the same promise;
- ``paper``: τ = λ_G / G, as Eq. 8 says: crowded scenes, where G is small, are shrunk more;
- ``release``: τ = λ_G · G, as the code of FilterGS computes: crowded scenes are shrunk less;
- ``fixed``: the render option ``threshold``, or 1/255.

Unless another tile rule is asked for, ``target`` and ``worst`` take `balanced`, the others the same τ for all splats, `ellipse`.
No τ goes below 1/255, down to which the blend draws anyway, nor above 0.5.

Views are near or far by the mean depth of what they see; the middle one is in both halves, and views of nothing are in none.

What a loss of x dB means. With photographs: the mean over views of PSNR(lossless, photo) − PSNR(shrunk, photo). Without: the
lossless picture is taken to be Q dB from the truth (``scene_psnr``), and the error of shrinking independent of that one, so that
their squares add up: a view that is P dB from its lossless picture loses

    10 log10(1 + 10^((Q − P) / 10)) dB

With Q = 30 a loss of 0.1 dB is reached at P = 46.3 dB.

Cost: one lossless drawing of each view, and one more at each of up to ten trials of τ. Lossless pictures are kept where there
are no photographs: 12 bytes a pixel and view, 24 views of 960 × 540 px take 150 MB.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from splatree.errors import InputError
from splatree.kernels.devices import DeviceName
from splatree.outofcore.store import Store
from splatree.progress import task
from splatree.render.calibration import CalibrateOptions, Calibration
from splatree.render.session import open_session
from splatree.render.studio import BISECTIONS, FOUND_BY_LOSS, Studio
from splatree.scene.arguments import checked
from splatree.scene.cameras import Camera, several
from splatree.scene.given import given
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.scene.scene import Scene, TileRule
from splatree.shapes import Array

__all__ = ["calibrate"]


@checked
def calibrate(
    scene: Scene | Store,
    cameras: Iterable[Camera],
    options: CalibrateOptions | None = None,
    render: RenderOptions | None = None,
    select: SelectOptions | None = None,
    *,
    photos: Mapping[str, Array] | None = None,
    device: DeviceName | None = None,
    threads: int = 0,
) -> Calibration:
    """Choose τ, the opacity at which splats end, for a scene.

    τ depends on the size of the pictures and on the level of detail: calibrate with what will be drawn.

    Args:
        scene: any scene, or a store, of which the pages are read that the views need.
        cameras: views like those that will be drawn; those of the training if there are photographs. Keep views apart that
            will be scored.
        options: policy and its parameters; None: a loss of 0.1 dB.
        render: how the views are drawn, beside τ.
        select: which nodes are drawn.
        photos: photographs by the camera's name, float32 (h w 3). If there are any, only views that have one are drawn.
        device: where: `cpu`, `cuda` or `reference`; None: `cpu`.
        threads: threads of the processor; 0: all.

    Returns:
        τ with its loss, pairs, views and options; `calibrated` stores it in the scene.

    Raises:
        InputError: there is no view, or the tile rule is `3sigma`, which does not depend on τ.

    Source:
        FilterGS 2026, §3.3, Eq. 8, for the policies `paper` and `release`; docs/explanation/shrinking.md.

    Example:
        >>> found = st.calibrate(scene, cameras)
        >>> found.loss_db <= 0.1
        True
    """
    options = given(options, CalibrateOptions, "calibrate: options")
    render, select = (
        given(render, RenderOptions, "calibrate: render"),
        given(select, SelectOptions, "calibrate: select"),
    )
    if render.tile_rule == "3sigma":
        raise InputError("tile_rule: found '3sigma', which does not depend on τ; wanted another")
    tile_rule: TileRule = render.tile_rule or ("balanced" if options.policy in FOUND_BY_LOSS else "ellipse")
    render = replace(render, tile_rule=tile_rule)
    cameras = several(cameras)
    with_photo = [camera for camera in cameras if camera.name in photos] if photos else list(cameras)
    if not with_photo:
        found = f"{len(cameras)} views, none with a photograph" if cameras else "no view"
        raise InputError(f"calibrate: found {found}, wanted at least one view to draw")
    chosen = np.unique(np.linspace(0, len(with_photo) - 1, min(options.max_views, len(with_photo))).round().astype(int))
    views = [with_photo[i] for i in chosen]
    with open_session(scene, device=device, select=select, threads=threads) as session:
        studio = Studio(session, views, options, render, photos or {})
        with task("calibrate", total=len(views) * (BISECTIONS + 2)) as studio.advance:
            studio.draw_lossless()
            best, trials = studio.choose()
    return Calibration(
        policy=options.policy,
        threshold=best.threshold,
        loss_db=best.loss_db,
        worst_loss_db=best.worst_loss_db,
        worst_view=best.worst_view,
        psnr=best.psnr,
        num_pairs=best.num_pairs,
        num_pairs_lossless=studio.num_pairs_lossless,
        contribution=studio.contribution,
        photographs=bool(photos),
        views=tuple(view.name or str(number) for number, view in zip(chosen, views, strict=True)),
        size_px=(views[0].width, views[0].height),
        options=options,
        tile_rule=tile_rule,
        pixels=render.pixels,
        pixel_error=select.pixel_error if select.quality is None else None,
        trials=tuple(trials),
    )
