"""Options of another function are named at every public function that takes some, not met as a missing attribute within."""

import pytest

import splatree as st

from ..scenes import random_gaussians

SCENE = st.Scene.flat(random_gaussians(30))
CAMERA = st.Camera.look_at([0, 0, -6], [0, 0, 0], width=16, height=16)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda path: st.render(SCENE, CAMERA, st.SelectOptions()),
            "options: found SelectOptions, wanted RenderOptions",
        ),
        (lambda path: st.trace(SCENE, CAMERA, st.SelectOptions()), "found SelectOptions, wanted RenderOptions"),
        (
            lambda path: st.render(SCENE, CAMERA, None, st.RenderOptions()),
            "select: found RenderOptions, wanted SelectOptions",
        ),
        (lambda path: st.select(SCENE, CAMERA, st.RenderOptions()), "found RenderOptions, wanted SelectOptions"),
        (
            lambda path: list(st.evaluate(SCENE, [CAMERA], st.SelectOptions())),
            "found SelectOptions, wanted RenderOptions",
        ),
        (lambda path: st.calibrate(SCENE, [CAMERA], options=st.RenderOptions()), "wanted CalibrateOptions"),
        (lambda path: st.build_lod(SCENE, {"method": "pairs"}), "build_lod: options: found dict, wanted BuildOptions"),
        (lambda path: st.thin(SCENE, 0.5), "thin: options: found 0.5, wanted ThinOptions"),
        (lambda path: st.clean(SCENE, st.EditOptions()), "clean: options: found EditOptions, wanted CleanOptions"),
        (lambda path: st.edit(SCENE, st.CleanOptions()), "edit: options: found CleanOptions, wanted EditOptions"),
        (lambda path: st.edit(SCENE.gaussians, st.EditOptions()), "edit: found Gaussians, wanted a Scene"),
        (lambda path: st.clean(SCENE.gaussians, st.CleanOptions()), "clean: found Gaussians, wanted a Scene"),
        (lambda path: st.orbit(SCENE, st.RenderOptions()), "found RenderOptions, wanted PathOptions"),
        (
            lambda path: st.write(SCENE, path / "a.ply", options=st.ReadOptions()),
            "found ReadOptions, wanted WriteOptions",
        ),
        (lambda path: st.convert(path / "a.ply", path / "b.ply", st.EditOptions()), "wanted ConvertOptions"),
        (lambda path: st.stream(SCENE, path / "s", options=st.BuildOptions()), "wanted StreamOptions"),
        (lambda path: st.stream(SCENE.gaussians, path / "s"), "stream: found Gaussians, wanted a Scene"),
        (lambda path: st.write_cameras(CAMERA, path / "c.json"), "found one Camera, wanted some, such as"),
        (lambda path: st.write_cameras([], path / "c.json"), "found no Camera, wanted a list"),
        (
            lambda path: list(st.render_batch(SCENE, CAMERA)),
            r"cameras: found one Camera, wanted some, such as \[camera\]",
        ),
        (lambda path: list(st.trace_batch(SCENE, 5)), "cameras: found int, wanted some"),
        (lambda path: list(st.evaluate(SCENE, CAMERA)), "cameras: found one Camera, wanted some"),
        (lambda path: st.calibrate(SCENE, CAMERA), "cameras: found one Camera, wanted some"),
        (lambda path: st.refine(st.build_lod(SCENE), cameras=CAMERA), "cameras: found one Camera, wanted some"),
        (lambda path: st.time_frames(SCENE, CAMERA), "cameras: found one Camera, wanted some"),
        (lambda path: list(st.render_batch(SCENE, [SCENE])), "camera: found Scene, wanted one Camera"),
        (lambda path: st.orbit(SCENE.gaussians), "orbit: found Gaussians, wanted a Scene"),
        (lambda path: st.write_image([[1.0]], path / "a.png"), "write_image: found list, wanted a NumPy array"),
        (lambda path: st.write_cameras([SCENE], path / "c.json"), "camera: found Scene, wanted one Camera"),
    ],
)
def test_options_of_another_kind_are_named(tmp_path, call, message):
    with pytest.raises(st.InputError, match=message):
        call(tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("threads", [-1, 4097, 10**20, 1.0, "2", True])
@pytest.mark.parametrize(
    "call",
    [
        lambda path, threads: st.render(SCENE, CAMERA, threads=threads),
        lambda path, threads: st.build_lod(SCENE, threads=threads),
        lambda path, threads: st.build_clusters(SCENE, 2, threads=threads),
        lambda path, threads: st.thin(SCENE, st.ThinOptions(keep=0.5), threads=threads),
        lambda path, threads: st.refine(SCENE, threads=threads),
        lambda path, threads: st.stream(SCENE, path / "s", threads=threads),
        lambda path, threads: st.train(path, threads=threads),
    ],
    ids=["render", "build_lod", "build_clusters", "thin", "refine", "stream", "train"],
)
def test_what_is_no_number_of_threads_is_refused(tmp_path, call, threads):
    with pytest.raises(st.InputError, match=r"threads: found .*, wanted 1 to 4096, or 0 for all"):
        call(tmp_path, threads)
    assert not list(tmp_path.iterdir())
