import numpy as np
import pytest

import splatree as st
from splatree.constants import SH_C0
from splatree.kernels import reference
from splatree.kernels.cpu import _core
from splatree.kernels.cpu import frame as cpu
from splatree.scene.frame import Splats
from splatree.scene.view import View

from ..scenes import camera, gaussians
from .conftest import absurd

MODES = ("classic", "antialiased")


def seen(seen_by: st.Camera, mode: str = "classic", **changes: object) -> View:
    """The view of a camera with the usual options, or others."""
    return View(seen_by, mode=mode, **changes)  # type: ignore[arg-type]


def all_rows(scene: st.Scene) -> np.ndarray:
    return np.arange(len(scene), dtype=np.int32)


def aspect(splats: Splats) -> np.ndarray:
    """Longer over shorter axis of each splat."""
    a, b, c = splats.factors.astype(np.float64).T
    singular = np.linalg.svd(np.stack([np.stack([a, b], -1), np.stack([0 * a, c], -1)], -2), compute_uv=False)
    return singular[:, 0] / singular[:, 1] if len(splats) else np.ones(0)


def assert_at_a_step(splats: Splats, rows: np.ndarray, view: st.Camera, threshold: float) -> None:
    """Rows of only one implementation must lie within rounding of one of the tests that drop a row."""
    chosen = np.isin(splats.rows, rows)
    means, half_sizes = splats.means_px[chosen].astype(np.float64), splats.half_sizes_px[chosen].astype(np.float64)
    size = np.array([view.width, view.height])
    band = 1e-5 * (1 + half_sizes + np.abs(means))
    at_border = (np.abs(means + half_sizes - 0.5) < band) | (np.abs(means - half_sizes - size + 0.5) < band)
    at_threshold = np.abs(splats.opacities[chosen] / threshold - 1) < 1e-3
    at_near = np.abs(splats.depths[chosen] / view.near - 1) < 1e-5
    assert (at_border.any(axis=1) | at_threshold | at_near).all()


@pytest.mark.parametrize("mode", MODES)
def test_splats_are_those_of_the_reference(view: tuple[st.Scene, st.Camera], isa: str, mode: str) -> None:
    scene, seen_by = view
    fast = cpu.project.project(scene.gaussians, None, all_rows(scene), seen(seen_by, mode))
    slow = reference.project.project(scene.gaussians, None, all_rows(scene), seen(seen_by, mode))
    assert_at_a_step(fast, np.setdiff1d(fast.rows, slow.rows), seen_by, 1 / 255)
    assert_at_a_step(slow, np.setdiff1d(slow.rows, fast.rows), seen_by, 1 / 255)

    _, i, j = np.intersect1d(fast.rows, slow.rows, return_indices=True)
    # The small axis of a long splat is a difference of products of the large one: errors of float32, 6e-8 each, grow with
    # the aspect; about ten of them add up.
    relative = 1e-6 * aspect(slow)[j] + 4e-6
    # Direction x/z times the focal length: what float32 loses far outside of the image is relative to the place.
    place = np.abs(slow.means_px[j]) + seen_by.K[0, 0]
    assert np.all(np.abs(fast.means_px[i] - slow.means_px[j]) <= 4e-6 * place)
    np.testing.assert_allclose(fast.depths[i], slow.depths[j], rtol=4e-6)
    largest = np.abs(slow.factors[j]).max(axis=1, initial=0)
    assert np.all(np.abs(fast.factors[i] - slow.factors[j]).max(axis=1, initial=0) <= relative * largest)
    assert np.all(np.abs(fast.opacities[i] - slow.opacities[j]) <= relative * slow.opacities[j].max(initial=0))
    np.testing.assert_allclose(fast.colors[i], slow.colors[j], atol=4e-6)  # 16 terms of at most about 1
    # The box follows the opacity by √(2 ln(o/τ)), steep at τ: compared where it is not.
    clear = slow.opacities[j] > 1.1 / 255
    np.testing.assert_allclose(fast.half_sizes_px[i][clear], slow.half_sizes_px[j][clear], rtol=2e-4)
    np.testing.assert_allclose(np.exp2(fast.records[:, 6]), fast.opacities, rtol=2e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 8, 23, 24, 25, 60, 3000])
@pytest.mark.parametrize("depths", ["one", "few"])
def test_splats_of_one_depth_stay_in_the_order_of_rows(isa: str, n: int, depths: str) -> None:
    """Few are sorted otherwise than many; both keep ties in their order."""
    g = gaussians(n, 1, spread=0.3)
    steps = 0 if depths == "one" else 3
    g.means[:, 2] = np.random.default_rng(n).integers(0, steps + 1, n)
    g.log_scales[:] = -1
    g.logit_opacities[:] = 2
    seen_by = st.Camera.look_at((0, 0, -6), (0, 0, 0), width=40, height=30)
    splats = cpu.project.project(g, None, np.arange(n, dtype=np.int32), seen(seen_by))
    assert len(splats) == n
    np.testing.assert_array_equal(splats.order, np.argsort(splats.depths, kind="stable"))


