"""Other renderers beside ours on the same Gaussians and camera, each where it is installed with a torch that finds a GPU.

- *original*: the rasterizer of Kerbl 2023, which gaussian-splatting on PyPI brings compiled (2.11; its licence allows research
  and evaluation). It leaves out what is nearer than 0.2 units.
- *gsplat classic*: `gsplat.rasterization`.
- *gsplat inference* (HiGS, gsplat 1.6, May 2026) packs a scene into half floats once and draws through
  `GaussianInferenceRenderer`, which keeps its buffers from frame to frame, on tiles of 8 or 16 pixels; harmonics of degree 3 may
  be packed into 32 or 16 bytes. PyPI has 1.5.3, without it: a wheel or checkout of the main branch has both. Both compile at
  first use, which takes minutes and is not measured.

Whatever is absent has a row that says why.
"""

import statistics
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

import splatree as st

__all__ = ["peer_rows"]


def peer_rows(
    scene: st.Scene, camera: st.Camera, ours_ms: dict[str, float], *, repeat: int, frames: int
) -> Iterator[dict[str, Any]]:
    """A row a path, with PSNR to our picture of all leaves, and how many times as fast our frames of the run are."""
    row: dict[str, Any] = {"what": "peer", "scene": "city, leaves", "view": f"{camera.width} × {camera.height}"}
    try:
        import torch
    except ImportError as error:
        yield row | {"absent": str(error)}
        return
    if not torch.cuda.is_available():
        yield row | {"absent": "torch finds no GPU"}
        return
    ours = st.render(scene, camera, select=st.SelectOptions(pixel_error=0.0)).image
    tensors = {name: torch.from_numpy(getattr(scene.gaussians, name)).cuda() for name in COLUMNS}
    view = {
        "viewmat": torch.from_numpy(camera.camera_from_world.astype(np.float32)).cuda(),
        "K": torch.from_numpy(camera.K.astype(np.float32)).cuda(),
    }
    with torch.inference_mode():
        for name, prepare in _paths(scene, camera, tensors, view).items():
            try:
                draw = prepare()
                image = draw().float().cpu().numpy()
                torch.cuda.reset_peak_memory_stats()
                frame = _median_ms(torch, draw, repeat, frames)
            except Exception as error:  # a peer that does not compile must not take our figures with it
                yield row | {"path": name, "absent": f"{type(error).__name__}: {error}"[:200]}
                continue
            yield row | {
                "path": name,
                "frame ms": frame,
                "FPS": 1e3 / frame,
                "dB to the processor": st.psnr(image, ours),
                "MB held": torch.cuda.max_memory_allocated() / 1e6,
                **{f"{drawn}: ours × as fast": frame / ms for drawn, ms in ours_ms.items()},
                "version": version("gsplat" if "gsplat" in name else "gaussian-splatting"),
            }


COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")


def _paths(
    scene: st.Scene, camera: st.Camera, tensors: dict[str, Any], view: dict[str, Any]
) -> dict[str, Callable[[], Callable[[], Any]]]:
    """What prepares each path by name, and gives what draws its picture."""
    import torch

    g = scene.gaussians
    means, sh = tensors["means"], tensors["sh"]
    quats = torch.nn.functional.normalize(tensors["quats"], dim=-1)
    scales, opacities = tensors["log_scales"].exp(), tensors["logit_opacities"].sigmoid()

    def original() -> Callable[[], Any]:
        from gaussian_splatting.diff_gaussian_rasterization import GaussianRasterizationSettings, GaussianRasterizer

        near, far = 0.01, 1000.0  # of the clip space, in which nothing is clipped by depth
        tan_x, tan_y = camera.width / (2 * camera.K[0, 0]), camera.height / (2 * camera.K[1, 1])
        clip_from_camera = np.array(
            [
                [1 / tan_x, 0, 0, 0],
                [0, 1 / tan_y, 0, 0],
                [0, 0, far / (far - near), -far * near / (far - near)],
                [0, 0, 1, 0],
            ]
        )
        transforms = (camera.camera_from_world, clip_from_camera @ camera.camera_from_world)
        transposed = [torch.from_numpy(t.T.astype(np.float32).copy()).cuda() for t in transforms]
        eye = torch.from_numpy(camera.position.astype(np.float32)).cuda()
        settings = GaussianRasterizationSettings(
            *(camera.height, camera.width, tan_x, tan_y, torch.zeros(3).cuda(), 1.0, *transposed, g.sh_degree, eye),
            prefiltered=False, debug=False, antialiasing=scene.mode == "antialiased",
        )  # fmt: skip
        draw = GaussianRasterizer(settings)
        columns = {"shs": sh, "scales": scales, "rotations": quats, "opacities": opacities[:, None]}
        return lambda: draw(means3D=means, means2D=torch.zeros_like(means), **columns)[0].permute(1, 2, 0)

    def classic() -> Callable[[], Any]:
        import gsplat

        return lambda: gsplat.rasterization(
            means, quats, scales, opacities, sh, view["viewmat"][None], view["K"][None], camera.width, camera.height,
            sh_degree=g.sh_degree, near_plane=camera.near, packed=False, rasterize_mode=scene.mode,
        )[0][0]  # fmt: skip

    def inference(packing: str, tile: int) -> Callable[[], Any]:
        from gsplat.experimental import GaussianInferenceRenderer, GaussianInferenceScene

        if scene.mode != "classic":
            raise ValueError(f"it draws scenes of mode classic alone, this one is {scene.mode}")
        packed = GaussianInferenceScene.from_gaussian_tensors(
            means, quats, scales, opacities, sh, g.sh_degree, packing, id=packing
        )
        renderer = GaussianInferenceRenderer(packed, tile_size=tile)
        size = {"width": camera.width, "height": camera.height, "near_plane": camera.near}
        return lambda: renderer.render(**view, **size).frame[0, :, :, :3]

    packings = ("none", "32b", "16b") if g.sh_degree == 3 else ("none",)
    return {"original": original, "gsplat classic": classic} | {
        f"gsplat inference, harmonics {packing}, tiles of {tile}": partial(inference, packing, tile)
        for packing in packings
        for tile in (8, 16)
    }


def _median_ms(torch: Any, draw: Callable[[], Any], repeat: int, frames: int) -> float:
    took = []
    for _ in range(repeat):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        for _ in range(frames):
            draw()
        end.record()
        end.synchronize()
        took.append(start.elapsed_time(end) / frames)
    return statistics.median(took)
