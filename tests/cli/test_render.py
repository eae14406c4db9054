"""Pictures from the command line: the first one, one from a point, planes beside it, one level, a turntable, old files."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatree import read, write_cameras
from splatree.io.images import read_image, write_image
from splatree.render.paths import PathOptions, flyout, orbit
from splatree.scene.options import SelectOptions

SIZE = ("--width", "64", "--height", "36")


@pytest.fixture
def draw(splatree, small_ply, tmp_path, monkeypatch):
    """Run `splatree render small.ply` in an empty folder: the result struct."""
    monkeypatch.chdir(tmp_path)

    def run(*words, scene=small_ply):
        code, out, err = splatree("render", scene, *words, *SIZE, "--json")
        assert code == 0, err
        return json.loads(out)

    return run


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_without_an_output_one_picture_lies_beside_the_user(draw, tmp_path):
    result = draw()
    assert names(tmp_path) == ["small.png"]
    assert len(result["views"]) == 1
    assert read_image("small.png").max() > 0.2
    assert any("up is -y" in reason for reason in result["reasons"])


def test_one_picture_may_be_named_and_chosen_by_number_or_name(draw, small_ply, tmp_path):
    draw("-o", "all", "--views", "4")
    for view in ("2", "view_0002"):
        draw("-o", "one.png", "--views", "4", "--view", view, "--force")
        assert np.array_equal(read_image("one.png"), read_image("all/view_0002.png"))
    write_cameras(flyout(read(small_ply), PathOptions(views=3, width=64, height=36)), "cameras.json")
    result = draw("--cameras", "cameras.json", "-o", "given.png", "--view", "1")
    assert [view["name"] for view in result["views"]] == ["view_0001"]
    assert result["reasons"] == [] and result["notes"] == []
    result = draw("--cameras", "cameras.json", "-o", "first.png")
    assert [view["name"] for view in result["views"]] == ["view_0000"]
    assert result["notes"] == ["the first of 3 views is drawn; --view N draws another, -o FOLDER all of them"]


def test_view_that_is_not_there_is_refused(splatree, small_ply, tmp_path):
    for view in ("9", "-1", "front"):
        code, _, err = splatree("render", small_ply, "-o", tmp_path / "a.png", "--views", "3", "--view", view)
        assert code == 2
        assert "wanted a number from 0 to 2 or a name such as 'view_0000'" in err


def test_eye_target_up_and_distance_are_obeyed(draw, small_ply):
    centre = np.median(read(small_ply).gaussians.means, axis=0)
    eye = [f"{x:.3f}" for x in centre + [0, -300, 0.1]]
    target = [f"{x:.3f}" for x in centre]
    draw("--eye", *eye, "--target", *target, "--up", "0", "0", "1", "--fov", "40", "-o", "above.png")
    draw("--eye", *eye, "--target", *target, "--up", "0", "0", "-1", "--fov", "40", "-o", "turned.png")
    above, turned = read_image("above.png"), read_image("turned.png")
    assert above.max() > 0.2
    # Half a turn about the line of sight turns the picture: equal but for the order in which equal depths are rounded.
    assert np.abs(above - turned[::-1, ::-1]).mean() < 0.02
    for distance, name in (("200", "near.png"), ("2000", "far.png")):
        draw("--target", *target, "--distance", distance, "-o", name)
    lit = [(read_image(name).max(axis=2) > 0.05).mean() for name in ("near.png", "far.png")]
    assert lit[0] > 4 * lit[1] > 0


def test_places_that_contradict_each_other_are_a_wrong_line(splatree, small_ply, tmp_path):
    for words, said in (
        (("--eye", "0", "0", "0", "--cameras", "cameras.json"), "found beside --cameras"),
        (("--distance", "3", "--path", "orbit"), "found beside --path orbit"),
        (("--turntable", "a.mp4", "--video", "b.mp4"), "found beside --video"),
        (("--turntable", "a.mp4", "--view", "1"), "found beside --view"),
        (("--depth", "exr", "--video", tmp_path / "b.mp4"), "found no -o"),
    ):
        code, _, err = splatree("render", small_ply, *words)
        assert (code, err.count("\n")) == (2, 1), err
        assert said in err


def test_depth_and_alpha_are_written_beside_the_picture(draw):
    draw("-o", "a.png", "--depth", "png", "--alpha", "png")
    draw("-o", "b.png", "--depth", "exr", "--alpha", "exr")
    with Image.open("a_depth.png") as image:
        depth = np.asarray(image, np.float64) * float(image.text["step"])
    exact = read_exr("b_depth.exr", "Z")
    assert exact.shape == (36, 64) and exact.max() > 50
    assert np.abs(depth - exact).max() <= 0.51 * exact.max() / 65535
    assert read_exr("b_alpha.exr", "A").max() == pytest.approx(1, abs=0.1)
    with Image.open("a_alpha.png") as image:
        assert np.asarray(image).max() == 65535


def read_exr(path, channel):
    """One float32 channel of an uncompressed OpenEXR file of scan lines, read by the format's description."""
    data = Path(path).read_bytes()
    magic, version = np.frombuffer(data, "<i4", 2)
    assert (magic, version) == (20000630, 2)
    at, attributes = 8, {}
    while data[at]:
        name_end = data.index(0, at)
        kind_end = data.index(0, name_end + 1)
        size = int(np.frombuffer(data, "<i4", 1, kind_end + 1)[0])
        attributes[data[at:name_end].decode()] = data[kind_end + 5 : kind_end + 5 + size]
        at = kind_end + 5 + size
    assert attributes["channels"].startswith(channel.encode() + b"\0") and attributes["compression"] == b"\0"
    x0, y0, x1, y1 = np.frombuffer(attributes["dataWindow"], "<i4")
    width, height = x1 - x0 + 1, y1 - y0 + 1
    places = np.frombuffer(data, "<u8", height, at + 1)
    lines = [np.frombuffer(data, "<f4", width, int(place) + 8) for place in places]
    assert [int(np.frombuffer(data, "<i4", 1, int(place))[0]) for place in places] == list(range(height))
    return np.stack(lines)


