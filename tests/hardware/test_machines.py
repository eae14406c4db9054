import dataclasses

import numpy as np
import pytest

import splatree as st
from splatree.bench import jo2024
from splatree.hardware.area import area_of
from splatree.hardware.config import BackEnd, Dram, Identification, Machine, Step1
from splatree.hardware.energy import energy_of
from splatree.hardware.paper import COUNTS, RATES
from splatree.hardware.presets import PRESETS, changed, machine_from_toml, machine_to_toml, preset
from splatree.hardware.simulate import DeadlockError, simulate_frame
from splatree.hardware.study import ablation, draw_traces, on_machine
from splatree.hardware.trace import FrameTrace, read_trace, trace_of_rates, write_trace


def traced(seed: int = 0) -> FrameTrace:
    rng = np.random.default_rng(seed)
    return trace_of_rates(20_000, exclusion=0.5, ideal=0.6, num_clusters=100, num_tiles_xy=(6, 4), rng=rng)


@pytest.mark.parametrize("name", PRESETS)
def test_machines_survive_toml(name, tmp_path):
    path = tmp_path / "machine.toml"
    path.write_text(machine_to_toml(preset(name)))
    assert machine_from_toml(path) == preset(name)


def test_settings_change_one_field_and_keep_the_others():
    machine = changed(Machine(), ["dram.bandwidth_gbps=51.2", "clustering=false", "order=oracle", "back.renderers=4"])
    wanted = dataclasses.replace(
        Machine(), dram=Dram(bandwidth_gbps=51.2), clustering=False, order="oracle", back=BackEnd(renderers=4)
    )
    assert machine == wanted


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("dram.bandwith_gbps=5", "did you mean 'bandwidth_gbps'"),
        ("dram=5", "found a group of settings"),
        ("order=best", "wanted one of index"),
        ("clock_mhz=fast", "wanted a number"),
        ("back.renderers=1.5", "wanted a whole number"),
        ("clustering", "wanted NAME=VALUE"),
        ("dram.bandwidth_gbps=-1", "dram.bandwidth_gbps: found -1.0, wanted 0.01"),
        ("step1.lanes=0", "step1.lanes: found 0.0, wanted 0.001"),
        ("step1.lanes=nan", "found nan"),
        ("back.renderers=0", "back.renderers: found 0, wanted 1"),
        ("identification.interval=100000", "wanted 1 to 10000"),
        ("dram.activate_ns=-4", "dram.activate_ns: found -4.0, wanted 0"),
        ("dram.interleave_bytes=0", "dram.interleave_bytes: found 0, wanted 1"),
        ("dram.latency_ns=40000", "found 20,000 cycles of the clock, wanted at most 10,000"),
        ("dram.refresh_ns=9000", "wanted more than the 9000 of refresh_ns"),
        ("step2.streamed_share=-1", "wanted 0"),
        ("back.sort_kb=0.001", "wanted room for a pair of 8 bytes in each"),
        ("back.cache_kb=0.1", "wanted 0 or a set of 8 lines of 64 bytes"),
        ("step1.buffer_kb=0.01", "a buffer that holds no record"),
        ("step1.buffer_kb=600", "wanted at least the"),
        ("clock_mhz.x=1", "is one setting"),
        ("clock_mhz=1 clock_mhz.x=1", "is one setting"),
    ],
)
def test_settings_that_no_machine_can_have_are_refused_by_name(setting, words):
    with pytest.raises(st.InputError, match=words):
        changed(Machine(), setting.split())


