"""The bundled piece of a real city, against the float64 reference."""

from importlib.resources import files

import numpy as np
import pytest

import splatree as st


@pytest.fixture(scope="module")
def city() -> st.Scene:
    return st.read(str(files("splatree") / "data" / "semarang_5_9.sog"))


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_a_crop_is_that_of_the_reference(city: st.Scene, mode: str) -> None:
    middle = np.median(city.gaussians.means, axis=0).astype(np.float64)
    camera = st.Camera.look_at(middle + [4, -9, -12], middle, width=56, height=40, fov_y_deg=9)
    options, leaves = st.RenderOptions(mode=mode), st.SelectOptions(pixel_error=0)  # type: ignore[arg-type]
    fast = st.render(city, camera, options, leaves)
    slow = st.render(city, camera, options, leaves, device="reference")
    assert slow.counters.num_visible > 300 and slow.alpha.mean() > 0.5  # there is something to compare
    # The goal is 60 dB; float32 alone leaves about 130, steps that fall either way less.
    assert st.psnr(fast.image, slow.image) > 85
    assert np.abs(fast.image - slow.image).max() < 0.02
