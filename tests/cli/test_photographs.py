"""Verbs that compare with photographs say which ones they took, and never score a view by a wrong one."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from splatree.io.cameras.files import write_cameras
from splatree.io.images import write_image
from splatree.io.reading import read
from splatree.render.paths import PathOptions, flyout
from splatree.render.pipeline import render
from splatree.scene.options import SelectOptions

from .test_commands import result_of


@pytest.fixture
def data(small_tree, tmp_path):
    """A folder of nine cameras and their pictures, and masks beside them."""
    scene = read(small_tree)
    cameras = flyout(scene, PathOptions(views=9, width=64, height=36))
    write_cameras(cameras, tmp_path / "cameras.json")
    for folder in ("images", "masks"):
        (tmp_path / folder).mkdir()
    for camera in cameras:
        image = render(scene, camera, select=SelectOptions(pixel_error=0)).image
        write_image(image, tmp_path / "images" / f"{camera.name}.png")
        write_image(np.ones_like(image), tmp_path / "masks" / f"{camera.name}.png")
    return tmp_path


@pytest.fixture
def evaluated(splatree, small_tree, data):
    def run(*words):
        return splatree("eval", small_tree, "--data", data, "--frames", "0", "--pixel-error", "0", *words)

    return run


def test_masks_beside_the_photographs_change_no_score(evaluated):
    found = result_of(evaluated("--json"))
    assert found["mean"]["psnr_vs_photo"] > 54 and found["photographs"]["folders"] == {"images": 9}
    code, out, _ = evaluated()
    assert code == 0 and "photographs: 9 in images/" in out


def test_the_exposure_of_photographs_is_told_apart(evaluated, data):
    for path in (data / "images").iterdir():
        write_image(0.8 * np.asarray(Image.open(path), np.float32) / 255, path, force=True)
    mean = result_of(evaluated("--json"))["mean"]
    assert mean["psnr_fitted_vs_photo"] > 48 > 30 > mean["psnr_vs_photo"]  # what is left is rounding to 8 bits, twice
    assert mean["leaves_psnr_fitted_vs_photo"] > 48
    assert "leaves fitted" in evaluated()[1]


def test_a_missing_photograph_is_told_and_leaves_the_means(evaluated, data):
    (data / "images" / "view_0000.png").unlink()
    found = result_of(evaluated("--json"))
    assert found["photographs"]["missing"] == ["view_0000"] and found["mean"]["psnr_vs_photo"] > 54
    assert found["compared_with"].endswith("2 of 9; 1 of these 2 have one")
    _, out, _ = evaluated()
    assert "no photograph of 1 of 9 cameras: view_0000" in out
    (data / "images" / "view_0008.png").unlink()
    code, out, err = evaluated()
    assert (code, out) == (1, "") and "none of the 2 held-out views has a photograph" in err


def test_photographs_of_another_shape_are_refused(evaluated, data):
    for path in (data / "images").iterdir():
        Image.open(path).transpose(Image.Transpose.ROTATE_90).save(path)
    code, out, err = evaluated()
    assert (code, out) == (1, "") and "found 36 × 64 px" in err


@pytest.mark.parametrize("verb", ["calibrate", "build"])
def test_a_threshold_is_chosen_by_photographs_not_masks(splatree, small_ply, small_tree, data, verb):
    scene = small_tree if verb == "calibrate" else small_ply
    (data / "images" / "view_0001.png").unlink()
    words = (verb, scene, data / "out.splatree", "--data", data)
    found = result_of(splatree(*words, "--json"))  # against masks τ would be 0.5
    assert found["photographs"]["folders"] == {"images": 8} and found["photographs"]["missing"] == ["view_0001"]
    assert found["calibration"]["threshold"] < 0.3 and "view_0001" not in found["calibration"]["views"]
    _, out, _ = splatree(*words, "--force")
    assert "photographs: 8 in images/" in out and "no photograph of 1 of 9 cameras: view_0001" in out


def test_bench_says_its_photographs_and_draws_views_that_have_one(splatree, small_tree, data):
    (data / "images" / "view_0000.png").unlink()
    words = ("bench", "table1", "--scene", small_tree, "--data", data, "--size", "64", "--frames", "1", "--json")
    report = json.dumps(result_of(splatree(*words)))
    assert "1 photographs (8 in images/); no photograph of 1 of 9 cameras: view_0000" in report


def test_a_view_through_a_lens_is_drawn_and_compared(splatree, small_tree, data):
    """The product's own picture through a lens, straightened again, is near what the pinhole draws."""
    content = {
        "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 18, "w": 64, "h": 36, "k1": -0.2, "k2": 0.05,
        "frames": [
            {"file_path": f"images/{name}.png", "transform_matrix": _opengl(camera)}
            for name, camera in zip("ab", flyout(read(small_tree), PathOptions(views=2)), strict=True)
        ],
    }  # fmt: skip
    shutil.rmtree(data / "images")
    (data / "cameras.json").unlink()
    (data / "transforms.json").write_text(json.dumps(content))
    words = ("--cameras", data / "transforms.json", "-o", data / "images", "--pixel-error", "0", "--json")
    assert len(result_of(splatree("render", small_tree, *words))["views"]) == 2
    words = ("eval", small_tree, "--data", data, "--frames", "0", "--pixel-error", "0", "--held-out", "1", "--json")
    found = result_of(splatree(*words))
    assert "straightened by the lens" in found["photographs"]["notes"][0]
    assert found["mean"]["psnr_vs_photo"] > 25  # resampled twice, of 36 rows of pixels full of detail


def _opengl(camera):
    world_from_camera = np.linalg.inv(camera.camera_from_world) @ np.diag([1, -1, -1, 1])
    return world_from_camera.tolist()
