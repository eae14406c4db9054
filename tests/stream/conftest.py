from importlib.resources import as_file, files

import numpy as np
import pytest

import splatree as st
from splatree.maths.forests import preorder_from_links, subtree_radii


def forest(n, *, seed, sh_degree=0, num_roots=3):
    """A random forest over random Gaussians: children lie near their parent and are mostly smaller."""
    rng = np.random.default_rng(seed)
    parents = np.sort([-1 if i < num_roots else rng.integers(max(0, i - 60), i) for i in range(n)])  # breadth-first
    counts = np.bincount(parents[parents >= 0], minlength=n)
    order = preorder_from_links(num_roots + np.cumsum(counts) - counts, counts, np.arange(num_roots))
    places, depth = rng.random((n, 3)), np.zeros(n)
    for i in range(num_roots, n):
        depth[i] = depth[parents[i]] + 1
        places[i] = places[parents[i]] + rng.normal(0, 0.5, 3) * 0.7 ** depth[i]
    rows = order.node_from_row
    log_scales = np.log(0.3 * 0.7 ** depth[rows])[:, None] + rng.normal(0, 0.3, (n, 3))
    g = st.Gaussians(
        places[rows].astype(np.float32),
        rng.standard_normal((n, 4)).astype(np.float32),
        log_scales.astype(np.float32),
        rng.normal(0, 2, n).astype(np.float32),
        rng.normal(0, 0.5, (n, (sh_degree + 1) ** 2, 3)).astype(np.float32),
    )
    reach = 3 * np.exp(g.log_scales.max(axis=1).astype(np.float64))
    extents = subtree_radii(g.means, reach, order.depth)
    return st.Scene(g, st.GaussianTree(order.subtree_end, order.depth, extents))


@pytest.fixture(scope="session")
def city_tree():
    """Levels by a radius over the bundled piece of a city: 237,000 leaves of degree 3, 350,000 nodes."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        return st.build_lod(st.read(path), st.BuildOptions("radius"))
