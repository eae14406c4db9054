"""Make gsplat.npz: a few hundred real Gaussians as another implementation sees and blends them.

The functions are the pure-torch ones of gsplat (Apache-2.0, https://github.com/nerfstudio-project/gsplat), version 1.5.3, in
float64. Which splats blend at which pixel gsplat finds on the GPU only; `pairs` says it here: α at least 1/255, nearest
first, until less than 1e-4 of the light would pass. gsplat needs the package nerfacc to sum along rays, also on the GPU only;
`sums_along_rays` stands in for it.

The Gaussians are a choice from the bundled piece of "KARANGKIDUL KOTA SEMARANG 2" by Samuel Hiero (CC BY 4.0).

In an environment of its own: pip install torch==2.13.0 gsplat==1.5.3, splatree; python tests/golden/make_gsplat_arrays.py
"""

import sys
import types
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from gsplat.cuda._torch_impl import (
    _fully_fused_projection,
    _quat_scale_to_covar_preci,
    _spherical_harmonics,
    accumulate,
)

import splatree as st

NUM = 260
WIDTH, HEIGHT = 64, 48


def main() -> None:
    scene = st.read(str(files("splatree") / "data" / "semarang_5_9.sog"))
    middle = np.median(scene.gaussians.means, axis=0).astype(np.float64)
    camera = st.Camera.look_at(middle + [6, -14, -18], middle, width=WIDTH, height=HEIGHT)
    K = camera.K.copy()
    K[0, 2] += 9.25  # off-centre
    camera = st.Camera(camera.camera_from_world, K, WIDTH, HEIGHT)
    g = scene.gaussians.take(choose(scene.gaussians, camera))
    g.logit_opacities[:] = np.minimum(g.logit_opacities, 3.8)  # below 0.98: gsplat holds α at 0.999, 3DGS at 0.99
    arrays = {name: getattr(g, name) for name in ("means", "quats", "log_scales", "logit_opacities", "sh")}
    arrays |= {"camera_from_world": camera.camera_from_world, "K": K, "size": np.array([WIDTH, HEIGHT])}
    for mode in ("classic", "antialiased"):
        arrays |= {f"{mode}_{name}": value for name, value in seen(g, camera, mode).items()}
    path = Path(__file__).with_name("gsplat.npz")
    np.savez_compressed(path, **arrays)
    print(path.name, path.stat().st_size, "bytes;", len(g), "Gaussians")  # noqa: T201


def choose(g: st.Gaussians, camera: st.Camera) -> np.ndarray:
    """Rows in view, of different sizes: some outside of the image, sub-pixel ones, and large ones in front."""
    points = g.means.astype(np.float64) @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    x, y, z = points.T
    with np.errstate(all="ignore"):
        px, py = camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]
    size = camera.K[0, 0] * np.exp(g.log_scales.max(axis=1)) / z
    near = (z > 0.5) & (np.abs(px - WIDTH / 2) < 0.6 * WIDTH) & (np.abs(py - HEIGHT / 2) < 0.6 * HEIGHT) & (size < 20)
    rows = np.flatnonzero(near)
    order = rows[np.argsort(-size[rows])]
    rng = np.random.default_rng(0)
    return np.sort(np.concatenate([order[: NUM // 2], rng.choice(order[NUM // 2 :], NUM - NUM // 2, replace=False)]))


def seen(g: st.Gaussians, camera: st.Camera, mode: str) -> dict[str, np.ndarray]:
    means, quats, scales, sh = (
        torch.tensor(np.asarray(a, np.float64))
        for a in (g.means, g.quats, np.exp(g.log_scales.astype(np.float64)), g.sh)
    )
    opacities = torch.sigmoid(torch.tensor(g.logit_opacities.astype(np.float64)))
    view, K = torch.tensor(camera.camera_from_world), torch.tensor(camera.K)
    covariances, _ = _quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    radii, means2d, depths, conics, compensations = _fully_fused_projection(
        means, covariances, view[None], K[None], WIDTH, HEIGHT, near_plane=camera.near, calc_compensations=True
    )
    colors = torch.clamp_min(_spherical_harmonics(3, means - torch.tensor(camera.position), sh) + 0.5, 0.0)
    if mode == "antialiased":
        opacities = opacities * compensations[0]
    gaussians, pixels = pairs(means2d[0], conics[0], opacities, torch.where(radii[0, :, 0] > 0, depths[0], torch.inf))
    image, alpha = accumulate(
        means2d, conics, opacities[None], colors[None], gaussians, pixels, torch.zeros_like(pixels), WIDTH, HEIGHT
    )
    results = {"means_px": means2d, "conics": conics, "depths": depths, "opacities": opacities, "colors": colors}
    results |= {"image": image, "alpha": alpha[..., 0]}
    return {name: value.squeeze(0).numpy().astype(np.float32) for name, value in results.items()}


def pairs(means: torch.Tensor, conics: torch.Tensor, opacities: torch.Tensor, depths: torch.Tensor):
    """Splats and pixels that blend, pixel by pixel and nearest first."""
    order = torch.argsort(depths)[: int(torch.isfinite(depths).sum())]
    y, x = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    centres = torch.stack([x, y], -1).reshape(-1, 1, 2) + 0.5
    d = centres - means[order]
    a, b, c = conics[order].T
    alpha = opacities[order] * torch.exp(-0.5 * (a * d[..., 0] ** 2 + c * d[..., 1] ** 2) - b * d[..., 0] * d[..., 1])
    alpha = torch.where(alpha >= 1 / 255, alpha, 0.0)
    left = torch.cumprod(1 - alpha, dim=1)
    pixels, places = torch.nonzero((alpha > 0) & (left >= 1e-4), as_tuple=True)
    return order[places], pixels


def sums_along_rays() -> types.ModuleType:
    """The two functions of nerfacc that gsplat's `accumulate` imports."""
    module = types.ModuleType("nerfacc")

    def render_weight_from_alpha(alphas, ray_indices, n_rays):
        weights, left = torch.empty_like(alphas), torch.ones(n_rays, dtype=alphas.dtype)
        for i, (alpha, ray) in enumerate(zip(alphas.tolist(), ray_indices.tolist(), strict=True)):
            weights[i] = left[ray] * alpha
            left[ray] *= 1 - alpha
        return weights, None

    def accumulate_along_rays(weights, values, ray_indices, n_rays):
        terms = weights[:, None] if values is None else weights[:, None] * values
        return torch.zeros(n_rays, terms.shape[1], dtype=terms.dtype).index_add_(0, ray_indices, terms)

    module.render_weight_from_alpha = render_weight_from_alpha
    module.accumulate_along_rays = accumulate_along_rays
    return module


if __name__ == "__main__":
    sys.modules["nerfacc"] = sums_along_rays()
    main()
