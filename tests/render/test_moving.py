"""Pictures of a camera that moves: what is kept between them, and that exact pictures stay exact."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

import splatree as st
from splatree.kernels.devices import DeviceName, stages_of
from splatree.render.moving import guarded_by, may_keep

from ..scenes import camera, gaussians
from .test_session import same_picture


@pytest.fixture(scope="module")
def scene() -> st.Scene:
    return st.build_lod(st.Scene.flat(gaussians(400, 1)))


def stepped(
    view: st.Camera, *, turn_deg: tuple[float, float] = (0.0, 0.0), shift: tuple[float, ...] = (0, 0, 0)
) -> st.Camera:
    """The camera turned about its own vertical and horizontal, and its eye moved along its own axes."""
    a, b = np.radians(turn_deg)
    turn, tilt = np.eye(4), np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(a), -np.sin(a), np.sin(a), np.cos(a)
    tilt[[1, 1, 2, 2], [1, 2, 1, 2]] = np.cos(b), -np.sin(b), np.sin(b), np.cos(b)
    pose = tilt @ turn @ view.camera_from_world
    pose[:3, 3] -= shift
    return replace(view, camera_from_world=pose)


def clipped(image: np.ndarray) -> np.ndarray:
    return np.clip(image, 0, 1)


@pytest.mark.parametrize("device", ["cpu", "reference"])
def test_a_moving_picture_is_that_of_the_cut_but_for_the_last_light(scene: st.Scene, device: DeviceName) -> None:
    with st.open_session(scene, device=device) as session:
        moved, exact = session.motion().draw(camera()), session.draw(camera())
    assert moved.alpha.shape == exact.alpha.shape
    # A pixel loses at most 1/255 of the light, of colours of at most 2; an exact one what a splat of T < 10⁻⁴ would add.
    assert np.abs(moved.image - exact.image).max() < 2 / 255 + 0.01
    assert not np.array_equal(moved.image, exact.image)


def test_the_cut_is_that_of_a_larger_picture(scene: st.Scene) -> None:
    for select in (st.SelectOptions(), st.SelectOptions(pixel_error=20), st.SelectOptions(pixel_error=0)):
        with st.open_session(scene, select=select) as session:
            moved = session.motion(st.Moving(guard=0.2)).draw(camera())
        wanted = st.select(scene, guarded_by(camera(), 0.2), select)
        np.testing.assert_array_equal(moved.selection.rows, wanted.rows)


def test_a_budget_is_of_the_nodes_in_the_picture(scene: st.Scene) -> None:
    all_nodes = len(st.select(scene, camera(), st.SelectOptions(pixel_error=0)))
    budget = all_nodes // 2
    with st.open_session(scene, select=st.SelectOptions(budget=budget)) as session:
        moved = session.motion(st.Moving(guard=0.0)).draw(camera())
        assert 0 < len(moved.selection) <= budget
        wider = session.motion(st.Moving(guard=0.25)).draw(camera())
        assert len(wider.selection) <= 2.25 * budget


def test_while_the_camera_moves_little_the_cut_is_kept(scene: st.Scene) -> None:
    with st.open_session(scene) as session:
        motion = session.motion()
        first = motion.draw(camera())
        again = motion.draw(camera())
        near_by = motion.draw(stepped(camera(), turn_deg=(0.5, 0.3), shift=(0.01, 0.0, 0.02)))
        assert (first.has_chosen, again.has_chosen, near_by.has_chosen) == (True, False, False)
        assert again.image.tobytes() == first.image.tobytes()
        assert near_by.selection is first.selection
        gathered = motion.draw(near_by.camera)
        assert not gathered.has_chosen and "gather" in gathered.milliseconds
        exact = session.draw(near_by.camera)
        assert (
            st.psnr(clipped(near_by.image), clipped(exact.image)) > 40
        )  # colours are those seen from 0.02 units beside
        for far in (
            stepped(camera(), turn_deg=(30, 0)),
            stepped(camera(), shift=(0, 0, 1.5)),
            stepped(camera(), turn_deg=(180, 0)),
            replace(camera(), K=camera().K * [[2], [2], [1]]),
            replace(camera(), near=0.5),
        ):
            motion.draw(camera())
            assert motion.draw(far).has_chosen


def test_a_camera_that_moves_fast_gets_cuts_of_its_own_pictures(scene: st.Scene) -> None:
    """Turning by half a degree a picture, a larger cut serves three more; by 4° it would serve one."""
    select = st.SelectOptions(pixel_error=4)

    def turned_again_and_again(degrees: float) -> list[tuple[bool, int]]:
        motion = session.motion()
        frames = [motion.draw(stepped(camera(), turn_deg=(i * degrees, 0))) for i in range(6)]
        return [(frame.has_chosen, len(frame.selection)) for frame in frames]

    with st.open_session(scene, select=select) as session:
        slow, fast = turned_again_and_again(0.5), turned_again_and_again(4)
        rests = session.motion()
        for degrees in (0, 4, 8, 8):
            kept = rests.draw(stepped(camera(), turn_deg=(degrees, 0)))
        assert not rests.draw(kept.camera).has_chosen  # it waits: from now on the cut is kept
    own = [len(st.select(scene, stepped(camera(), turn_deg=(i * 4.0, 0)), select)) for i in range(6)]
    assert [chosen for chosen, _ in slow] == [True] + 5 * [False]
    assert fast[0][1] > own[0] and fast[2:] == [(True, nodes) for nodes in own[2:]]


def test_whatever_changes_the_cut_chooses_it_anew(scene: st.Scene) -> None:
    with st.open_session(scene) as session:
        motion = session.motion()
        motion.draw(camera())
        assert not motion.draw(camera(), options=st.RenderOptions(background=(1, 0, 0))).has_chosen
        assert motion.draw(camera(), select=st.SelectOptions(pixel_error=9)).has_chosen
        assert motion.draw(camera(), options=st.RenderOptions(sh_degree=0)).has_chosen
        before = motion.draw(camera())
        session.update({"sh": scene.gaussians.sh * np.float32(0.5)})
        after = motion.draw(camera())
        assert after.has_chosen
        assert not np.array_equal(before.image, after.image)


def test_exact_pictures_of_the_same_session_keep_their_bits(scene: st.Scene) -> None:
    wanted = st.render(scene, camera())
    with st.open_session(scene) as session:
        motion = session.motion(st.Moving(target_ms=1e-6))
        for _ in range(3):
            motion.draw(camera())
            assert same_picture(session.draw(camera()), wanted)


def test_pictures_follow_the_time_that_they_take(scene: st.Scene) -> None:
    view = camera(160, 90)
    with st.open_session(scene) as session:
        hurried = session.motion(st.Moving(target_ms=1e-6, least_scale=0.5))
        widths = [hurried.draw(view).image.shape[1] for _ in range(12)]
        assert widths[0] == 160 and widths[-1] == 80 and sorted(widths, reverse=True) == widths
        turning = session.motion(st.Moving(target_ms=1e-6, least_scale=0.5))
        turned = [turning.draw(stepped(view, turn_deg=(4.0 * i, 0))).image.shape[1] for i in range(12)]
        assert turned[-1] == 80  # though each picture has a cut of its own
        patient = session.motion(st.Moving(target_ms=1e9))
        assert {patient.draw(view).image.shape for _ in range(3)} == {(90, 160, 3)}


@settings(max_examples=60, deadline=None)
@given(
    turn=some.tuples(some.floats(-8, 8), some.floats(-8, 8)),
    shift=some.tuples(*[some.floats(-0.3, 0.3)] * 3),
    guard=some.sampled_from([0.0, 0.05, 0.1, 0.3]),
)
def test_a_kept_cut_holds_what_can_be_seen(
    scene: st.Scene, turn: tuple[float, float], shift: tuple[float, float, float], guard: float
) -> None:
    """All leaves whose centres are in the new picture and that are as far away as the step is compared with."""
    kept, moved, distance = guarded_by(camera(), guard), stepped(camera(), turn_deg=turn, shift=shift), 4.0
    if not may_keep(kept, moved, distance=distance, step=0.05):
        return
    leaves = st.SelectOptions(pixel_error=0, view_test="none")
    centres = replace(leaves, view_test="centre")
    rows = st.select(scene, shrunk(moved), centres).rows
    far = np.linalg.norm(scene.gaussians.means[rows] - kept.position, axis=1) > distance * 1.05
    assert set(rows[far]) <= set(st.select(scene, kept, centres).rows)


def shrunk(view: st.Camera) -> st.Camera:
    """The test of centres enlarges a picture by a tenth, half on each side; this one ends up inside of the picture."""
    return guarded_by(view, -0.1)


def test_a_turn_is_allowed_up_to_the_guard() -> None:
    view = camera()
    kept = guarded_by(view, 0.1)
    half = np.degrees(np.arctan(view.width / 2 / view.K[0, 0]))
    edge = np.degrees(np.arctan(kept.width / 2 / view.K[0, 0]))
    assert may_keep(kept, stepped(view, turn_deg=(0.9 * (edge - half), 0)), distance=1, step=1e-6)
    assert not may_keep(kept, stepped(view, turn_deg=(1.1 * (edge - half), 0)), distance=1, step=1e-6)


def test_what_cannot_be_drawn_moving_is_refused(scene: st.Scene) -> None:
    for bad in ({"target_ms": 0}, {"least_scale": 0}, {"guard": -0.1}, {"step": 2}):
        with pytest.raises(st.InputError, match=f"{next(iter(bad))}: found"):
            st.Moving(**bad)
    session = st.open_session(scene)
    motion = session.motion()
    session.close()
    with pytest.raises(st.InputError, match="session: found it closed"):
        motion.draw(camera())
    with (
        st.open_session(scene, select=lambda view, threads=0: st.select(scene, view)) as baseline,
        pytest.raises(st.InputError, match="motion: found a baseline"),
    ):
        baseline.motion()


@pytest.mark.parametrize("least_light", [1 / 255, 0.3])
def test_pixels_are_finished_by_the_light_that_is_left(scene: st.Scene, least_light: float) -> None:
    frame = st.trace(scene, camera(), select=st.SelectOptions(pixel_error=0))
    view = replace(frame.view, least_light=least_light, wanted=st.Wanted(depth=False))
    pictures = [stages_of(device).blend(frame.splats, frame.bins, view) for device in ("cpu", "reference")]
    # Where a pixel ends is a step: a rounding may let a pixel end a splat earlier or later, which moves at most what is left.
    assert np.abs(pictures[0].image - pictures[1].image).max() < 2 * least_light
    assert np.mean(np.abs(pictures[0].image - pictures[1].image) > 1e-4) < 0.002
    assert (1 - pictures[0].alpha >= 0).all() and pictures[0].num_blended <= frame.picture.num_blended
    with pytest.raises(st.InputError, match=r"least_light: found .* wanted no output beside colour and alpha"):
        replace(frame.view, least_light=least_light)


def test_a_picture_without_depth_has_the_same_colours(scene: st.Scene) -> None:
    frame = st.trace(scene, camera())
    view = replace(frame.view, wanted=st.Wanted(depth=False))
    for device in ("cpu", "reference"):
        stages = stages_of(device)
        with_depth, without = (stages.blend(frame.splats, frame.bins, v) for v in (frame.view, view))
        assert without.depth is None and with_depth.depth is not None
        assert without.image.tobytes() == with_depth.image.tobytes()
        assert without.alpha.tobytes() == with_depth.alpha.tobytes()
