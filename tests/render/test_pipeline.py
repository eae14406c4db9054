from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

import splatree as st

from .. import scenes

cloud = partial(scenes.cloud, degree=3, log_scales=("uniform", -5.0, -1.5), logits=("normal", 0.0, 2.0), sh=0.3)

ALL_LEAVES = st.SelectOptions(pixel_error=0)


CAMERA = st.Camera.look_at((0.3, -0.5, -4), (0, 0, 0), width=83, height=53)
OPTIONS = st.RenderOptions(background=(0.1, 0.2, 0.3))


def same_bits(one: st.RenderResult, other: st.RenderResult) -> bool:
    pairs = ((one.image, other.image), (one.alpha, other.alpha), (one.depth, other.depth))
    return all(a.tobytes() == b.tobytes() for a, b in pairs)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_picture_is_that_of_the_reference(mode: str) -> None:
    scene = st.Scene.flat(cloud(600, 1))
    options = replace(OPTIONS, mode=mode)
    fast = st.render(scene, CAMERA, options)
    slow = st.render(scene, CAMERA, options, device="reference")
    # Float32 rounding alone is about 130 dB; a pair at τ or a pixel at its last splat may fall either way.
    assert st.psnr(fast.image, slow.image) > 90
    assert fast.counters.num_visible == slow.counters.num_visible
    assert abs(fast.counters.num_blended - slow.counters.num_blended) <= 5


def test_threads_change_no_bit() -> None:
    scene = st.Scene.flat(cloud(5000, 2, degree=1))
    one, two, three = (st.render(scene, CAMERA, OPTIONS, threads=n) for n in (1, 2, 3))
    assert same_bits(one, two) and same_bits(one, three)
    assert one.counters == two.counters == three.counters


def test_order_of_rows_changes_no_bit() -> None:
    g = cloud(3000, 3, degree=1)
    g.means[::2, 2] = np.round(g.means[::2, 2])
    g.means[1::2] = g.means[::2]  # pairs of one depth from anywhere: only ids can order them
    scene = st.Scene.flat(g)
    permutation = np.random.default_rng(4).permutation(3000)
    permuted = replace(st.Scene.flat(g.take(permutation)), ids=permutation.astype(np.uint32))
    one, other = (st.render(s, CAMERA, OPTIONS, ALL_LEAVES) for s in (scene, permuted))
    assert same_bits(one, other)
    without_ids = st.render(replace(permuted, ids=None), CAMERA, OPTIONS, ALL_LEAVES)
    assert not same_bits(one, without_ids)  # else this test could not fail


def test_rows_out_of_view_change_no_bit() -> None:
    g = cloud(1000, 5, degree=1)
    outside = cloud(300, 6, degree=1)
    outside.means[:, 2] -= 50  # behind
    above = cloud(300, 7, degree=1)
    above.means[:, 1] += 60
    padded = st.Gaussians.concatenate([outside, g, above])
    nothing_culled = st.SelectOptions(pixel_error=0, view_test="none")
    one = st.render(st.Scene.flat(g), CAMERA, OPTIONS, ALL_LEAVES)
    other = st.trace(st.Scene.flat(padded), CAMERA, OPTIONS, nothing_culled)
    assert len(other.selection) == 1600
    assert same_bits(one, other.result)


def test_levels_draw_fewer_nodes() -> None:
    tree = st.build_lod(st.Scene.flat(cloud(4000, 8, degree=0)))
    far = st.Camera.look_at((0, 0, -80), (0, 0, 0), width=64, height=48)
    leaves, cut = (st.render(tree, far, OPTIONS, select) for select in (ALL_LEAVES, st.SelectOptions(pixel_error=6)))
    assert cut.counters.num_selected < leaves.counters.num_selected / 2
    assert st.psnr(leaves.image, cut.image) > 25