def test_order_is_by_depth_and_then_by_id(isa: str) -> None:
    g = gaussians(200, 1)
    g.means[:, 2] = np.round(g.means[:, 2])  # many of one depth for a camera that looks along z
    g.log_scales[:] = -1
    ids = np.random.default_rng(0).permutation(200).astype(np.uint32)
    seen_by = st.Camera.look_at((0, 0, -6), (0, 0, 0), width=40, height=30)
    splats = cpu.project.project(g, ids, np.arange(200, dtype=np.int32), seen(seen_by))
    assert len(np.unique(splats.depths)) < len(splats) / 4
    wanted = np.lexsort((ids[splats.rows], splats.depths))
    np.testing.assert_array_equal(splats.order, wanted)


@pytest.mark.parametrize("spread", ["all bits", "one bucket", "few bits"])
def test_large_sets_are_ordered_too(spread: str) -> None:
    # More than one chunk of the sort.
    rng = np.random.default_rng(3)
    n = 40_000
    exponents = {"all bits": (-3, 60), "one bucket": (2, 2.01), "few bits": (2, 2.00001)}
    depths = np.exp(rng.uniform(*exponents[spread], n)).astype(np.float32)
    depths[::7] = depths[3]
    if spread == "one bucket":
        depths[5] = 1e30  # its bits make the others' highest ones equal
    ids = rng.permutation(n).astype(np.uint32)
    orders = []
    for threads in (1, 3):
        order = np.empty(n, np.int32)
        _core.order_splats(depths, np.arange(n, dtype=np.int32), ids, order, threads)
        orders.append(order)
    np.testing.assert_array_equal(orders[0], np.lexsort((ids, depths)))
    np.testing.assert_array_equal(orders[0], orders[1])


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_of_each_degree(degree: int, isa: str) -> None:
    g = gaussians(100, 4, degree=3)
    rows = np.arange(100, dtype=np.int32)
    given = g.with_sh_degree(degree)
    fast = cpu.project.project(given, None, rows, seen(camera()))
    slow = reference.project.project(given, None, rows, seen(camera()))
    cut = cpu.project.project(g, None, rows, seen(camera(), sh_degree=degree))
    np.testing.assert_allclose(fast.colors, slow.colors, atol=4e-6)
    np.testing.assert_array_equal(fast.colors, cut.colors)


def test_a_gaussian_on_the_axis_in_closed_form(isa: str) -> None:
    sigma, depth = 0.05, 4.0
    g = st.Gaussians(
        np.array([[0, 0, depth]], np.float32),
        np.array([[2, 0, 0, 0]], np.float32),
        np.full((1, 3), np.log(sigma), np.float32),
        np.zeros(1, np.float32),
        np.zeros((1, 1, 3), np.float32) + np.float32(0.25 / SH_C0),
    )
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=64, height=48)
    for mode in MODES:
        splats = cpu.project.project(g, None, np.zeros(1, np.int32), seen(seen_by, mode))
        variance = (seen_by.K[0, 0] * sigma / depth) ** 2
        opacity = 0.5 if mode == "classic" else 0.5 * variance / (variance + 0.3)
        half_size = np.sqrt(2 * np.log(255 * opacity) * (variance + 0.3))
        np.testing.assert_allclose(splats.means_px, [[32, 24]], atol=1e-5)
        np.testing.assert_allclose(
            splats.conics, [[1 / (variance + 0.3), 0, 1 / (variance + 0.3)]], rtol=1e-5, atol=1e-7
        )
        np.testing.assert_allclose(splats.opacities, [opacity], rtol=1e-6)
        np.testing.assert_allclose(splats.half_sizes_px, [[half_size, half_size]], rtol=1e-5)
        np.testing.assert_allclose(splats.colors, [[0.75] * 3], rtol=1e-6)


def test_absurd_rows_are_dropped_or_drawn_and_spoil_no_other(isa: str) -> None:
    g = absurd()
    rows = np.arange(len(g), dtype=np.int32)
    splats = cpu.project.project(g, None, rows, seen(camera()))
    assert not np.isin([0, 1, 8, 9, 10], splats.rows).any()  # not finite, without opacity, at the eye, far away
    drawn = np.array([2, 4, 5, 6], np.int32)  # scales of e^80, quaternions of length 0, 1e30, 1e-30
    wanted = reference.project.project(g, None, drawn, seen(camera())).rows
    assert len(wanted) >= 3
    np.testing.assert_array_equal(np.intersect1d(drawn, splats.rows), wanted)
    assert np.isfinite(splats.records).all()
    good = np.delete(rows, np.arange(11))
    alone = cpu.project.project(g, None, good, seen(camera()))
    np.testing.assert_array_equal(splats.records[splats.rows > 10], alone.records)