def test_files_that_are_no_machine_or_trace_are_refused(tmp_path):
    path = tmp_path / "machine.toml"
    path.write_text("clock_mhz = = 5")
    with pytest.raises(st.InputError, match="not TOML"):
        machine_from_toml(path)
    path = tmp_path / "trace.npz"
    write_trace(traced(), path)
    whole = path.read_bytes()
    for damaged in (b"", whole[:100], whole[: len(whole) // 2], b"PK" + bytes(200)):
        path.write_bytes(damaged)
        with pytest.raises(st.InputError):
            read_trace(path)
    np.savez(path, cluster_rows=np.zeros(3))
    with pytest.raises(st.InputError, match="found no column"):
        read_trace(path)


def test_a_trace_comes_back_as_it_was_written(tmp_path):
    trace = traced()
    write_trace(trace, tmp_path / "trace.npz")
    back = read_trace(tmp_path / "trace.npz")
    for field in dataclasses.fields(FrameTrace):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(trace, field.name))


def test_a_trace_of_another_scene_is_refused():
    trace = traced()
    with pytest.raises(st.InputError, match="more survivors than rows"):
        dataclasses.replace(trace, cluster_survivors=trace.cluster_rows + 1)
    with pytest.raises(st.InputError, match="negative counts"):
        dataclasses.replace(trace, tile_length=-trace.tile_length)
    with pytest.raises(st.InputError, match="wanted 0 or more and 1 to 25"):
        dataclasses.replace(trace, num_tiles_xy=-trace.num_tiles_xy)
    start = np.zeros_like(trace.tile_start)
    start[1], start[-1] = 9, 3
    with pytest.raises(st.InputError, match="lists that are not those of its tiles"):
        dataclasses.replace(trace, tile_start=start, pair_splats=np.zeros(3, np.int32))
    start[1] = 3
    with pytest.raises(st.InputError, match="lists that are not those of its tiles"):
        dataclasses.replace(trace, tile_start=start, pair_splats=np.full(3, -1, np.int32))


def test_a_simulation_that_cannot_go_on_says_where_each_engine_stands(monkeypatch):
    """A DRAM whose lines never come."""
    from splatree.hardware import simulate

    given = simulate.work_of

    def without_bandwidth(*arguments):
        work = given(*arguments)
        work.settings["dram"]["bytes_per_cycle"] = 0.0
        return work

    monkeypatch.setattr(simulate, "work_of", without_bandwidth)
    with pytest.raises(
        DeadlockError, match=r"nothing moves any more on 'jo2024': cycle \d+; identification has done 0"
    ):
        simulate_frame(Machine(), [traced()])


def scene_and_camera() -> tuple[st.Scene, st.Camera]:
    rng = np.random.default_rng(0)
    n = 3000
    g = st.Gaussians(
        rng.normal(size=(n, 3)).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full((n, 3), -3.5, np.float32),
        np.full(n, 1.0, np.float32),
        (0.2 * rng.normal(size=(n, 4, 3))).astype(np.float32),
    )
    scene = st.build_clusters(st.Scene.flat(g), 50)
    return scene, st.Camera.look_at([0, 0, -2.5], [1.5, 0, 0], width=128, height=96)


def test_the_circuits_rule_looks_at_spheres_and_boxes_exclude_more():
    scene, camera = scene_and_camera()
    spheres, boxes, paper = (
        draw_traces(scene, [camera], Machine(identification=Identification(rule=rule)))[0]  # type: ignore[arg-type]
        for rule in ("exact", "boxes", "paper")
    )
    assert np.all(spheres.cluster_kept >= boxes.cluster_kept)
    assert boxes.exclusion > spheres.exclusion
    np.testing.assert_array_equal(spheres.cluster_survivors, boxes.cluster_survivors)  # neither loses a survivor
    assert paper.cluster_survivors.sum() <= spheres.cluster_survivors.sum()
    assert area_of(Machine(identification=Identification(rule="boxes"))).mm2 > area_of(Machine()).mm2


def test_counts_are_those_of_the_frame_that_was_drawn():
    scene, camera = scene_and_camera()
    (trace,) = draw_traces(scene, [camera], Machine())
    frame = st.trace(scene, camera, select=st.SelectOptions(pixel_error=0, cull="exact"))
    assert trace.num_rows == len(scene)
    assert 0 < trace.exclusion <= trace.ideal_exclusion < 1
    assert trace.cluster_survivors.sum() == len(frame.splats)
    assert trace.cluster_pairs.sum() == frame.bins.num_pairs == trace.tile_length.sum()
    assert len(trace.pair_splats) == trace.tile_consumed.sum()
    assert np.all(trace.tile_subtiles <= 4 * trace.tile_consumed)
    assert np.all(trace.tile_subtiles >= (trace.tile_consumed > 0))
    simulation = st.simulate(scene, [camera])
    assert simulation.frames[0].num_survivors == len(frame.splats)
    assert simulation.frames[0].num_pairs == frame.bins.num_pairs


def test_a_larger_cache_misses_less_and_none_misses_every_entry():
    scene, camera = scene_and_camera()
    traces = draw_traces(scene, [camera], Machine())
    rates = [
        simulate_frame(dataclasses.replace(Machine(), back=BackEnd(cache_kb=size)), traces).cache_hit_rate
        for size in (0, 4, 16, 128)
    ]
    assert rates[0] == 0
    assert rates == sorted(rates)
    distinct = len(np.unique(traces[0].pair_splats))
    assert rates[-1] == 1 - distinct / len(traces[0].pair_splats)  # all of the frame's splats fit


def test_each_idea_is_taken_away_in_turn_and_energy_is_a_stack():
    traces = [traced(0), traced(1)]
    found = dict(ablation(Machine(), traces))
    assert found["no clusters"].front_milliseconds > found["as given"].front_milliseconds
    assert found["single buffers"].milliseconds >= found["as given"].milliseconds
    overlapped = found["subtiles skipped, frames overlap"].milliseconds
    assert overlapped <= found["subtiles skipped, frames in turn"].milliseconds
    for simulation in found.values():
        for energy in simulation.energies:
            assert energy.total == pytest.approx(sum(energy.stack.values()))
            assert min(energy.stack.values()) >= 0
    half = dataclasses.replace(Machine(), static_w=0.15)
    one, other = (energy_of(simulate_frame(m, traces), 0).static for m in (Machine(), half))
    assert one == pytest.approx(2 * other)


def test_slower_identification_and_smaller_buffers_are_told_in_the_engines_times():
    slow = dataclasses.replace(Machine(), identification=Identification(interval=4000))
    time = simulate_frame(slow, [traced()])
    assert time.bounds.named == "identification"
    assert time.units["step1"].stalled_on_input > time.units["step1"].busy
    assert simulate_frame(dataclasses.replace(Machine(), step1=Step1(buffer_kb=1)), [traced()]).cycles > 0


def test_without_clusters_cameras_or_a_known_name_there_is_nothing_to_simulate():
    scene, camera = scene_and_camera()
    with pytest.raises(st.InputError, match="without clusters"):
        st.simulate(dataclasses.replace(scene, clusters=None), [camera], "neo-like")
    with pytest.raises(st.InputError, match="found no cameras"):
        st.simulate(scene, [])
    with pytest.raises(st.InputError, match="wanted one of jo2024"):
        st.simulate(scene, [camera], "jo2025")
    with pytest.raises(st.InputError, match="found no traces"):
        on_machine(Machine(), [])


def test_the_papers_rates_are_those_of_its_table():
    for name, rates in RATES.items():
        baseline, _, ours = jo2024.TABLE_I[name]
        assert (rates.ideal, rates.exclusion) == pytest.approx((baseline[2] / 100, ours[2] / 100))
    assert set(COUNTS) == set(RATES) == set(jo2024.DATASETS["Mip-NeRF360"])
