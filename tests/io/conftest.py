"""Small scenes, and where the shared real ones lie."""

from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture
def data() -> Path:
    """The folder of shared real scenes."""
    if not DATA.is_dir():
        pytest.skip("needs the real scenes of ../shared/data")
    return DATA


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two arrays hold the same bits, NaN and signs of zero included."""
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")
