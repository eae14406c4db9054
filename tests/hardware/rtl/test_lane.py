"""The lane of step 1 against its integer model, and the model against the definition of the projection."""

from dataclasses import fields, replace
from importlib.resources import as_file, files

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as strategy

import splatree as st
from splatree.hardware.rtl import projection
from splatree.hardware.rtl.projection import LaneGaussians, LaneView, lane_gaussians, lane_view
from splatree.kernels.cpu.frame.bin import bin
from splatree.kernels.cpu.frame.blend import blend
from splatree.kernels.cpu.frame.project import project
from splatree.kernels.reference.project import project as reference
from splatree.scene.frame import Splats
from splatree.scene.view import View

from .icarus import need_icarus, run_icarus

PX = 2.0**projection.PX_PLACES
LATENCY = 28
"""Cycles from a Gaussian at the input to its splat at the output."""


def gaussians(count: int, seed: int, *, spread: float = 3.0) -> st.Gaussians:
    rng = np.random.default_rng(seed)
    return st.Gaussians(
        means=(spread * rng.normal(size=(count, 3))).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=np.log(spread * rng.uniform(1e-4, 0.1, (count, 3))).astype(np.float32),
        logit_opacities=rng.normal(size=count).astype(np.float32),
        sh=rng.normal(size=(count, 1, 3)).astype(np.float32),
    )


def quantised(g: st.Gaussians, view: View) -> tuple[LaneGaussians, LaneView]:
    means = g.means.astype(np.float64)
    low, high = means.min(axis=0), means.max(axis=0)
    origin, unit = (low + high) / 2, float((high - low).max()) / 2 / (projection.LARGEST - 1)
    return lane_gaussians(g, origin, unit), lane_view(view, origin, unit)


CAMERA = st.Camera.look_at([0, 0, -6], [1, 0, 0], width=200, height=120)


def payloads(given: LaneGaussians) -> list[dict[str, object]]:
    columns = (given.centers, given.quats, given.scales, given.exponents)
    return [
        {"number": i, "center": center, "quat": quat, "scales": scales, "exponent": exponent}
        for i, (center, quat, scales, exponent) in enumerate(zip(*(c.tolist() for c in columns), strict=True))
    ]


def view_numbers(view: LaneView) -> dict[str, object]:
    return {field.name: np.asarray(getattr(view, field.name)).tolist() for field in fields(LaneView)}


def simulated(given: LaneGaussians, view: LaneView, ready: np.ndarray) -> list[tuple[int, ...]]:
    """Number, depth, position and variances of each splat that leaves the circuit."""
    return [splat for _, splat in timed(given, view, ready)]


def timed(given: LaneGaussians, view: LaneView, ready: np.ndarray) -> list[tuple[int, tuple[int, ...]]]:
    """The same, each with its cycle."""
    sim = pytest.importorskip("amaranth.sim")
    from splatree.hardware.rtl.lane import Lane

    circuit, found = Lane(), []
    simulator = sim.Simulator(circuit)
    simulator.add_clock(1e-6)

    async def source(context):
        context.set(circuit.view, view_numbers(view))
        for payload in payloads(given):
            context.set(circuit.gaussians.payload, payload)
            context.set(circuit.gaussians.valid, 1)
            await context.tick().until(circuit.gaussians.ready)
        context.set(circuit.gaussians.valid, 0)

    async def sink(context):
        for cycle, is_ready in enumerate(ready.tolist()):
            context.set(circuit.splats.ready, int(is_ready))
            _, _, valid, splat = await context.tick().sample(circuit.splats.valid, circuit.splats.payload)
            if valid and is_ready:
                found.append((cycle, (splat.number, splat.depth, *splat.mean_px, *splat.variances)))

    simulator.add_testbench(source)
    simulator.add_testbench(sink)
    simulator.run()
    return found


def modelled(given: LaneGaussians, view: LaneView) -> list[tuple[int, ...]]:
    splats = projection.project(given, view)
    columns = (splats.depths[:, None], splats.means_px, splats.variances)
    rows = np.concatenate([np.arange(len(splats.kept))[:, None], *columns], axis=1)
    return [tuple(row) for row in rows[splats.kept].tolist()]


@pytest.mark.parametrize("share", [1.0, 0.33])
def test_the_circuit_hands_on_what_the_integer_model_computes(share):
    given, view = quantised(gaussians(120, seed=1), View(CAMERA))
    expected = modelled(given, view)
    assert 30 < len(expected) < 120
    assert simulated(given, view, np.random.default_rng(2).random(700) < share) == expected


