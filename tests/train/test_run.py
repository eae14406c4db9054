"""A run as a whole: it learns, the same way each time, and never looks at what is held out."""

import json
import shutil
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

import splatree as st
from splatree.io.cameras.files import read_cameras
from splatree.kernels.devices import training_stages_of
from splatree.train.prepare import prepare
from splatree.train.run import _beginning
from splatree.train.step import Drawing, drawn
from splatree.train.targets import divided

from .conftest import views, write_colmap

OPTIONS = st.TrainOptions(iterations=30, max_gaussians=260, held_out=4)


def bits(trained):
    """All columns of the scene, as bytes."""
    gaussians = trained.scene.gaussians
    return [getattr(gaussians, field.name).tobytes() for field in fields(gaussians)]


class Watched:
    """Which files are opened, while it is on."""

    def __init__(self):
        self.opened, self.is_on = [], False
        sys.addaudithook(self._hook)

    def _hook(self, event, arguments):
        if self.is_on and event == "open":
            self.opened.append(str(arguments[0]))


@pytest.fixture(scope="module")
def watched():
    return Watched()


@pytest.fixture(scope="module")
def whole(kept_photographs):
    return st.train(kept_photographs, OPTIONS)


def test_held_out_photographs_that_are_missing_cost_the_scores_alone(whole, photographs):
    (photographs / "images" / "photo_0.png").unlink()
    trained = st.train(photographs, OPTIONS)
    assert bits(trained) == bits(whole)
    assert trained.history[-1].score.psnr is None and whole.history[-1].score.psnr is not None
    assert trained.notes[-1] == "no photograph of 1 of the 1 held-out views, which count in no score: photo_0.png"


def test_reading_the_photographs_is_part_of_the_time_of_a_run(photographs):
    work = prepare(photographs, OPTIONS, None)
    assert work.reading_s > 0 and _beginning(replace(work, reading_s=1e6)).spent_s > 1e6


@pytest.mark.parametrize("share", [0.01, 0.9])
@pytest.mark.parametrize(
    ("name", "advice"),
    [("photo_0.png", "; it belongs to a held-out view: mend or remove it, or train"), ("photo_2.png", "")],
)
def test_a_damaged_photograph_is_told_before_the_first_step(photographs, name, advice, share):
    """In its head, or behind it: a JPEG, whose head can be read alone. Those who want no scores need no held-out one."""
    from PIL import Image

    path = photographs / "images" / name
    Image.open(path).save(path, format="JPEG")
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(st.FormatError, match=f"{name}: .*{advice}"):
        prepare(photographs, OPTIONS, None)
    if advice:
        assert prepare(photographs, replace(OPTIONS, score=False), None).held_out is None


def test_a_toy_is_learned(photographs):
    """More than 10 dB in 400 steps on the photographs that are trained on: the smallest proof that all derivatives point down."""
    options = st.TrainOptions(iterations=400, max_gaussians=300, held_out=4, exposure="none")
    trained = st.train(photographs, options)

    def quality(gaussians):
        scores = []
        for camera in read_cameras(photographs).views[1:]:
            photo = st.read_image(photographs / "images" / camera.name)
            scores.append(st.psnr(np.clip(st.render(st.Scene.flat(gaussians), camera).image, 0, 1), photo))
        return np.mean(scores)

    start = st.train(photographs, st.TrainOptions(iterations=1, max_gaussians=300, held_out=4))
    assert quality(trained.scene.gaussians) > quality(start.scene.gaussians) + 10
    assert trained.history[-1].score.psnr > 18  # and the view that was held out is drawn, too
    assert 200 < len(trained.scene) <= 300


def test_training_draws_what_render_draws(whole, photographs):
    camera = read_cameras(photographs)[1]
    for mode in ("classic", "antialiased"):
        drawing = Drawing(training_stages_of("cpu"), mode, 1, 0)
        picture = drawn(whole.scene.gaussians, drawing.view(camera), drawing)[2]
        options = st.RenderOptions(mode=mode)
        np.testing.assert_array_equal(picture.image, st.render(whole.scene, camera, options).image)


