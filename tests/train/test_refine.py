"""Refinement: pictures get better, and nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.kernels.devices import training_stages_of
from splatree.scene.frame import Splats
from splatree.scene.gradients import GaussianGradients, PictureGradients, SplatGradients
from splatree.train import school
from splatree.train.lessons import Lesson, lessons_of, made_views
from splatree.train.proxies import Proxies

from ..scenes import cloud, surface

FEW = st.RefineOptions(iterations=60, made_views=16)


@pytest.fixture(scope="module", params=["pairs", "radius", "antialiased"])
def tree(request):
    mode = "antialiased" if request.param == "antialiased" else "classic"
    method = "radius" if request.param == "radius" else "pairs"
    return st.build_lod(st.Scene.flat(surface(4000, degree=1), mode=mode), st.BuildOptions(method))


@pytest.fixture(scope="module")
def refined(tree):
    return st.refine(tree, FEW, threads=2)


def test_pictures_get_better(tree, refined):
    assert refined.iterations == 60 and refined.num_learned > 0
    assert refined.gain > 0.02
    # What is gained is in the file's own picture too, not only in what was learned from.
    views = made_views(tree, 16, seed=7)
    before, after = ([], [])
    for lesson in lessons_of(tree, views, "same"):
        for scene, scores in ((tree, before), (refined.scene, after)):
            image = np.clip(st.render(scene, lesson.camera, select=st.SelectOptions(pixel_error=8)).image, 0, 1)
            scores.append(min(80, st.psnr(image, lesson.picture.astype(np.float32) / 255)))
    assert np.mean(after) > np.mean(before)


def test_leaves_and_the_tree_stay_bit_for_bit(tree, refined):
    scene, is_leaf = refined.scene, tree.tree.is_leaf
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        a, b = getattr(tree.gaussians, name), getattr(scene.gaussians, name)
        np.testing.assert_array_equal(a[is_leaf], b[is_leaf])
    np.testing.assert_array_equal(tree.gaussians.means, scene.gaussians.means)
    np.testing.assert_array_equal(tree.gaussians.sh[:, 1:], scene.gaussians.sh[:, 1:])
    for name in ("subtree_end", "depth", "extents"):
        np.testing.assert_array_equal(getattr(tree.tree, name), getattr(scene.tree, name))
    assert scene.tree.record == tree.tree.record and scene.mode == tree.mode


def test_the_cut_is_the_same(tree, refined):
    """Which nodes stand for which does not change; where shapes do, a node at the border may come into view or leave it."""
    for camera in made_views(tree, 12, seed=3):
        options = st.SelectOptions(pixel_error=6, view_test="none")
        np.testing.assert_array_equal(
            st.select(tree, camera, options).rows, st.select(refined.scene, camera, options).rows
        )


def test_the_same_steps_give_the_same_bits_for_any_number_of_threads(tree, refined):
    one = st.refine(tree, FEW, threads=1)
    assert one.num_learned == refined.num_learned
    for name in ("quats", "log_scales", "logit_opacities", "sh"):
        np.testing.assert_array_equal(getattr(refined.scene.gaussians, name), getattr(one.scene.gaussians, name))


def test_a_file_keeps_what_was_learned(refined, tmp_path):
    st.write(refined.scene, tmp_path / "a.splatree")
    read = st.read(tmp_path / "a.splatree")
    np.testing.assert_array_equal(read.gaussians.logit_opacities, refined.scene.gaussians.logit_opacities)
    assert "gain_db" in read.source.metadata["refined"]
    camera = made_views(read, 1, seed=5)[0]
    np.testing.assert_array_equal(st.render(read, camera).image, st.render(refined.scene, camera).image)


def test_what_is_drawn_while_learning_is_what_the_scene_draws(tree):
    """Before the first step, and after nodes were changed and stored."""
    proxies = Proxies(tree)
    camera = made_views(tree, 1, seed=2)[0]
    view = st.open_session(tree).view(camera)
    rows = st.select(tree, camera, st.SelectOptions(pixel_error=6)).rows
    rng = np.random.default_rng(0)
    for _ in range(2):
        proxies.draw(view, rows)
        scene = proxies.scene()
        shown = st.render(scene, camera, select=lambda view, *, threads=0: st.Selection(rows, "cut", None, 6.0))
        flat = st.Scene(
            proxies.drawn.take(rows),
            st.Scene.flat(proxies.drawn.take(rows)).tree,
            ids=rows.astype(np.uint32),
            mode=tree.mode,
        )
        learned = st.render(flat, camera, select=st.SelectOptions(pixel_error=0))
        # Shapes and opacities pass through a logarithm and back.
        assert st.psnr(learned.image, shown.image) > 75
        proxies.learned.logit_opacities[:] += rng.normal(0, 0.2, len(proxies.rows)).astype(np.float32)
        proxies.learned.sh[:] += rng.normal(0, 0.1, proxies.learned.sh.shape).astype(np.float32)
        if proxies.rates(1.0)[7]:
            proxies.learned.log_scales[:] += rng.normal(0, 0.1, (len(proxies.rows), 3)).astype(np.float32)


def test_a_node_that_forgets_has_its_first_bits(tree):
    proxies = Proxies(tree)
    rows = proxies.rows[::2]
    found = GaussianGradients(
        np.arange(len(proxies.rows), dtype=np.int32),
        *(
            np.ones_like(getattr(proxies.learned, name))
            for name in ("means", "quats", "log_scales", "logit_opacities", "sh")
        ),
    )
    training_stages_of("cpu").step(proxies.learned, found, proxies.moments, proxies.rates(1.0))
    proxies.paint(found, np.ones(len(proxies.rows), np.float32), 1.0)
    proxies.forget(rows)
    changed = proxies.scene().gaussians.sh[:, 0] != tree.gaussians.sh[:, 0]
    assert not changed[rows].any() and changed[proxies.rows[1::2]].any(axis=1).all()


@pytest.mark.parametrize("tree", ["pairs"], indirect=True)
def test_nodes_of_all_sizes_are_looked_at_before_they_keep_what_they_learned(tree, monkeypatch):
    looked_at, errors = [], school.School.errors
    monkeypatch.setattr(
        school.School, "errors", lambda self, lessons: looked_at.append(lessons) or errors(self, lessons)
    )
    st.refine(tree, st.RefineOptions(iterations=2, made_views=48, finest=2, coarsest=32))
    before, after = ([tau for _, tau in lessons] for lessons in looked_at)
    assert before == after  # or they could not be compared
    assert np.bincount(np.log2(before).astype(int), minlength=5)[1:].min() >= len(before) // 5  # of four octaves


@pytest.mark.parametrize("tau", [4, 12])
def test_a_step_of_all_colours_at_once_never_overshoots(tree, tau):
    """Even the longest one: the picture that it was made for comes nearer to the teacher's."""
    pupils = school.School(tree, training_stages_of("cpu"), 1)
    lesson = lessons_of(tree, made_views(tree, 1, seed=2), "same")[0]
    proxies, errors = pupils.proxies, []
    for _ in range(4):
        view, drawn, splats, bins, picture = pupils._draw(lesson.camera, tau)
        errors.append(np.square(picture.image - lesson.picture / 255.0).sum())
        few, sums = pupils._inner(splats, pupils._compared(lesson, view, splats, bins, picture))
        found = proxies.derivatives(drawn, few, pupils._stages.project_backward(proxies.drawn, few, sums, view))
        proxies.paint(found, sums.weights, 100.0)
    assert (np.diff(errors) < 0).all()


