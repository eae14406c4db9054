import numpy as np

import splatree as st

from ..kernels.conftest import view

__all__ = ["balls", "view"]


def balls(start: np.ndarray, centers: np.ndarray, radius: float = 1.0) -> st.ClusterIndex:
    """Clusters of which nothing is known but balls of one radius, and the boxes around these."""
    radii = np.full((3, len(centers)), radius, np.float32)
    return st.ClusterIndex(start, centers, *radii, centers - np.float32(radius), centers + np.float32(radius))