def test_steps_draw_small_photographs_with_the_dilation_of_large_ones(photographs, truth, monkeypatch):
    """Until photographs are compared at their largest size; scores are of that size alone."""
    cameras = views(4, size=224)
    shutil.rmtree(photographs / "sparse")
    write_colmap(photographs, cameras, truth.gaussians.means, np.full((len(truth), 3), 128))
    for camera in cameras:
        st.write_image(np.zeros((224, 224, 3), np.float32), photographs / "images" / camera.name, force=True)
    found, usual = set(), Drawing.view

    def view(self, camera):
        made = usual(self, camera)
        found.add((camera.width, round(made.dilation_px2, 4)))
        return made

    monkeypatch.setattr(Drawing, "view", view)
    st.train(photographs, st.TrainOptions(iterations=10, max_gaussians=260, held_out=4))
    assert found == {(224, 0.3), (112, round((0.3 + 3 / 12) / 4, 4))}


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("k", [2, 4])
def test_small_pictures_of_training_are_means_of_large_ones(truth, mode, k):
    """To 3 dB and more nearer than with the dilation of large ones, for Gaussians of about a pixel of the small ones."""
    gaussians = truth.gaussians.take(slice(None))
    gaussians.log_scales[:] -= 1
    camera = views(1, size=128)[0]
    drawing = Drawing(training_stages_of("cpu"), mode, 1, 0)
    large = drawn(gaussians, drawing.view(camera), drawing)[2].image
    means = large.reshape(128 // k, k, 128 // k, k, 3).mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
    small = divided(camera, k)
    usual, adapted = (
        st.psnr(
            np.clip(drawn(gaussians, replace(drawing, times_smaller=times).view(small), drawing)[2].image, 0, 1), means
        )
        for times in (1, k)
    )
    assert adapted > usual + 3, (usual, adapted)


def test_threads_change_no_bit(photographs):
    options = st.TrainOptions(iterations=120, max_gaussians=260, held_out=4)  # with births at step 100
    one, seven = (st.train(photographs, options, threads=threads) for threads in (1, 7))
    assert bits(one) == bits(seven)
    assert len(one.scene) > one.history[0].num_gaussians or len(one.scene) == 260


def test_held_out_photographs_are_never_opened(photographs, watched):
    watched.opened.clear()
    watched.is_on = True
    try:
        st.train(photographs, st.TrainOptions(iterations=3, max_gaussians=260, held_out=4, score=False))
    finally:
        watched.is_on = False
    opened = [name for name in watched.opened if name.endswith(".png")]
    assert {name.rsplit("/", 1)[1] for name in opened} == {"photo_1.png", "photo_2.png", "photo_3.png"}


def test_what_is_held_out_changes_no_bit(whole, photographs):
    """Scores open them; the scene does not depend on what is in them."""
    noise = np.random.default_rng(1).random((64, 64, 3), np.float32)
    st.write_image(noise, photographs / "images" / "photo_0.png", force=True)
    other = st.train(photographs, OPTIONS)
    assert other.history[-1].score != whole.history[-1].score
    assert bits(other) == bits(whole)


def test_a_scene_says_how_it_was_trained(whole, tmp_path):
    st.write(whole.scene, tmp_path / "a.splatree")
    record = json.loads(st.read(tmp_path / "a.splatree").source.metadata["training"])
    assert record["options"]["max_gaussians"] == 260 and record["iterations"] == 30
    assert record["photographs"] == 3 and record["held_out"] == "every 4th view from the first: 1 of 4"
    assert record["score"]["psnr"] == whole.history[-1].score.psnr
    assert [scored.share for scored in whole.history][-1] == 1.0


def test_views_begin_where_training_began(photographs, tmp_path):
    scene = st.train(photographs, st.TrainOptions(iterations=2, max_gaussians=100, score=False)).scene
    near = scene.source.near
    assert 0 < near < 0.2  # a hundredth of the extent of the cameras
    st.write(scene, tmp_path / "trained.splatree")
    st.convert(
        tmp_path / "trained.splatree", tmp_path / "half.splatree", st.ConvertOptions(edit=st.EditOptions(scale=0.5))
    )
    kept, half = st.read(tmp_path / "trained.splatree"), st.read(tmp_path / "half.splatree")
    assert kept.source.near == near
    assert half.source.near == st.edit(scene, st.EditOptions(scale=0.5)).source.near == 0.5 * near
    assert st.read([tmp_path / "trained.splatree", tmp_path / "half.splatree"]).source.near == 0.5 * near
    views = st.read_cameras(photographs, source=kept.source)
    assert {view.near for view in views} == {near}
    chosen = st.Cameras((replace(views.views[0], near=0.7),))
    assert chosen.relative_to(kept.source).views[0].near == 0.7
    with pytest.raises(st.InputError, match="near: found 'far', wanted a number"):
        read_cameras(photographs).relative_to(replace(kept.source, metadata={"near": "far"}))


def test_minutes_are_a_budget_and_their_log_repeats_the_run(photographs, tmp_path):
    files = st.RunFiles(tmp_path / "a.run")
    options = st.TrainOptions(minutes=0.01, max_gaussians=260, held_out=4)
    first = st.train(photographs, options, files=files)
    assert first.history[-1].cpu_s >= 0.6
    again = st.train(photographs, options, files=st.RunFiles(replay=tmp_path / "a.run" / "log.json"))
    assert bits(again) == bits(first) and again.log == first.log


def test_exposure_is_told_apart_and_has_a_mean_of_one(photographs):
    """One photograph is half as bright: its gain goes down, the others' up, and their geometric mean stays."""
    path = photographs / "images" / "photo_2.png"
    st.write_image(0.5 * st.read_image(path), path, force=True)
    found = st.train(photographs, st.TrainOptions(iterations=150, max_gaussians=260, held_out=4)).exposures
    gains = {name: np.diag(exposure) for name, exposure in found.items()}
    ratio = np.array(gains["photo_2.png"]) / np.sqrt(np.array(gains["photo_1.png"]) * np.array(gains["photo_3.png"]))
    assert (ratio < 0.8).all()
    np.testing.assert_allclose(np.prod([*gains.values()], axis=0), 1, rtol=1e-9)
    none = st.TrainOptions(iterations=20, max_gaussians=260, held_out=4, exposure="none")
    for exposure in st.train(photographs, none).exposures.values():
        np.testing.assert_array_equal(exposure, np.eye(3, 4))


def test_a_tint_of_one_photograph_is_told_apart_by_affine_exposure(photographs):
    path = photographs / "images" / "photo_2.png"
    photo = st.read_image(path)
    st.write_image(
        np.stack([photo[..., 0], 0.5 * photo[..., 1] + 0.5 * photo[..., 0], photo[..., 2]], axis=2), path, force=True
    )
    options = st.TrainOptions(iterations=300, max_gaussians=300, held_out=4, exposure="affine")
    found = st.train(photographs, options).exposures
    others = 0.5 * (found["photo_1.png"] + found["photo_3.png"])
    assert found["photo_2.png"][1, 0] > others[1, 0] + 0.05 and found["photo_2.png"][1, 1] < others[1, 1] - 0.05


def test_masked_pixels_are_not_learned(photographs):
    """A photograph that is wrong where its mask is black trains the same scene, bit for bit."""
    masks = photographs / "masks"
    masks.mkdir()
    mask = np.ones((64, 64, 3), np.float32)
    mask[20:40, 10:30] = 0
    for i in range(1, 4):
        st.write_image(mask, masks / f"photo_{i}.png")
    options = st.TrainOptions(iterations=20, max_gaussians=260, held_out=4, masks=masks)
    right = st.train(photographs, options)
    path = photographs / "images" / "photo_1.png"
    photo = st.read_image(path)
    photo[25:35, 15:25] = (
        1,
        0,
        1,
    )  # seen by no pixel that counts: further from the border than SSIM's window would reach
    st.write_image(photo, path, force=True)
    wrong = st.train(photographs, options)
    unmasked = st.train(photographs, st.TrainOptions(iterations=20, max_gaussians=260, held_out=4))
    assert bits(wrong) == bits(right) != bits(unmasked)


def test_alpha_of_photographs_is_a_mask(photographs):
    from PIL import Image

    path = photographs / "images" / "photo_1.png"
    pixels = np.asarray(Image.open(path)).copy()
    alpha = np.full((64, 64), 255, np.uint8)
    alpha[:, :20] = 0
    options = st.TrainOptions(iterations=10, max_gaussians=260, held_out=4)
    found = []
    for value in (0, 255):
        pixels[:, :20] = value
        Image.fromarray(np.dstack([pixels, alpha])).save(path)
        found.append(bits(st.train(photographs, options)))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("first_column", "numbers"), [(0, (None, None)), (40, ("found", None)), (20, ("found", "found"))]
)
def test_held_out_photographs_with_few_pixels_that_count_are_scored_by_those(photographs, first_column, numbers):
    """Of an object that is in the right half of its photograph, no gain can be fitted on the left half."""
    mask = np.zeros((64, 64, 3), np.float32)
    mask[:, 64 if first_column == 0 else first_column :] = 1
    (photographs / "masks").mkdir()
    for i, camera in enumerate(read_cameras(photographs).views):
        st.write_image(np.ones_like(mask) if i % 2 else mask, photographs / "masks" / camera.name)
    trained = st.train(
        photographs, st.TrainOptions(iterations=10, max_gaussians=260, held_out=2, masks=photographs / "masks")
    )
    score = trained.history[-1].score
    assert [None if x is None else "found" for x in (score.psnr, score.psnr_fitted)] == list(numbers)
    assert score.psnr is None or 5 < score.psnr < 60