def test_a_subset_of_rows_gives_its_records_bit_for_bit(isa: str) -> None:
    g = gaussians(3000, 5)  # more than one chunk
    rows = np.arange(3000, dtype=np.int32)
    everything = cpu.project.project(g, None, rows, seen(camera()))
    for chosen in (rows[::3], rows[1:-1], rows[-5:]):
        part = cpu.project.project(g, None, chosen, seen(camera()))
        both = np.isin(everything.rows, chosen)
        np.testing.assert_array_equal(part.rows, everything.rows[both])
        np.testing.assert_array_equal(part.records.view(np.uint32), everything.records[both].view(np.uint32))


@pytest.mark.parametrize("fov_y_deg", [3, 30, 60, 120])
def test_the_first_look_drops_nothing_that_is_in_view(fov_y_deg: float, isa: str) -> None:
    # Distances over six decades, aspects of 100 : 1, sizes from far below a pixel to far beyond the picture.
    rng = np.random.default_rng(round(fov_y_deg))
    n = 3000
    directions = rng.normal(size=(n, 3))
    means = directions / np.linalg.norm(directions, axis=1, keepdims=True) * 10.0 ** rng.uniform(-2, 4, (n, 1))
    log_scales = np.log(10.0 ** (rng.uniform(-4, 2, (n, 1)) + rng.uniform(-2, 0, (n, 3))))
    quats, logits, sh = rng.normal(size=(n, 4)), rng.normal(0, 4, n), np.zeros((n, 1, 3))
    g = st.Gaussians(*(np.asarray(a, np.float32) for a in (means, quats, log_scales, logits, sh)))
    straight = st.Camera.look_at((0, 0, 0), (0.3, -0.2, 1), width=75, height=41, fov_y_deg=fov_y_deg)
    for off_centre in (0.0, 60.0, -900.0):
        K = straight.K.copy()
        K[:2, 2] += off_centre
        seen_by = st.Camera(straight.camera_from_world, K, straight.width, straight.height)
        fast = cpu.project.project(g, None, all_rows(st.Scene.flat(g)), seen(seen_by))
        slow = reference.project.project(g, None, all_rows(st.Scene.flat(g)), seen(seen_by))
        assert 10 < len(slow) < n / 2
        assert_at_a_step(fast, np.setdiff1d(fast.rows, slow.rows), seen_by, 1 / 255)
        assert_at_a_step(slow, np.setdiff1d(slow.rows, fast.rows), seen_by, 1 / 255)


def test_very_many_rows_are_the_same_as_few() -> None:
    # From 2^19 rows on, records are written past the caches.
    g = gaussians(1000, 9, spread=3)
    rows = np.resize(np.arange(1000, dtype=np.int32), 2**19 + 100)
    few = cpu.project.project(g, None, rows[:1000], seen(camera()))
    many = cpu.project.project(g, None, rows, seen(camera()))
    assert 100 < len(few) < 900
    wanted = np.resize(few.rows, len(many))
    np.testing.assert_array_equal(many.rows, wanted)
    record_of_row = np.zeros((1000, 16), np.float32)
    record_of_row[few.rows] = few.records
    np.testing.assert_array_equal(many.records, record_of_row[wanted])


def test_rows_outside_of_the_scene_are_refused() -> None:
    g = gaussians(5, 1)
    for row in (-1, 5):
        with pytest.raises(st.InputError, match="wanted 0 to 4"):
            cpu.project.project(g, None, np.array([row], np.int32), seen(camera()))


def test_determinant_of_a_needle_does_not_cancel(isa: str) -> None:
    # A needle across the picture at 45°: A C − B² in float32 would lose all of its digits.
    g = st.Gaussians(
        np.array([[0, 0, 4]], np.float32),
        np.array([[np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)]], np.float32),
        np.log(np.array([[30, 1e-3, 1e-3]], np.float32)),
        np.full(1, 5, np.float32),
        np.zeros((1, 1, 3), np.float32),
    )
    seen_by = st.Camera.look_at((0, 0, 0), (0, 0, 1), width=640, height=480)
    fast = cpu.project.project(g, None, np.zeros(1, np.int32), seen(seen_by))
    a, b, c = fast.factors[0].astype(np.float64)
    across = np.array([np.sqrt(0.5), -np.sqrt(0.5)])
    thickness = 1 / np.hypot(a * across[0] + b * across[1], c * across[1])
    sigma_px = seen_by.K[0, 0] * 1e-3 / 4
    np.testing.assert_allclose(thickness, np.sqrt(sigma_px**2 + 0.3), rtol=1e-3)