def test_trace_keeps_what_render_drops() -> None:
    scene = st.Scene.flat(cloud(200, 9))
    frame = st.trace(scene, CAMERA, OPTIONS)
    assert same_bits(frame.result, st.render(scene, CAMERA, OPTIONS))
    counters = frame.result.counters
    assert counters.num_selected == len(frame.selection) and counters.num_visible == len(frame.splats)
    assert counters.num_pairs == frame.bins.num_pairs == len(frame.bins.splat_from_pair)
    assert set(frame.result.milliseconds) == {"select", "project", "bin", "blend"}
    np.testing.assert_array_equal(np.sort(frame.splats.order), np.arange(len(frame.splats)))


@pytest.mark.parametrize("tile_rule", ["tau", "3sigma"])
def test_squares_are_not_dropped_by_the_footprints_of_ellipses(tile_rule: str) -> None:
    scene = st.Scene.flat(cloud(900, 12, degree=0))
    options = st.RenderOptions(tile_rule=tile_rule)  # type: ignore[arg-type]
    frames = {
        v: st.trace(scene, CAMERA, options, st.SelectOptions(view_test=v)) for v in ("none", "footprint", "centre")
    }
    np.testing.assert_array_equal(frames["footprint"].splats.rows, frames["none"].splats.rows)
    assert len(frames["centre"].splats) < len(frames["none"].splats)  # other view tests are as they were asked for


def test_a_frame_has_the_stage_cull_where_clusters_are_left_out() -> None:
    scene = st.Scene.flat(cloud(900, 11, degree=0))
    flat, tree = st.build_clusters(scene, 20), st.build_clusters(st.build_lod(scene), 20)
    exact, none = st.SelectOptions(cull="exact"), st.SelectOptions(cull="none")
    for drawn, select, culled in (
        (scene, None, False),
        (flat, None, True),
        (flat, none, False),
        (tree, None, False),  # its blocks leave out as much
        (tree, exact, True),
    ):
        frame = st.trace(drawn, CAMERA, OPTIONS, select)
        assert ("cull" in frame.result.milliseconds) == ("cull" in frame.result.cpu_milliseconds) == culled
        assert (frame.culling is not None) == culled
    with pytest.raises(st.InputError, match="found rule 'exact' for a scene without clusters"):
        st.trace(scene, CAMERA, OPTIONS, exact)


def test_times_of_stages_are_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = count()
    monkeypatch.setattr(
        import_module("splatree.render.stages"),
        "time",
        SimpleNamespace(perf_counter=lambda: 0.5 * next(clock), process_time=lambda: 0.25 * next(clock)),
    )
    result = st.render(st.Scene.flat(cloud(20, 13)), CAMERA)
    # A stage reads clock and processor before and after: two ticks between the readings of each, of ½ s and of ¼ s.
    assert set(result.milliseconds.values()) == {1000.0}
    assert set(result.cpu_milliseconds.values()) == {500.0}


def test_mode_and_threshold_are_those_of_the_scene_unless_given() -> None:
    scene = st.Scene.flat(cloud(300, 10), mode="antialiased")
    own = st.render(scene, CAMERA)
    assert same_bits(own, st.render(scene, CAMERA, st.RenderOptions(mode="antialiased", threshold=1 / 255)))
    assert not same_bits(own, st.render(scene, CAMERA, st.RenderOptions(mode="classic")))
    assert not same_bits(own, st.render(replace(scene, threshold=0.1), CAMERA))


def test_unknown_backend_is_refused() -> None:
    with pytest.raises(st.InputError, match="found 'metal', wanted 'cpu', 'cuda'"):
        st.render(st.Scene.flat(cloud(1, 0)), CAMERA, device="metal")  # type: ignore[arg-type]


def test_empty_scene_is_background() -> None:
    result = st.render(st.Scene.flat(st.Gaussians.empty()), CAMERA, OPTIONS)
    np.testing.assert_array_equal(result.image, np.broadcast_to(np.float32([0.1, 0.2, 0.3]), (53, 83, 3)))
