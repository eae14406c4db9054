import numpy as np

import splatree as st


def cloud(n: int, seed: int, degree: int = 3) -> st.Gaussians:
    """A random cloud of unit size around the origin."""
    rng = np.random.default_rng(seed)
    return st.Gaussians(
        means=rng.normal(size=(n, 3)).astype(np.float32),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        log_scales=rng.uniform(-5, -1.5, (n, 3)).astype(np.float32),
        logit_opacities=rng.normal(0, 2, n).astype(np.float32),
        sh=(0.3 * rng.normal(size=(n, (degree + 1) ** 2, 3))).astype(np.float32),
    )


CAMERA = st.Camera.look_at((0.3, -0.5, -4), (0, 0, 0), width=83, height=53)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2)))


def test_picture_is_that_of_the_reference() -> None:
    scene = st.Scene.flat(cloud(600, 1))
    for mode in ("classic", "antialiased"):
        options = st.RenderOptions(background=(0.1, 0.2, 0.3), mode=mode)
        fast = st.render(scene, CAMERA, options)
        slow = st.render(scene, CAMERA, options, backend="reference")
        # Float32 rounding alone is about 130 dB; a pixel of a pair at τ or at a full pixel may fall either way.
        assert psnr(fast.image, slow.image) > 90
        assert fast.counters.num_visible == slow.counters.num_visible