def test_slopes_that_are_no_numbers_move_nothing(tree):
    pupils = school.School(tree, training_stages_of("cpu"), 1)
    lesson = lessons_of(tree, made_views(tree, 1, seed=2), "same")[0]
    pupils.proxies.learned.sh[::7] = 3e38  # a sum over some pixels overflows
    with np.errstate(all="ignore"):
        pupils._step(lesson, 8, 1.0)
    for name in ("quats", "log_scales", "logit_opacities", "sh"):
        assert np.isfinite(getattr(pupils.proxies.learned, name)).all()


def test_nodes_around_which_pictures_are_right_keep_their_opacity_and_shape(tree):
    """The teacher shows what the cut shows, but for rounding, which Adam alone would take for a slope as any other."""
    camera = made_views(tree, 1, seed=2)[0]

    def moved(by):
        pupils = school.School(tree, training_stages_of("cpu"), 1)
        image = pupils._draw(camera, 8)[4].image
        lesson = Lesson(camera, np.rint(255 * np.clip(image + by, 0, 1)).astype(np.uint8))
        first = pupils.proxies.learned.logit_opacities.copy()
        pupils._step(lesson, 8, 1.0)
        return np.abs(pupils.proxies.learned.logit_opacities - first).max()

    assert 0 < moved(0) < 0.04 * moved(0.3)