def test_alpha_of_photographs_can_be_matched(photographs, truth):
    """Photographs of an object before nothing: the scene becomes as transparent, whatever colour they have there."""
    from PIL import Image

    cameras = read_cameras(photographs).views
    for i, camera in enumerate(cameras):
        drawn = st.render(truth, camera)
        color = np.clip(drawn.image / np.maximum(drawn.alpha, 1e-6)[..., None], 0, 1)
        color[drawn.alpha < 1 / 255] = (0, 1, 0) if i % 2 else (1, 0, 1)
        pixels = np.rint(255 * np.dstack([color, drawn.alpha])).astype(np.uint8)
        Image.fromarray(pixels).save(photographs / "images" / camera.name)
    wrong = {}
    for kind in ("mask", "match"):
        scene = st.train(photographs, st.TrainOptions(iterations=300, max_gaussians=300, held_out=4, alpha=kind)).scene
        wrong[kind] = np.mean(
            [np.abs(st.render(scene, c).alpha - st.render(truth, c).alpha).mean() for c in cameras[1:]]
        )
    assert wrong["match"] < 0.5 * wrong["mask"] and wrong["match"] < 0.1


def test_points_leave_room(photographs):
    """200 points and 100 Gaussians: a tenth is left for what points do not reach."""
    work = prepare(photographs, st.TrainOptions(iterations=1, max_gaussians=100, held_out=4), None)
    assert len(work.points) > 100
    gaussians = work.start()
    assert len(gaussians) == 100
    places = {tuple(place) for place in work.points.places.astype(np.float32)}
    assert sum(tuple(place) in places for place in gaussians.means) == 90


