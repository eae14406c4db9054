"""What another implementation makes of real Gaussians: gsplat's pure-torch functions (make_gsplat_arrays.py)."""

from pathlib import Path

import numpy as np
import pytest

import splatree as st
from splatree.kernels.devices import stages_of

ARRAYS = Path(__file__).with_name("gsplat.npz")
MODES = ("classic", "antialiased")


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    with np.load(ARRAYS) as stored:
        return dict(stored)


def scene_of(arrays: dict[str, np.ndarray], mode: str) -> tuple[st.Scene, st.Camera]:
    columns = (arrays[name] for name in ("means", "quats", "log_scales", "logit_opacities", "sh"))
    width, height = arrays["size"].tolist()
    camera = st.Camera(arrays["camera_from_world"], arrays["K"], width, height)
    return st.Scene.flat(st.Gaussians(*columns), mode=mode), camera  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_splats_agree(arrays: dict[str, np.ndarray], mode: str, backend: str) -> None:
    scene, camera = scene_of(arrays, mode)
    splats = stages_of(backend).project(
        scene.gaussians, None, np.arange(len(scene), dtype=np.int32), st.View(camera, mode=scene.mode)
    )
    assert len(splats) > 150
    wanted = {
        name: arrays[f"{mode}_{name}"][splats.rows] for name in ("means_px", "conics", "depths", "opacities", "colors")
    }
    # Float32 on this side, and where the arrays were stored; positions and conics of splats up to 100 px long.
    np.testing.assert_allclose(splats.means_px, wanted["means_px"], rtol=2e-6, atol=1e-4)
    np.testing.assert_allclose(splats.depths, wanted["depths"], rtol=2e-6)
    np.testing.assert_allclose(splats.opacities, wanted["opacities"], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(splats.colors, wanted["colors"], atol=5e-6)
    size = np.abs(wanted["conics"]).max(axis=1, keepdims=True)
    assert np.all(np.abs(splats.conics - wanted["conics"]) <= 2e-5 * size)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_pictures_agree(arrays: dict[str, np.ndarray], mode: str, backend: str) -> None:
    scene, camera = scene_of(arrays, mode)
    result = st.render(scene, camera, select=st.SelectOptions(pixel_error=0), device=backend)
    assert arrays[f"{mode}_alpha"].mean() > 0.3  # a picture, not an empty one
    # Both leave out α < 1/255 and stop before T < 1e-4; a pair at these steps may fall either way, and changes a pixel by at
    # most 1/255 of the brightest colour. Everywhere else only float32 rounding remains.
    difference = np.abs(result.image - arrays[f"{mode}_image"]).max(axis=-1)
    assert difference.max() < arrays[f"{mode}_colors"].max() * 1.5 / 255
    assert np.mean(difference > 1e-5) < 0.002
    assert np.mean(np.abs(result.alpha - arrays[f"{mode}_alpha"]) > 1e-5) < 0.002
    assert st.psnr(result.image, arrays[f"{mode}_image"]) > 110
