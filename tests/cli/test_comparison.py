"""How much was lost, from the command line: eval --reference, and --report of the verbs that write."""

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from splatree import Cameras, PathOptions, flyout, read, write, write_cameras

SIZE = ("--width", "64", "--height", "36")


def result_of(run):
    code, out, err = run
    assert code == 0, err
    return json.loads(out)


def test_two_scenes_are_compared_from_views_made_for_the_reference(splatree, small_ply, tmp_path):
    thinned = tmp_path / "thin.ply"
    assert splatree("thin", small_ply, thinned, "--keep", "0.3")[0] == 0
    words = ("eval", thinned, "--reference", small_ply, "--views", "4", *SIZE)
    found = result_of(splatree(*words, "--report", tmp_path / "lost", "--json"))
    assert len(found["views"]) == 4
    assert 10 < found["all"]["psnr"] < 60 and 0 < found["all"]["flip"] < 0.5
    assert found["worst"] == max(found["views"], key=lambda view: view["flip"])["name"]
    assert found["all"]["num_drawn"] < found["all"]["num_drawn_reference"]
    assert (tmp_path / "lost" / "report.html").is_file()
    shown = splatree(*words)[1]
    assert f"worst view {found['worst']}" in shown and " ms" not in shown


def test_given_cameras_are_followed(splatree, small_ply, tmp_path):
    write_cameras(flyout(read(small_ply), PathOptions(views=5, width=64, height=36)), tmp_path / "cameras.json")
    words = ("eval", small_ply, "--reference", small_ply, "--cameras", tmp_path / "cameras.json", "--every", "2")
    found = result_of(splatree(*words, "--json"))
    assert [view["name"] for view in found["views"]] == ["view_0000", "view_0002", "view_0004"]
    assert found["all"]["psnr"] is None and found["all"]["flip"] == 0
    assert "PSNR equal" in splatree(*words)[1]


def far(small_scene, path, offset):
    """A file of doubles, 500 km from zero."""
    scene = replace(small_scene, source=replace(small_scene.source, origin=(5e5 + offset, 4e6, 0.0)))
    means = small_scene.gaussians.means - np.float32([offset, 0, 0])
    write(replace(scene, gaussians=replace(scene.gaussians, means=means)), path, force=True)
    return path


def test_scenes_far_from_zero_are_compared_in_the_world(splatree, small_scene, tmp_path):
    """Their origins are chosen file by file; cameras are in the world."""
    a, b = far(small_scene, tmp_path / "a.ply", 0), far(small_scene, tmp_path / "b.splatree", 3000)
    write(small_scene, tmp_path / "lost.sog")  # a format that keeps no origin
    assert read(b).source.origin[0] == read(a).source.origin[0] + 3000
    views = flyout(read(a), PathOptions(views=2, width=64, height=36))
    origin = np.asarray(read(a).source.origin)
    world = [replace(view, camera_from_world=view.camera_from_world @ shift(-origin)) for view in views]
    write_cameras(Cameras(tuple(world)), tmp_path / "cameras.json")
    for scene in (b, tmp_path / "lost.sog"):
        found = result_of(splatree("eval", scene, "--reference", a, "--cameras", tmp_path / "cameras.json", "--json"))
        assert found["all"]["psnr"] > 40 and found["notes"] == []
        assert found["all"]["num_drawn"] > 100


def shift(by):
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


def test_scenes_that_do_not_lie_in_one_place_are_told(splatree, small_ply, tmp_path):
    for name, options in {
        "moved": ("--translate", "500", "0", "0"),
        "turned": ("--rotate", "180", "0", "0"),
        "scaled": ("--scale", "3"),
    }.items():
        assert splatree("convert", small_ply, tmp_path / f"{name}.ply", *options)[0] == 0
        words = ("eval", tmp_path / f"{name}.ply", "--reference", small_ply, "--views", "1", *SIZE)
        assert "note: the scenes do not lie in one place" in splatree(*words)[1], name
    assert splatree("thin", small_ply, tmp_path / "thin.ply", "--keep", "0.1")[0] == 0
    words = ("eval", tmp_path / "thin.ply", "--reference", small_ply, "--views", "1", *SIZE)
    assert "one place" not in splatree(*words)[1]


@pytest.mark.parametrize(
    ("verb", "target", "options"),
    [
        ("convert", "a.sog", ("--rotate", "90", "0", "0", "--translate", "5", "0", "0")),
        ("convert", "meta.json", ()),
        ("thin", "a.ply", ("--keep", "0.5")),
        ("build", "a.splatree", ()),
    ],
)
def test_verbs_that_write_say_at_once_what_they_lost(splatree, small_ply, tmp_path, monkeypatch, verb, target, options):
    monkeypatch.setattr(import_module("splatree.render.compare"), "MADE", PathOptions(views=3, width=64, height=36))
    if target == "meta.json":
        (tmp_path / "folder").mkdir()
        target = "folder/meta.json"
    words = (verb, small_ply, tmp_path / target, *options, "--report", tmp_path / "lost")
    code, out, err = splatree(*words)
    assert code == 0, err
    assert "against the reference: PSNR " in out
    found = result_of(splatree(*words, "--force", "--json"))["comparison"]
    # The edits of a conversion move the reference too: what is left is what the format rounds.
    assert found["all"]["psnr"] is None or found["all"]["psnr"] > (30 if verb == "convert" else 15)
    assert (tmp_path / "lost" / "report.html").is_file()


def test_report_that_cannot_be_written_is_told_before_any_work(splatree, small_ply, tmp_path):
    (tmp_path / "lost").mkdir()
    (tmp_path / "lost" / "report.html").write_text("old")
    for words in (
        ("convert", tmp_path / "gone.ply", tmp_path / "a.sog"),
        ("eval", "gone.ply", "--reference", small_ply),
    ):
        code, _, err = splatree(*words, "--report", tmp_path / "lost")
        assert code == 1 and "report.html: exists already" in err
    code, _, err = splatree("thin", small_ply, tmp_path / "b.ply", "--report", tmp_path / "page.html")
    assert code == 2 and "wanted a folder" in err


def test_report_needs_a_reference(splatree, small_ply, tmp_path):
    code, _, err = splatree("eval", small_ply, "--report", tmp_path)
    assert code == 2 and "found no --reference" in err
    code, _, err = splatree("eval", small_ply, "--reference", small_ply, "--data", tmp_path)
    assert code == 2 and "found it beside --data" in err


@pytest.mark.parametrize(
    "words", [("thin", "--keep", "0.5"), ("convert",), ("build", "--flat", "--clusters", "4"), ("demo", "--views", "1")]
)
def test_a_report_of_what_fails_leaves_no_folder(splatree, tmp_path, monkeypatch, words):
    monkeypatch.setattr(import_module("splatree.cli.demo"), "read", lambda path: read(tmp_path / "gone.ply"))
    (tmp_path / "b").touch()
    if words[0] == "demo":
        words = (*words, "-o", tmp_path / "lost")
    else:
        words = (words[0], tmp_path / "gone.ply", tmp_path / "a.splatree", *words[1:], "--report", tmp_path / "lost")
    code, _, err = splatree(*words)
    assert code == 1 and "gone.ply: not found" in err
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
