"""Sessions: what a user draws many views with."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import splatree as st
from splatree.kernels.cuda.driver import Device
from splatree.kernels.devices import DeviceName

from ..scenes import camera, gaussians

VIEWS = (camera(), camera(distance=9.0), camera(30, 50, shift_x=8.0))


@pytest.fixture(scope="module")
def scene() -> st.Scene:
    return st.build_lod(st.Scene.flat(gaussians(400, 1)))


def same_picture(one: st.RenderResult, other: st.RenderResult) -> bool:
    return (one.image.tobytes(), one.alpha.tobytes(), one.depth.tobytes(), one.counters) == (
        other.image.tobytes(),
        other.alpha.tobytes(),
        other.depth.tobytes(),
        other.counters,
    )


def drawn_elsewhere(scene: st.Scene, device: DeviceName) -> list[st.RenderResult]:
    return [st.render(scene, view, device=device) for view in VIEWS]


@pytest.mark.parametrize("device", ["cpu", "reference"])
def test_views_drawn_in_turn_are_those_drawn_alone(scene: st.Scene, device: DeviceName) -> None:
    wanted = drawn_elsewhere(scene, device)
    with st.open_session(scene, device=device) as session:
        for i in (0, 1, 2, 1, 0):
            assert same_picture(session.draw(VIEWS[i]), wanted[i])


@pytest.mark.parametrize("budget", [60, 150])
def test_budgets_met_one_after_the_other_are_those_met_alone(scene: st.Scene, budget: int) -> None:
    select = st.SelectOptions(pixel_error=0.5, budget=budget)
    path = [camera(shift_x=0.1 * i) for i in range(4)] + [VIEWS[1], VIEWS[0]]
    with st.open_session(scene, select=select) as session:
        for view in path:
            alone = st.select(scene, view, select)
            found = session.select(view)
            assert found.pixel_error == alone.pixel_error > 0.5
            np.testing.assert_array_equal(found.rows, alone.rows)
            assert same_picture(session.draw(view), st.render(scene, view, select=select))


def test_a_trace_is_not_overwritten_by_the_pictures_after_it(scene: st.Scene) -> None:
    with st.open_session(scene) as session:
        session.draw(VIEWS[0])
        frame = session.trace(VIEWS[0])
        kept = [array.tobytes() for array in (frame.splats.rows, frame.splats.records, frame.splats.order)]
        for view in VIEWS[::-1]:
            session.draw(view)
        assert [array.tobytes() for array in (frame.splats.rows, frame.splats.records, frame.splats.order)] == kept


def test_views_drawn_in_turn_on_a_device_are_those_drawn_alone(scene: st.Scene, at_hand: Device) -> None:
    wanted = drawn_elsewhere(scene, "cuda")
    with st.open_session(scene, device="cuda") as session:
        for i in (0, 1, 0, 2, 1):
            found = session.draw(VIEWS[i])
            assert found.image.tobytes() == wanted[i].image.tobytes()
            assert found.counters.num_pairs == wanted[i].counters.num_pairs


def test_a_trace_is_of_the_picture_that_is_drawn(scene: st.Scene) -> None:
    with st.open_session(scene) as session:
        frame = session.trace(VIEWS[0], st.Wanted(last_pair=True, median_depth=True))
        assert frame.result.image.tobytes() == session.draw(VIEWS[0]).image.tobytes()
        assert frame.picture.last_pair is not None and frame.picture.median_depth is not None
        assert frame.picture.contributions is None
        assert frame.camera is VIEWS[0]
        np.testing.assert_array_equal(session.select(VIEWS[0]).rows, frame.selection.rows)


def test_options_of_a_call_are_for_that_call(scene: st.Scene) -> None:
    options, select = st.RenderOptions(background=(1, 0, 0)), st.SelectOptions(pixel_error=20)
    with st.open_session(scene, options=options, select=select) as session:
        first = session.draw(VIEWS[0])
        assert same_picture(first, st.render(scene, VIEWS[0], options, select))
        leaves = session.draw(VIEWS[0], select=st.SelectOptions(pixel_error=0))
        assert leaves.counters.num_selected > first.counters.num_selected
        blue = session.draw(VIEWS[0], options=st.RenderOptions(background=(0, 0, 1)))
        assert same_picture(blue, st.render(scene, VIEWS[0], st.RenderOptions(background=(0, 0, 1)), select))
        assert same_picture(session.draw(VIEWS[0]), first)


def test_views_can_be_asked_for_ahead(scene: st.Scene) -> None:
    wanted = drawn_elsewhere(scene, "cpu")
    with st.open_session(scene) as session:
        pending = [session.enqueue(view) for view in VIEWS]
        assert all(same_picture(p.result(), w) for p, w in zip(pending, wanted, strict=True))
        assert pending[0].result() is pending[0].result()
    late = st.open_session(scene)
    pending = [late.enqueue(view) for view in VIEWS]
    late.close()  # draws what was asked for
    assert all(same_picture(p.result(), w) for p, w in zip(pending, wanted, strict=True))


def test_views_can_be_asked_for_ahead_on_a_device(scene: st.Scene, at_hand: Device) -> None:
    wanted = drawn_elsewhere(scene, "cuda")
    with st.open_session(scene, device="cuda") as session:
        pending = [session.enqueue(view) for view in (VIEWS[0], VIEWS[1], VIEWS[0])]
        for found, i in zip(pending[::-1], (0, 1, 0), strict=True):
            assert found.result().image.tobytes() == wanted[i].image.tobytes()
            assert found.result().counters.num_blended == wanted[i].counters.num_blended


def test_an_error_of_a_view_that_was_asked_for_is_raised_by_its_result(scene: st.Scene) -> None:
    with st.open_session(scene) as session:
        pending = session.enqueue(VIEWS[0], select=st.SelectOptions(budget=1))
        for _ in range(2):
            with pytest.raises(st.InputError, match="budget: found"):
                pending.result()
        assert session.draw(VIEWS[0]).counters.num_pairs > 0


def test_a_closed_session_cannot_be_used(scene: st.Scene) -> None:
    session = st.open_session(scene)
    session.draw(VIEWS[0])
    session.close()
    session.close()
    for use in (
        lambda: session.draw(VIEWS[0]),
        lambda: session.enqueue(VIEWS[0]),
        lambda: session.trace(VIEWS[0]),
        lambda: session.select(VIEWS[0]),
        lambda: session.draw_on_device(VIEWS[0]),
        lambda: session.update({"sh": scene.gaussians.sh}),
    ):
        with pytest.raises(st.InputError, match="session: found it closed, wanted it open; open another"):
            use()


def test_threads_draw_in_one_session(scene: st.Scene) -> None:
    wanted = drawn_elsewhere(scene, "cpu")
    together = threading.Barrier(3)

    def draw(i: int) -> bool:
        together.wait()
        return all(same_picture(session.draw(VIEWS[(i + j) % 3]), wanted[(i + j) % 3]) for j in range(6))

    with st.open_session(scene) as session, ThreadPoolExecutor(3) as pool:
        assert all(pool.map(draw, range(3)))


def moved(g: st.Gaussians) -> st.Gaussians:
    return replace(
        g, means=g.means + np.float32(0.7), log_scales=g.log_scales + np.float32(0.4), sh=np.float32(0.5) * g.sh
    )


@pytest.mark.parametrize("where", ["cpu", "cuda"])
@pytest.mark.parametrize("levels", [False, True])
def test_an_update_draws_the_scene_of_the_new_columns(
    scene: st.Scene, at_hand: Device, where: DeviceName, levels: bool
) -> None:
    drawn = scene if levels else st.Scene.flat(gaussians(300, 2))
    changed = replace(drawn, gaussians=moved(drawn.gaussians), blocks=None)
    with st.open_session(drawn, device=where) as session:
        asked = session.enqueue(VIEWS[0])
        session.update(changed.gaussians)
        assert asked.result().image.tobytes() == st.render(drawn, VIEWS[0], device=where).image.tobytes()
        for view in VIEWS:
            assert session.draw(view).image.tobytes() == st.render(changed, view, device=where).image.tobytes()
        session.update({"sh": drawn.gaussians.sh, "means": drawn.gaussians.means})
        back = replace(
            changed, gaussians=replace(changed.gaussians, sh=drawn.gaussians.sh, means=drawn.gaussians.means)
        )
        assert session.draw(VIEWS[0]).image.tobytes() == st.render(back, VIEWS[0], device=where).image.tobytes()


@pytest.mark.parametrize("where", ["cpu", "cuda"])
def test_an_update_that_keeps_the_index_misses_nothing(at_hand: Device, where: DeviceName) -> None:
    drawn = st.build_clusters(st.Scene.flat(gaussians(300, 2)), 20)
    changed = moved(drawn.gaussians)
    with st.open_session(drawn, device=where) as session:
        session.update(changed, keep_index=True)
        for view in VIEWS:
            found = session.draw(view)
            assert found.image.tobytes() == st.render(st.Scene.flat(changed), view, device=where).image.tobytes()
            assert found.counters.num_selected == 300
        session.update({"means": drawn.gaussians.means})
        assert session.scene.blocks is not None
        assert session.draw(VIEWS[1]).counters.num_selected <= 300


def test_an_update_keeps_culling_exact() -> None:
    drawn = st.build_clusters(st.Scene.flat(gaussians(300, 2, spread=4.0)), 40)
    with st.open_session(drawn) as session:
        session.update(moved(drawn.gaussians))
        frame = session.trace(VIEWS[0])
        assert frame.culling is not None and not frame.culling.kept.all()
        wanted = st.render(st.Scene.flat(moved(drawn.gaussians)), VIEWS[0])
        assert frame.result.image.tobytes() == wanted.image.tobytes()


@pytest.mark.parametrize(
    ("columns", "kind", "message"),
    [
        ({"colour": np.zeros(3)}, st.InputError, "update: found column 'colour', wanted some of means, quats"),
        ({"sh": np.zeros((2, 4, 3), np.float32)}, st.ShapeError, r"update: sh: found shape \(2, 4, 3\), wanted \(400"),
        ({"means": np.zeros((400, 3))}, st.ShapeError, "means"),
    ],
)
def test_what_cannot_be_updated_is_refused(columns: dict[str, np.ndarray], kind: type, message: str) -> None:
    with st.open_session(st.Scene.flat(gaussians(400, 1))) as session:
        before = session.draw(VIEWS[0])
        with pytest.raises(kind, match=message):
            session.update(columns)
        assert same_picture(session.draw(VIEWS[0]), before)


def test_the_index_of_a_tree_cannot_be_kept(scene: st.Scene) -> None:
    with (
        st.open_session(scene) as session,
        pytest.raises(st.InputError, match="found keep_index for a tree with levels"),
    ):
        session.update({"means": scene.gaussians.means}, keep_index=True)


def test_batches_and_evaluations_open_one_session(scene: st.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    from splatree.render import session as sessions

    opened = []
    made = sessions.Session.__init__

    def counted(self: object, *words: object, **named: object) -> None:
        opened.append(self)
        made(self, *words, **named)  # type: ignore[arg-type, misc]

    monkeypatch.setattr(sessions.Session, "__init__", counted)
    for work in (
        lambda: list(st.render_batch(scene, VIEWS)),
        lambda: list(st.trace_batch(scene, VIEWS)),
        lambda: list(st.evaluate(scene, VIEWS)),
        lambda: st.calibrate(scene, VIEWS[:2]),
        lambda: st.time_frames(scene, VIEWS, views=3, warm_up=1),
    ):
        opened.clear()
        work()
        assert len(opened) == 1


@pytest.mark.parametrize("wrong", [None, {}, list(VIEWS)])
def test_what_is_no_camera_is_refused_by_its_kind(scene: st.Scene, wrong: Any) -> None:
    for use in (st.render, st.select):
        with pytest.raises(
            st.InputError, match=rf"^camera: found {type(wrong).__name__}, wanted one Camera; .*render_batch"
        ):
            use(scene, wrong)
