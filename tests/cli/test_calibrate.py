"""``splatree calibrate`` and ``build --cameras`` from end to end on a small real scene."""

import json
import shutil

import pytest

from splatree.io.cameras.files import write_cameras
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.outofcore.opened import open_store
from splatree.render.paths import PathOptions, orbit

from .test_commands import SIZE, result_of


@pytest.fixture
def cameras(small_tree, tmp_path):
    """Ten views: two of them are held out."""
    write_cameras(orbit(read(small_tree), PathOptions(views=10, width=64, height=36)), tmp_path / "cameras.json")
    return tmp_path / "cameras.json"


def test_a_scene_is_calibrated_in_place_with_training_views_only(splatree, small_tree, cameras, tmp_path):
    path = shutil.copy(small_tree, tmp_path / "scene.splatree")
    found = result_of(splatree("calibrate", path, "--cameras", cameras, "--json"))
    assert found["output"] == str(path)
    # Every 8th of ten views from the first: 0 and 8.
    assert found["calibration"]["views"] == [f"view_{i:04d}" for i in (1, 2, 3, 4, 5, 6, 7, 9)]
    assert found["held_out"] == "every 8th view from the first: 2 of 10"
    scene = read(path)
    assert scene.threshold == found["calibration"]["threshold"] > 1 / 255
    assert json.loads(scene.source.metadata["calibration"])["held_out"] == found["held_out"]
    code, words, _ = splatree("info", path)
    assert code == 0 and f"τ = {scene.threshold:.4g}" in words and '"policy": "target"' in words
    # Drawn as calibrated, unless it is said otherwise.
    draw = ("render", path, "--cameras", cameras, "--json", "-o")
    shrunk = result_of(splatree(*draw, tmp_path / "a"))
    whole = result_of(splatree(*draw, tmp_path / "b", "--threshold", 1 / 255))
    assert sum(v["pairs"] for v in shrunk["views"]) < sum(v["pairs"] for v in whole["views"])


def test_a_list_of_held_out_views_is_kept(splatree, small_tree, cameras, tmp_path):
    (tmp_path / "test.txt").write_text("view_0003\n")
    words = ("--cameras", cameras, "--held-out", tmp_path / "test.txt", "--policy", "fixed", "--threshold", "0.1")
    found = result_of(splatree("calibrate", small_tree, tmp_path / "out.splatree", *words, "--json"))
    assert len(found["calibration"]["views"]) == 9 and "view_0003" not in found["calibration"]["views"]
    assert read(tmp_path / "out.splatree").threshold == 0.1
    assert read(small_tree).threshold == 1 / 255


def test_photographs_beside_the_cameras_are_used(splatree, small_tree, cameras, tmp_path):
    data = tmp_path / "data"
    result_of(splatree("render", small_tree, "--cameras", cameras, "-o", data / "images", "--json"))
    shutil.move(cameras, data / "cameras.json")
    words = ("--data", data, "--loss-db", "0.5", "--json")
    found = result_of(splatree("calibrate", small_tree, tmp_path / "out.splatree", *words))["calibration"]
    # The photographs are the scene's own pictures in 8 bits: far more than 0.5 dB is lost as soon as a pair is.
    assert found["photographs"] and found["loss_db"] <= 0.5 and len(found["views"]) == 8


def test_without_cameras_a_path_is_made(splatree, small_tree, tmp_path):
    words = ("--path", "orbit", "--views", "2", *SIZE, "--policy", "paper")
    code, out, err = splatree("calibrate", small_tree, tmp_path / "out.splatree", *words)
    assert (code, err) == (0, "")
    assert "by paper" in out and "over 2 views of 64 × 36 px" in out
    scene = read(tmp_path / "out.splatree")
    assert json.loads(scene.source.metadata["calibration"])["held_out"] == "none: orbit made for the scene"


def test_a_folder_is_calibrated_in_place_page_by_page(splatree, small_ply, cameras, tmp_path):
    folder = tmp_path / "city.splatree"
    build = ("build", small_ply, folder, "--part-rows", "800")
    assert splatree(*build)[0] == 0
    whole = read(folder)
    write(whole, tmp_path / "one.splatree")
    found = result_of(splatree("calibrate", folder, "--cameras", cameras, "--max-memory", "300M", "--json"))
    wanted = result_of(splatree("calibrate", tmp_path / "one.splatree", "--cameras", cameras, "--json"))
    assert found["calibration"] == wanted["calibration"]
    after = read(folder)
    assert after.threshold == found["calibration"]["threshold"] > whole.threshold
    assert json.loads(after.source.metadata["calibration"])["held_out"] == found["held_out"]
    assert after.gaussians.means.tobytes() == whole.gaussians.means.tobytes()
    assert len(list(folder.glob("crown*"))) == 1
    with open_store(folder) as store:
        assert store.scene.threshold == after.threshold
    code, _, err = splatree("calibrate", tmp_path / "one.splatree", "--max-memory", "300M", "--cameras", cameras)
    assert code == 2 and "wanted one folder of parts" in err


def test_build_calibrates_where_views_are_given(splatree, small_ply, cameras, tmp_path):
    words = ("--cameras", cameras, "--loss-db", "0.2")
    code, out, err = splatree("build", small_ply, tmp_path / "out.splatree", *words)
    assert (code, err) == (0, "")
    assert "by target" in out
    record = json.loads(read(tmp_path / "out.splatree").source.metadata["calibration"])
    assert 0 < record["loss_db"] <= 0.2 and record["held_out"].startswith("every 8th")
    built = result_of(splatree("build", small_ply, tmp_path / "plain.splatree", "--json"))
    assert built["calibration"] is None


def test_no_view_left_is_refused(splatree, small_tree, cameras, tmp_path):
    words = ("--cameras", cameras, "--held-out", "1")
    code, _, err = splatree("calibrate", small_tree, tmp_path / "out.splatree", *words)
    assert code == 1
    assert "leaves no view to calibrate with; wanted 2 or more" in err
    assert not (tmp_path / "out.splatree").exists()