def test_a_gaussian_enters_in_each_cycle():
    given, view = quantised(gaussians(60, seed=1), View(CAMERA))
    found = timed(given, view, np.ones(60 + LATENCY, bool))
    assert found == [(splat[0] + LATENCY, splat) for splat in modelled(given, view)]


def test_extreme_numbers_do_not_wrap_around():
    rng = np.random.default_rng(3)
    largest = projection.LARGEST
    centers = rng.choice([-largest - 1, -1, 0, 1, largest], (150, 3))
    quats = rng.choice([-(1 << 14), 0, 1, 1 << 14], (150, 4))
    scales, exponents = rng.choice([0, 1, 65535], (150, 3)), rng.choice([-32, -8, 0, 31], 150)
    given = LaneGaussians(centers, quats, scales, exponents)
    _, view = quantised(gaussians(10, seed=1), View(CAMERA))
    far = (1 << projection.OFFSET_BITS - 2) - 1
    for offsets, exponent in (([0, 0, 1], 7), ([far, -far, far], -32), ([-far, far, 1 << 16], 15)):
        changed = replace(view, offsets=np.array(offsets), exponent=exponent, near=0)
        assert simulated(given, changed, np.ones(200, bool)) == modelled(given, changed)


@settings(max_examples=40, deadline=None)
@given(strategy.integers(0, 10_000), strategy.floats(-2, 4), strategy.floats(20, 100))
def test_no_splat_that_touches_the_picture_is_dropped(seed, magnitude, degrees):
    spread = 10.0**magnitude
    g = gaussians(80, seed, spread=spread)
    eye = spread * np.random.default_rng(seed).normal(size=3) * 3
    camera = st.Camera.look_at(eye, np.zeros(3), width=160, height=90, fov_y_deg=degrees)
    view = View(replace(camera, near=0.05 * spread))
    found = projection.project(*quantised(g, view))
    assert found.kept[reference(g, None, np.arange(len(g), dtype=np.int32), view).rows].all()


def test_the_picture_of_the_lanes_splats_is_that_of_the_renderer():
    """One chunk of a city: positions, shapes, and the picture that they give. Stored bounds, twice what was measured."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        scene = st.read(path)
    (camera,) = st.flyout(scene, st.PathOptions(views=1, width=640, height=360))
    view = View(camera)
    splats = project(scene.gaussians, None, np.arange(len(scene), dtype=np.int32), view)
    found = projection.project(*quantised(scene.gaussians, view))
    assert found.kept[splats.rows].all()

    means = found.means_px[splats.rows] / PX
    xx, xy, yy = found.variances[splats.rows].T / PX
    records = splats.records.astype(np.float64)
    a, b, c = records[:, 2:5].T
    assert np.abs(means - records[:, :2]).max() < 0.05
    # (a dx + b dy)² + (c dy)² has the matrix Σ'⁻¹: its product with the lane's Σ' has eigenvalues of one.
    inverse, found_variances = (
        np.array([[first, mixed], [mixed, second]]).transpose(2, 0, 1)
        for first, mixed, second in ((a * a, a * b, b * b + c * c), (xx, xy, yy))
    )
    error = np.abs(np.linalg.eigvals(inverse @ found_variances) - 1).max(axis=1)
    assert np.quantile(error, 0.99) < 0.003

    root, det = np.sqrt(1 / yy), xx * yy - xy**2
    ours = splats.records.copy()
    ours[:, 0:2] = means
    ours[:, 2], ours[:, 4] = np.sqrt(yy / det), root
    ours[:, 3] = -ours[:, 2] * xy / yy
    pictures = []
    for numbers in (splats.records, ours):
        drawn = Splats(splats.rows, numbers, splats.order)
        pictures.append(blend(drawn, bin(drawn, view), view).image)
    assert st.psnr(*pictures) > 62


def test_icarus_agrees_on_the_verilog(tmp_path):
    """A second simulator, which shares nothing with Amaranth's."""
    need_icarus()
    from splatree.hardware.rtl.lane import GaussianLayout, LaneViewLayout, SplatLayout

    given, view = quantised(gaussians(80, seed=5), View(CAMERA))
    rows = [GaussianLayout.const(payload).as_bits() for payload in payloads(given)]
    found = run_icarus(
        tmp_path,
        "step1",
        ("gaussians", rows, GaussianLayout.size),
        (LaneViewLayout.const(view_numbers(view)).as_bits(), LaneViewLayout.size),
        ("splats", SplatLayout.size),
    )
    splats = [SplatLayout.from_bits(bits) for bits in found]
    assert [(s.number, s.depth, *s.mean_px, *s.variances) for s in splats] == modelled(given, view)