def test_objects_stand_before_nothing(photographs, monkeypatch):
    """What lies beyond the borders of photographs is made up, but not where alpha says that there is nothing."""
    monkeypatch.setattr(
        sys.modules[prepare.__module__], "add_apron", lambda gaussians, *others, room: gaussians.take(slice(7))
    )
    found = {
        kind: len(prepare(photographs, st.TrainOptions(iterations=1, held_out=4, alpha=kind), None).start())
        for kind in ("mask", "match")
    }
    assert found["mask"] == 7 and found["match"] > 7


def test_small_photographs_hold_the_count_down(photographs, truth, tmp_path):
    """Three photographs of 224 px have 627 times 60 pixels at half of their size. A run that was stopped there keeps its bits."""
    cameras = views(4, size=224)
    shutil.rmtree(photographs / "sparse")
    write_colmap(photographs, cameras, truth.gaussians.means, np.full((len(truth), 3), 128))
    for camera in cameras:
        image = np.clip(st.render(truth, camera).image, 0, 1)
        st.write_image(image, photographs / "images" / camera.name, force=True)
    options = st.TrainOptions(iterations=250, max_gaussians=1000, held_out=4, score=False)
    whole = st.train(photographs, options, threads=1)
    counts = [scored.num_gaussians for scored in whole.history]
    assert counts[0] == 627 and counts[1] > 800
    steps = iter(range(250))
    files = st.RunFiles(tmp_path / "a.run")
    assert st.train(photographs, options, files=files, stop=lambda: next(steps) == 150, threads=2).stopped
    resumed = st.train(photographs, options, files=replace(files, resume=True), threads=2)
    assert bits(resumed) == bits(whole)


