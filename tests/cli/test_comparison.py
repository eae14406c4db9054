"""How much was lost, from the command line: eval --reference, and --report of the verbs that write."""

import json
from importlib import import_module

import pytest

from splatree import PathOptions, flyout, read, write_cameras

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