def test_one_level_is_drawn(draw, small_tree):
    finest, coarser = (draw("--level", str(level), "-o", f"{level}.png", scene=small_tree) for level in (0, 2))
    assert 0 < coarser["views"][0]["selected"] < finest["views"][0]["selected"] <= 3161
    flat = draw("--pixel-error", "0", "-o", "leaves.png", scene=small_tree)
    assert flat["views"][0]["selected"] == finest["views"][0]["selected"]


def test_level_that_is_not_there_is_refused(splatree, small_ply, tmp_path):
    code, _, err = splatree("render", small_ply, "-o", tmp_path / "a.png", "--level", "1")
    assert code == 1 and "wanted 0, as it has one level" in err


def test_turntable_is_one_option(draw, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    result = draw("--turntable", "turn.mp4", "--views", "6")
    assert len(result["views"]) == 6
    assert names(tmp_path) == ["turn.mp4"]


def test_forced_run_removes_pictures_of_an_earlier_one_and_nothing_else(draw, tmp_path):
    draw("-o", "out", "--views", "5", "--depth", "exr")
    write_image(np.zeros((4, 4, 3), np.float32), tmp_path / "out" / "ours.png")
    Image.new("RGB", (4, 4)).save(tmp_path / "out" / "photo.png")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    result = draw("-o", "out", "--views", "2", "--force")
    assert names(tmp_path / "out") == ["notes.txt", "photo.png", "view_0000.png", "view_0001.png"]
    assert result["num_removed"] == 3 + 5 + 1


def test_milliseconds_are_shown_only_when_asked_for(splatree, small_ply, tmp_path):
    words = ("render", small_ply, "--views", "2", *SIZE, "--path", "orbit")
    assert " ms" not in splatree(*words, "-o", tmp_path / "a")[1]
    assert "blend ms" in splatree(*words, "-o", tmp_path / "b", "--verbose")[1]


def test_orbit_is_still_there(draw, small_ply):
    result = draw("-o", "orbit", "--views", "2", "--path", "orbit")
    camera = orbit(read(small_ply), PathOptions(views=2, width=64, height=36))[0]
    assert result["views"][0]["name"] == camera.name
    assert SelectOptions().pixel_error == result["views"][0]["pixel_error"]


def test_views_of_a_moving_camera_are_nearly_the_exact_ones(draw, splatree, small_tree, tmp_path):
    draw("-o", "still", "--views", "3", scene=small_tree)
    moved = draw("-o", "moved", "--views", "3", "--moving", scene=small_tree)
    assert [view["selected"] > 0 for view in moved["views"]] == [True] * 3
    for name in names(tmp_path / "still"):
        still, moving = read_image(tmp_path / "still" / name), read_image(tmp_path / "moved" / name)
        assert np.abs(still - moving).max() < 4 / 255  # the last 1/255 of the light is not drawn, and 8 bits twice
    code, _, err = splatree("render", small_tree, "-o", tmp_path / "a.png", "--moving", "--depth", "exr")
    assert code == 2 and "moving: found beside --depth or --counters" in err


def test_a_quality_chooses_the_cut(splatree, small_tree, tmp_path):
    tree = small_tree
    counts = []
    for quality in ("28", "40"):
        code, out, err = splatree("render", tree, "-o", tmp_path / f"{quality}.png", "--quality", quality, "--json")
        assert (code, err) == (0, "")
        counts.append(json.loads(out)["views"][0]["selected"])
    assert counts[0] <= counts[1]
    code, _, err = splatree("eval", tree, "--quality", "40", "--method", "flod")
    assert code == 2
    assert "--quality and --method" in err