def test_one_photograph_is_too_few(photographs):
    for i in range(1, 4):
        (photographs / "images" / f"photo_{i}.png").unlink()
    with pytest.raises(st.InputError, match=r"none of the 1 pictures .* is named like one of the 3 cameras"):
        st.train(photographs, OPTIONS)
    with pytest.raises(st.InputError, match="found a photograph of 1 of the 2 training views, wanted at least 2"):
        held_out = photographs / "held_out.txt"
        held_out.write_text("photo_1.png\nphoto_2.png\n")
        st.train(photographs, st.TrainOptions(iterations=1, held_out=held_out))


def test_a_model_of_one_view_leaves_none_to_train_on(photographs):
    model = photographs / "sparse" / "0" / "images.txt"
    model.write_text("\n".join(model.read_text().splitlines()[:2]) + "\n")
    with pytest.raises(st.InputError, match="found 0 of 1 views to train on, wanted at least 2"):
        st.train(photographs, OPTIONS)


def test_a_run_without_points_says_so(photographs):
    (photographs / "sparse" / "0" / "points3D.txt").unlink()
    trained = st.train(photographs, st.TrainOptions(iterations=1, max_gaussians=100, held_out=4))
    assert "no points came with the cameras" in trained.notes[-1] and len(trained.scene) == 100


def test_poses_that_are_no_numbers_are_refused(photographs):
    images = photographs / "sparse" / "0" / "images.txt"
    lines = images.read_text().splitlines()
    words = lines[2].split()
    lines[2] = " ".join([words[0], "nan", *words[2:]])
    images.write_text("\n".join(lines) + "\n")
    with pytest.raises(st.FormatError, match=r"picture 'photo_1.png': found quaternion and translation"):
        st.train(photographs, OPTIONS)


def test_cameras_at_one_place_are_refused(photographs):
    images = photographs / "sparse" / "0" / "images.txt"
    pose = images.read_text().splitlines()[0].split()[1:8]
    images.write_text("\n".join(f"{i + 1} {' '.join(pose)} 1 photo_{i}.png\n" for i in range(4)))
    with pytest.raises(st.InputError, match="found all 3 training views at one place"):
        st.train(photographs, OPTIONS)


