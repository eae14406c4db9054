"""Levels of detail on the accelerator: the walk finds the cut that splatree draws, and the simulator moves what it counts."""

from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.hardware.area import area_of
from splatree.hardware.config import Dram, Levels, Machine, Records
from splatree.hardware.engines import work_of
from splatree.hardware.events import front_cycles
from splatree.hardware.levels import walk_of
from splatree.hardware.order import visits_of
from splatree.hardware.simulate import simulate_frame
from splatree.hardware.study import draw_traces, on_machine
from splatree.hardware.trace import FrameTrace, trace_of_rates

WALKS = Machine(selects_levels=True)


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(3)
    n = 4000
    g = st.Gaussians(
        rng.normal(size=(n, 3)).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full((n, 3), -3.5, np.float32),
        np.full(n, 1.0, np.float32),
        (0.2 * rng.normal(size=(n, 4, 3))).astype(np.float32),
    )
    scene = st.build_clusters(st.build_lod(st.Scene.flat(g)), 60)
    camera = st.Camera.look_at([0, 0, -12], [2.5, 0, 0], width=128, height=96)
    return scene, camera, st.SelectOptions(pixel_error=4.0)


def test_the_walk_finds_the_cut_that_is_drawn(drawn):
    scene, camera, select = drawn
    frame = st.trace(scene, camera, select=select)
    walk = walk_of(scene, frame)
    everything = st.select(scene, camera, replace(select, view_test="none", cull="none"))
    assert 0 < walk.rows.sum() == len(everything) < scene.tree.num_leaves
    assert np.all(walk.walked >= walk.rows)
    assert walk.walked.sum() < len(scene)
    # Records are four to a unit: never fewer units than a fourth of what is looked at, never more than are looked at.
    assert np.all(walk.units * 4 >= walk.walked) and np.all(walk.units <= walk.walked)


def test_clusters_above_others_are_walked_first(drawn):
    scene, camera, select = drawn
    traces = draw_traces(scene, [camera], WALKS, select=select)
    above = traces[0].cluster_is_above
    assert 0 < above.sum() < len(above)
    for order in ("index", "morton", "adversarial"):
        visits = visits_of(order, traces, 0)
        of_kept = above[visits[visits >= 0]]
        assert np.all(np.diff(of_kept.astype(int)) <= 0)


def test_a_frame_of_levels_reads_what_its_walk_and_its_cut_say(drawn):
    scene, camera, select = drawn
    (trace,) = draw_traces(scene, [camera], WALKS, select=select)
    found = simulate_frame(WALKS, [trace])
    kept = trace.cluster_kept
    assert found.num_walked == trace.cluster_walked[kept].sum() == found.units["selection"].items
    assert found.bytes["levels"] == trace.cluster_walk_units[kept].sum() * 64
    assert found.num_rows == trace.cluster_rows[kept].sum()
    assert found.num_survivors == len(st.trace(scene, camera, select=replace(select, cull="exact")).splats)
    assert on_machine(WALKS, [trace]).energies[0].levels > 0


def test_without_levels_the_selection_has_nothing_to_do(drawn):
    scene, camera, _ = drawn
    traces = draw_traces(scene, [camera], WALKS)
    assert not traces[0].has_levels
    assert traces[0].num_rows == scene.tree.num_leaves
    times = [simulate_frame(replace(WALKS, selects_levels=selects), traces) for selects in (False, True)]
    assert times[0].cycles == times[1].cycles
    assert times[1].bytes["levels"] == 0


def test_a_machine_that_selects_no_levels_refuses_a_frame_of_them(drawn):
    scene, camera, select = drawn
    with pytest.raises(st.InputError, match="selects_levels=true"):
        st.simulate(scene, [camera], Machine(), select=select)


def test_the_selection_takes_area_and_can_bound_the_front_end(drawn):
    scene, camera, select = drawn
    traces = draw_traces(scene, [camera], WALKS, select=select)
    assert area_of(WALKS).mm2 > area_of(Machine()).mm2
    slow = simulate_frame(replace(WALKS, levels=Levels(lanes=0.05)), traces)
    assert slow.bounds.named == "selection"
    assert slow.front_cycles >= slow.bounds.selection
    with pytest.raises(st.InputError, match="holds no record"):
        replace(WALKS, levels=Levels(buffer_kb=0.001))


def levelled(seed: int) -> FrameTrace:
    """A made trace whose cut is a random share of each cluster."""
    rng = np.random.default_rng(seed)
    plain = trace_of_rates(
        150_000, exclusion=0.4, ideal=0.6, num_clusters=400, pairs_per_survivor=3.0, num_tiles_xy=(4, 4), rng=rng
    )
    span = plain.cluster_rows * rng.integers(1, 5, len(plain.cluster_rows))
    walked = plain.cluster_rows + rng.binomial(span - plain.cluster_rows, 0.5)
    return replace(
        plain,
        cluster_first_row=np.cumsum(span) - span,
        cluster_span=span,
        cluster_walked=walked,
        cluster_walk_units=np.minimum(walked, -(-span // 4)),
    )


@pytest.mark.parametrize("seed", range(6))
def test_the_cycle_stepped_core_agrees_with_the_event_driven_model_within_one_percent(seed):
    trace = levelled(seed)
    machine = replace(
        WALKS,
        dram=Dram(fidelity="L0", bandwidth_gbps=(12.8, 51.2)[seed % 2]),
        levels=Levels(lanes=(0.5, 4.0)[seed // 2 % 2]),
        records=Records(("fp32", "fp16", "fixed")[seed // 2]),
        clustering=seed != 5,
    )
    stepped = simulate_frame(machine, [trace]).front_cycles
    assert front_cycles(work_of(machine, trace, visits_of("index", [trace], 0))) == pytest.approx(stepped, rel=0.01)