@pytest.mark.parametrize("tree", ["pairs"], indirect=True)
def test_a_calibrated_threshold_and_clusters_are_dropped_and_said(tree):
    scene = st.build_clusters(tree, 8)
    calibrated = replace(scene, threshold=0.1, source=replace(scene.source, metadata={"calibration": "{}"}))
    found = st.refine(calibrated, FEW)
    assert found.scene.clusters is None and found.scene.threshold == pytest.approx(1 / 255)
    assert len(found.notes) == 2 and "calibrate" in found.notes[1]


def test_the_teacher_large_is_the_average_of_a_larger_picture(tree):
    view = made_views(tree, 1, seed=1)[0]
    everything = st.SelectOptions(pixel_error=0)
    image = st.render(tree, view.scaled(4), select=everything).image
    expected = np.clip(image, 0, 1).reshape(240, 4, 320, 4, 3).mean(axis=(1, 3))
    found = lessons_of(tree, [view], "large")[0].picture
    assert np.abs(found - 255 * expected).max() <= 0.51


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"minutes": 0}, "minutes: found 0"),
        ({"iterations": 0}, "iterations: found 0"),
        ({"made_views": 3}, "made_views: found 3"),
        ({"finest": 5.0, "coarsest": 2.0}, "finest, coarsest: found 5.0, 2.0"),
        ({"rate": 0}, "rate: found 0"),
        ({"teacher": "small"}, "teacher: found 'small'"),
    ],
)
def test_options_that_cannot_be_are_refused(change, said):
    with pytest.raises(st.InputError, match=said):
        st.RefineOptions(**change)


def test_scenes_and_cameras_that_cannot_be_are_refused(tree):
    with pytest.raises(st.InputError, match="scene without levels"):
        st.refine(st.Scene.flat(cloud(50)), FEW)
    with pytest.raises(st.InputError, match="found 1 camera, wanted at least 2"):
        st.refine(tree, FEW, cameras=made_views(tree, 1, 0))


@pytest.mark.parametrize("name", ["logit_opacities", "sh", "log_scales"])
def test_what_nodes_learn_from_is_the_slope_of_the_loss(tree, name):
    """Along the derivative itself: the loss in two scenes a little to either side, against the sum of its squares."""
    stages, gain = training_stages_of("cpu"), np.ones(3)
    lesson = lessons_of(tree, made_views(tree, 1, seed=2), "same")[0]
    view = st.open_session(tree).view(lesson.camera)
    rows = st.select(tree, lesson.camera, st.SelectOptions(pixel_error=12)).rows
    proxies = Proxies(tree)
    if name == "log_scales" and not proxies.rates(1.0)[7]:
        pytest.skip("levels by a radius do not learn shapes")

    def drawn():
        nodes = proxies.draw(view, rows)
        splats = stages.project(proxies.drawn, None, rows, view)
        bins = stages.bin(splats, view)
        picture = stages.blend(splats, bins, view)
        return nodes, splats, bins, picture, stages.photo_loss(picture.image, lesson.picture, gain, ssim_weight=0.9)

    nodes, splats, bins, picture, loss = drawn()
    sums = stages.blend_backward(splats, bins, view, picture, PictureGradients(loss.image))
    chosen = proxies.is_node(splats.rows)
    few = Splats(splats.rows[chosen], splats.records[chosen], np.arange(chosen.sum(), dtype=np.int32))
    of_few = SplatGradients(sums.moments[chosen], sums.colors[chosen])
    found = proxies.derivatives(nodes, few, stages.project_backward(proxies.drawn, few, of_few, view))
    slopes, column = getattr(found, name), getattr(proxies.learned, name)
    first, step = column.copy(), 0.02 / np.abs(slopes).max()
    values, ends = [], []
    for sign in (-1, 1):
        column[:] = first
        column[found.rows] += np.float32(sign * step) * slopes
        values.append(drawn()[4].value)
        ends.append(column[found.rows].astype(float))  # where the mass of a node is held, drawing holds it
    expected = float(np.sum(slopes * (ends[1] - ends[0])))
    # |x| has a kink, and opacities end at 1/255.
    assert values[1] - values[0] == pytest.approx(expected, rel=0.25)