def test_coordinates_far_from_zero_lose_nothing(photographs, truth, tmp_path):
    """Georeferenced cameras and points, at a northing where float32 has steps of half a unit."""
    far = np.array([5e5, 4.5e6, 100.0])
    shutil.rmtree(photographs / "sparse")
    rng = np.random.default_rng(0)
    points = truth.gaussians.means + rng.normal(0, 0.05, (len(truth), 3)) + far
    write_colmap(photographs, [view.moved(-far) for view in views(4)], points, rng.integers(80, 176, (len(truth), 3)))
    trained = st.train(photographs, st.TrainOptions(iterations=100, max_gaussians=260, held_out=4))
    assert np.abs(trained.scene.source.origin - far).max() <= 100
    assert trained.history[-1].score.psnr > 18


def test_the_kernels_learn_what_the_definitions_learn(photographs):
    """A few steps on either: float32 against float64, whose differences Adam lifts where a derivative is nearly zero."""
    options = st.TrainOptions(iterations=4, max_gaussians=260, held_out=4, score=False)
    fast, slow = (st.train(photographs, options, device=device).scene for device in ("cpu", "reference"))
    camera = read_cameras(photographs)[0]
    assert st.psnr(st.render(fast, camera).image, st.render(slow, camera).image) > 60


def test_a_back_end_that_only_draws_is_refused(photographs, monkeypatch):
    from splatree.kernels.cpu.frame import stages

    monkeypatch.delattr(stages, "project_backward")
    with pytest.raises(st.InputError, match="found 'cpu', which cannot train"):
        st.train(photographs, OPTIONS)


@pytest.mark.parametrize(
    ("value", "size", "found"),
    [
        (
            0,
            (64, 64),
            "masks: found no pixel that counts in the 3 photographs, wanted some that are white; masks of 0 and 1",
        ),
        (1, (64, 64), "masks: found no pixel that counts in the 3 photographs"),
        (
            255,
            (48, 64),
            r"photo_1.png: found 48 × 64 px, which is not the shape of its photograph 'photo_1.png', 64 × 64 px",
        ),
        (255, (32, 32), None),
    ],
)
def test_masks_that_leave_nothing_or_do_not_fit_are_refused(photographs, value, size, found):
    from PIL import Image

    (photographs / "masks").mkdir()
    for i in range(4):
        Image.new("L", size, value).save(photographs / "masks" / f"photo_{i}.png")
    options = replace(OPTIONS, iterations=1, masks=photographs / "masks")
    if found is None:
        assert st.train(photographs, options).history
        return
    with pytest.raises(st.InputError, match=found):
        st.train(photographs, options)


def test_photographs_that_are_transparent_everywhere_are_refused(photographs):
    from PIL import Image

    for path in (photographs / "images").iterdir():
        picture = Image.open(path).convert("RGBA")
        picture.putalpha(0)
        picture.save(path)
    with pytest.raises(
        st.InputError, match="photos: found no pixel that counts in the 3 photographs, wanted some whose alpha"
    ):
        st.train(photographs, OPTIONS)


def test_paths_may_be_texts(photographs):
    options = st.TrainOptions(iterations=1, max_gaussians=260, held_out=4)
    found = st.train(str(photographs), options, cameras=str(photographs / "sparse" / "0"))
    assert bits(found) == bits(st.train(photographs, options))


def test_points_that_no_view_shows_are_refused(photographs):
    points = photographs / "sparse" / "0" / "points3D.txt"
    points.write_text("1 0 -500 -500 9 9 9 0.5 1 0 2 0 3 0\n2 0 500 500 9 9 9 0.5 1 0 2 0 3 0\n")
    with pytest.raises(st.InputError, match="points: found none of 2 in the picture of any of the 3 training views"):
        st.train(photographs, OPTIONS)
    points.write_text(points.read_text() + "3 0 0 0 9 9 9 0.5 1 0 2 0 3 0\n")
    assert st.train(photographs, replace(OPTIONS, iterations=1)).history
