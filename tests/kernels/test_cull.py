import numpy as np
import pytest

import splatree as st
from splatree.clusters.cull import sides_of
from splatree.kernels import reference
from splatree.kernels.cpu import frame as cpu
from splatree.kernels.cpu.build import spheres
from splatree.scene.clusters import Sides
from splatree.scene.options import Cull
from splatree.scene.view import View

from ..scenes import camera, gaussians
from .conftest import absurd

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
    fast = spheres.bound_clusters(g, start, centers)
    slow = reference.spheres.bound_clusters(g, start, centers)
    # Rows within 1e-3 below the threshold's logit count as drawn, and 1e-5 is added to k².
    brighter = st.Gaussians(g.means, g.quats, g.log_scales, g.logit_opacities + np.float32(2e-3), g.sh)
    above = reference.spheres.bound_clusters(brighter, start, centers)
    for name in RADII:
        found = getattr(fast, name)
        assert np.all(found >= getattr(slow, name) * (1 - 1e-7))
        assert np.all(found <= getattr(above, name) * (1 + 5e-5))  # 2e-5 is added for the exponential


@pytest.mark.parametrize("log_scales", [(-5, -1.5), (-12, 2)])
def test_boxes_hold_those_of_the_reference_and_little_more(isa: str, log_scales: tuple[float, float]) -> None:
    g = gaussians(500, 1, log_scales=log_scales)
    start = starts(500, 2)
    centers = g.means[start[:-1]]
    fast = spheres.bound_clusters(g, start, centers)
    slow = reference.spheres.bound_clusters(g, start, centers)
    # Float32 loses 1e-6 of the longest axis, which culling adds (BOX_SLACK), and rounds coordinates outwards by 2.4e-7.
    lost = 1e-6 * slow.footprint_radii[:, None]
    assert np.all(fast.box_low <= slow.box_low + lost) and np.all(fast.box_high >= slow.box_high - lost)
    # 2e-5 is added to reaches for the exponential, and 1e-5 to k².
    more = 1e-4 * slow.footprint_radii[:, None] + 1e-6 * np.abs(slow.box_low) + 1e-6 * np.abs(slow.box_high)
    assert np.all(fast.box_low >= slow.box_low - more) and np.all(fast.box_high <= slow.box_high + more)


def test_a_box_has_the_extents_of_a_turned_gaussian() -> None:
    # Half axes of 2, 1 and ¼, turned by 30° about z; k = 3 at this opacity.
    opacity = np.exp(4.5) / 255
    half = np.radians(15)
    g = st.Gaussians(
        np.float32([[1, -2, 5]]),
        np.float32([[np.cos(half), 0, 0, np.sin(half)]]),
        np.log(np.float32([[2, 1, 0.25]])),
        np.float32([np.log(opacity / (1 - opacity))]),
        np.zeros((1, 1, 3), np.float32),
    )
    wanted = 3 * np.array(
        [np.hypot(2 * np.cos(2 * half), np.sin(2 * half)), np.hypot(np.sin(2 * half) * 2, np.cos(2 * half)), 0.25]
    )
    for kernel in (spheres, reference.spheres):
        found = kernel.bound_clusters(g, np.int32([0, 1]), g.means)
        np.testing.assert_allclose(found.box_high - g.means, [wanted], rtol=1e-4)
        np.testing.assert_allclose(g.means - found.box_low, [wanted], rtol=1e-4)


def test_rows_that_are_never_drawn_widen_no_sphere() -> None:
    g = gaussians(32, 3)
    g.means[5] = np.nan
    g.logit_opacities[6], g.log_scales[6] = -9, 5
    found = spheres.bound_clusters(g, np.int32([0, 32]), np.zeros((1, 3), np.float32))
    assert found.mean_radii[0] < 10 and found.footprint_radii[0] < 10
    assert found.radii[0] > 3 * np.exp(5)  # Eq. 2 does not look at opacity
    assert np.abs([found.box_low, found.box_high]).max() < 10


def test_absurd_rows_give_no_nan() -> None:
    g = absurd()
    found = spheres.bound_clusters(g, np.arange(0, 41, 2, dtype=np.int32), np.zeros((20, 3), np.float32))
    assert not any(np.isnan(getattr(found, name)).any() for name in (*RADII, "box_low", "box_high"))


@pytest.mark.parametrize("rule", ["exact", "exact-inria", "exact-gsplat", "planes", "paper", "paper-guard"])
def test_culling_agrees_with_the_reference(isa: str, rule: Cull) -> None:
    rng = np.random.default_rng(4)
    centers = (rng.normal(size=(1000, 3)) * 10.0 ** rng.uniform(-1, 3, (1000, 1))).astype(np.float32)
    radii, near_radii = (10.0 ** rng.uniform(-3, 2, (2, 1000))).astype(np.float32)
    sides = sides_of(View(camera(shift_x=30.0)), rule)
    slow = reference.cull.cull(centers, radii, near_radii, sides)
    # Both compute in float64: only a tie could fall either way.
    for threads in (1, 2):
        fast = cpu.cull.cull(centers, radii, near_radii, sides, threads=threads)
        np.testing.assert_array_equal(fast, slow)
    assert 0 < slow.sum() < 1000


def test_culling_by_boxes_agrees_with_the_reference(isa: str) -> None:
    rng = np.random.default_rng(7)
    centers = (rng.normal(size=(1000, 3)) * 10.0 ** rng.uniform(-1, 3, (1000, 1))).astype(np.float32)
    half = (10.0 ** rng.uniform(-3, 2, (1000, 3))).astype(np.float32)
    half[::100] = np.inf
    sides = sides_of(View(camera(shift_x=30.0)), "exact")
    slow = reference.cull.cull_boxes(centers - half, centers + half, sides)
    # Both compute in float64: only a tie could fall either way.
    for threads in (1, 2):
        fast = cpu.cull.cull_boxes(centers - half, centers + half, sides, threads=threads)
        np.testing.assert_array_equal(fast, slow)
    assert 10 < slow.sum() < 900
    assert slow[::100].all()


def test_more_clusters_than_a_thread_takes_at_once() -> None:
    rng = np.random.default_rng(5)
    centers = rng.normal(size=(40_000, 3)).astype(np.float32) * 10
    radii = np.full(40_000, 0.5, np.float32)
    sides = sides_of(View(camera()), "exact")
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


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_slack_and_margin_widen_by_what_the_formula_says(isa: str, shape: str) -> None:
    """At x = 100 from the eye at y = 8, one unit beyond the plane x = 99 and as large as 1/4: 3/4 have to be added."""
    planes = np.zeros((5, 4))
    planes[:, 3] = -1e9  # nothing is beyond these
    planes[0] = 1, 0, 0, -99
    center, quarter = np.float32([[100, 10, 5]]), np.float32([0.25])
    distance = 100 + 2 + 5  # |c − eye|₁
    box_reaches = np.tile([1.0, 0, 0], (5, 1)) if shape == "box" else None
    for slack, margin in ((0.76 / distance, 0), (0.74 / distance, 0), (0, 0.76), (0, 0.74), (0.5 / distance, 0.26)):
        sides = Sides(planes, np.ones(5), np.array([0.0, 8, 0]), slack=slack, margin=margin, box_reaches=box_reaches)
        for stage in (cpu.cull, reference.cull):
            if shape == "sphere":
                kept = stage.cull(center, quarter, quarter, sides)
            else:
                kept = stage.cull_boxes(center - quarter, center + quarter, sides)
            assert kept.tolist() == [slack * distance + margin > 0.75]
