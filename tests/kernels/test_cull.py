import numpy as np
import pytest

import splatree as st
from splatree.clusters.cull import sides_of
from splatree.kernels import cpu, reference
from splatree.scene.options import Cull

from .conftest import absurd, camera, gaussians

RADII = ("radii", "mean_radii", "footprint_radii")


def starts(n: int, seed: int) -> np.ndarray:
    """Runs of one to some forty rows, some of a multiple of 16."""
    cuts = np.random.default_rng(seed).choice(np.arange(1, n), n // 15, replace=False)
    return np.unique(np.concatenate([[0, 16, 48, n], cuts])).astype(np.int32)


@pytest.mark.parametrize("log_scales", [(-5, -1.5), (-20, -15), (20, 60)])
def test_radii_hold_those_of_the_reference_and_little_more(isa: str, log_scales: tuple[float, float]) -> None:
    g = gaussians(500, 1, log_scales=log_scales)
    g.logit_opacities[:40] = np.log(1 / 254) + np.linspace(-2e-3, 2e-3, 40)  # about 1/255
    start = starts(500, 2)
    centers = g.means[start[:-1]] + np.float32(0.1)
    fast = cpu.spheres.bound_clusters(g, start, centers)
    slow = reference.spheres.bound_clusters(g, start, centers)
    # Rows within 1e-3 below the threshold's logit count as drawn, and 1e-5 is added to k².
    brighter = st.Gaussians(g.means, g.quats, g.log_scales, g.logit_opacities + np.float32(2e-3), g.sh)
    above = reference.spheres.bound_clusters(brighter, start, centers)
    for name in RADII:
        found = getattr(fast, name)
        assert np.all(found >= getattr(slow, name) * (1 - 1e-7))
        assert np.all(found <= getattr(above, name) * (1 + 5e-5))  # 2e-5 is added for the exponential


def test_rows_that_are_never_drawn_widen_no_sphere() -> None:
    g = gaussians(32, 3)
    g.means[5] = np.nan
    g.logit_opacities[6], g.log_scales[6] = -9, 5
    found = cpu.spheres.bound_clusters(g, np.int32([0, 32]), np.zeros((1, 3), np.float32))
    assert found.mean_radii[0] < 10 and found.footprint_radii[0] < 10
    assert found.radii[0] > 3 * np.exp(5)  # Eq. 2 does not look at opacity


def test_absurd_rows_give_no_nan() -> None:
    g = absurd()
    found = cpu.spheres.bound_clusters(g, np.arange(0, 41, 2, dtype=np.int32), np.zeros((20, 3), np.float32))
    assert not any(np.isnan(getattr(found, name)).any() for name in RADII)


@pytest.mark.parametrize("rule", ["exact", "exact-inria", "exact-gsplat", "planes", "paper", "paper-guard"])
def test_culling_agrees_with_the_reference(isa: str, rule: Cull) -> None:
    rng = np.random.default_rng(4)
    centers = (rng.normal(size=(1000, 3)) * 10.0 ** rng.uniform(-1, 3, (1000, 1))).astype(np.float32)
    radii, near_radii = (10.0 ** rng.uniform(-3, 2, (2, 1000))).astype(np.float32)
    sides = sides_of(camera(shift_x=30.0), rule, dilation_px2=0.3, threshold=1 / 255)
    slow = reference.cull.cull(centers, radii, near_radii, sides)
    # Both compute in float64: only a tie could fall either way.
    for threads in (1, 2):
        fast = cpu.cull.cull(centers, radii, near_radii, sides, threads=threads)
        np.testing.assert_array_equal(fast, slow)
    assert 0 < slow.sum() < 1000


def test_more_clusters_than_a_thread_takes_at_once() -> None:
    rng = np.random.default_rng(5)
    centers = rng.normal(size=(40_000, 3)).astype(np.float32) * 10
    radii = np.full(40_000, 0.5, np.float32)
    sides = sides_of(camera(), "exact", dilation_px2=0.3, threshold=1 / 255)
    one = cpu.cull.cull(centers, radii, radii, sides, threads=1)
    np.testing.assert_array_equal(one, cpu.cull.cull(centers, radii, radii, sides, threads=3))
    np.testing.assert_array_equal(one, reference.cull.cull(centers, radii, radii, sides))


def test_a_scene_of_spheres_is_checked_against_its_gaussians() -> None:
    scene = st.build_clusters(st.Scene.flat(gaussians(200, 6)), 10)
    clusters = scene.clusters
    assert clusters is not None and clusters.fits(scene.gaussians)
    moved = st.Gaussians(scene.gaussians.means + np.float32(1), *list(vars(scene.gaussians).values())[1:])
    assert not clusters.fits(moved)
    with pytest.raises(st.ShapeError, match="clusters of other Gaussians"):
        st.Scene(moved, scene.tree, clusters=clusters)
