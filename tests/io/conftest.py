"""Small scenes, and where the shared real ones lie."""

from pathlib import Path

import numpy as np
import pytest

from splatree import Gaussians

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture
def data() -> Path:
    """The folder of shared real scenes."""
    if not DATA.is_dir():
        pytest.skip("needs the real scenes of ../shared/data")
    return DATA


def random_gaussians(n: int, degree: int = 3, seed: int = 0) -> Gaussians:
    """Gaussians like those of a trained scene: unnormalised quaternions, scales of e^-6 to e^-1."""
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    sh = 0.3 * normal(n, (degree + 1) ** 2, 3)
    return Gaussians(10 * normal(n, 3), normal(n, 4), normal(n, 3) - 4, 3 * normal(n), sh)


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two arrays hold the same bits, NaN and signs of zero included."""
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
