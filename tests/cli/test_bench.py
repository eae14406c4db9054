"""``splatree bench`` from end to end on a small real scene."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatree.bench.measure import Judge
from splatree.bench.subject import SubjectOptions, subject_of
from splatree.cli.main import commands_of
from splatree.io.cameras.files import write_cameras
from splatree.io.images import write_image
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.render.paths import PathOptions, flyout
from splatree.render.pipeline import render
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

from ..scenes import random_gaussians

SMALL = ("--views", "2", "--size", "64")


def result_of(run):
    code, out, err = run
    assert (code, err) == (0, "")
    return json.loads(out)


def test_help_lists_the_experiments(splatree):
    code, out, _ = splatree("bench", "--help")
    assert code == 0
    assert all(f"  {name} " in out for name in commands_of("bench"))


def test_an_unknown_experiment_is_a_wrong_command_line(splatree):
    code, out, err = splatree("bench", "table9")
    assert (code, out) == (2, "")
    assert "table1" in err


@pytest.fixture
def bench(splatree, small_tree):
    """Run an experiment on a small real scene; the tables by name, and the names of the files."""

    def run(name, *words):
        if "-o" in words:
            pytest.importorskip("matplotlib", reason="matplotlib (extra bench) is not installed")
        found = result_of(splatree("bench", name, "--scene", small_tree, *SMALL, *words, "--json"))
        for table in found["tables"]:
            theirs = table["name"].endswith("_paper")
            assert ("theirs, RTX 4090" in table["source"]) == theirs
            assert (table["source"] == "measured in this run") != theirs
        assert ("no photographs" in found["about"]["compared with"]) == (name != "popping")
        return {table["name"]: table["rows"] for table in found["tables"]}, {Path(f).name for f in found["files"]}

    return run


def test_table1_compares_methods(bench, tmp_path):
    tables, files = bench("table1", "-o", tmp_path, "--frames", "2", "--pixel-error", "20")
    rows = {row["method"]: row for row in tables["table1"]}
    assert rows["3DGS: all leaves"]["PSNR"] == 100
    assert 5 < rows["splatree"]["PSNR"] < 60
    for same in ("level by level", "FilterGS, exact"):
        assert [rows[same][key] for key in ("PSNR", "nodes", "N_P")] == [
            rows["splatree"][key] for key in ("PSNR", "nodes", "N_P")
        ]
    assert all(rows[name]["twice"] == rows[name]["missing"] == 0 for name in ("H3DGS", "roots", "FLoD, first hit"))
    assert rows["FilterGS, exact"]["B/node"] > 5 * rows["splatree"]["B/node"]
    assert files == {"table1.csv", "table1.json", "table1_paper.csv", "table1_frontier.png"}


def test_table2_times_each_stage(bench):
    tables, _ = bench("table2", "--frames", "2")
    assert len(tables["table2"]) == 12
    for row in tables["table2"]:
        assert sum(row[f"{stage} %"] for stage in ("T_calcu", "T_prepr", "T_sort", "T_alpha")) == pytest.approx(100)


def test_table3_shows_equal_selections_and_fewer_pairs(bench):
    tables, _ = bench("table3", "--pixel-error", "20")
    rows = tables["table3"]
    assert {row["same rows as serial"] for row in rows} == {"2 of 2 views"}
    by_filter = [[row[key] for key in ("PSNR", "SSIM", "N_P")] for row in rows]
    assert by_filter[:4] == by_filter[4:8] == by_filter[8:]
    squares, _, exact, target = (row["N_P"] for row in rows[:4])
    assert squares > exact > target
    assert "FPS" not in rows[0]


def test_table3_times_frames_where_they_are_asked_for(bench):
    tables, _ = bench("table3", "--pixel-error", "20", "--frames", "1")
    assert all(row["FPS"] > 0 for row in tables["table3"])


def test_fig5_draws_details_of_each_way(bench):
    tables, _ = bench("fig5", "--frames", "2")
    rows = tables["fig5"]
    assert [row["N_P / 3σ"] for row in rows if row["shrinking"].startswith("3σ")] == [1, 1]
    assert all(row["PSNR to unshrunk"] == 100 for row in rows if row["shrinking"].startswith("1/255 exact"))


def test_fig6_sweeps_and_counts_contributions(bench):
    words = ("--frames", "1", "--lambdas", "0.1", "0.4", "--thresholds", "0.05", "--losses-db", "0.2")
    tables, _ = bench("fig6", *words)
    assert len(tables["fig6_sweep"]) == 1 + 4 + 2 + 2
    contributions = {row["drawn"]: row for row in tables["fig6_contributions"]}
    # What does not reach a pixel with 1/255 adds nothing: the exact test leaves out only such pairs.
    squares, exact = contributions["3σ squares"], contributions["1/255 exact (ours)"]
    assert exact["pairs of all views"] < squares["pairs of all views"]
    assert exact["used %"] > squares["used %"]


def test_fig7_shows_where_detail_is_high_and_low(bench, tmp_path):
    tables, files = bench("fig7", "-o", tmp_path, "--frames", "1", "--thresholds", "0.05", "0.4")
    rows = tables["fig7"]
    assert len(rows) == 9
    assert rows[0]["N_low less %"] == 0
    assert rows[3]["N_P"] > rows[4]["N_P"] > rows[5]["N_P"]
    assert {"fig7_high.png", "fig7_low.png"} <= files


def test_popping_measures_each_frame_of_each_dolly(bench, tmp_path):
    tables, files = bench("popping", "--frames", "4", "--step", "0.1", "--pixel-error", "20", "-o", tmp_path)
    frames, dollies = tables["popping_frames"], tables["popping"]
    assert (len(frames), len(dollies)) == (2 * 3, 2)
    assert sum(row["switched"] for row in frames) > 0
    assert max(row["tile"] for row in frames) == max(row["worst tile"] for row in dollies)
    assert min(row["PSNR"] for row in frames) == min(row["worst PSNR"] for row in dollies)
    assert files == {"popping.json", "popping.csv", "popping_frames.csv", "popping.png"}


def test_a_scene_that_needs_repair_is_repaired_and_counted(splatree, tmp_path):
    write(Scene.flat(random_gaussians(50, seed=1)), tmp_path / "nan.ply")
    data = bytearray((tmp_path / "nan.ply").read_bytes())
    start = data.index(b"end_header\n") + 11
    data[start : start + 4] = np.float32(np.nan).tobytes()
    (tmp_path / "nan.ply").write_bytes(data)
    words = (
        "bench",
        "popping",
        "--scene",
        tmp_path / "nan.ply",
        "--views",
        "1",
        "--size",
        "32",
        "--frames",
        "2",
        "--json",
    )
    code, _, err = splatree(*words)
    assert code == 1 and "read it with repair" in err
    assert result_of(splatree(*words, "--repair"))["about"]["repaired"] == "dropped_rows 1"


def test_scored_views_are_held_out_and_others_calibrated_on(small_tree, tmp_path):
    scene = read(small_tree)
    cameras = flyout(scene, PathOptions(views=9, width=64, height=36))
    write_cameras(cameras, tmp_path / "cameras.json")
    for camera in cameras:
        write_image(render(scene, camera).image, tmp_path / f"{camera.name}.png")
    subject = subject_of(SubjectOptions((small_tree,), data=tmp_path, views=0, size=64))
    assert [camera.name for camera in subject.cameras] == ["view_0000", "view_0008"]
    assert len(subject.training) == 7 == len(subject.training_photos)
    assert "every 8th view from the first: 2 of 9" in subject.about["cameras"]
    assert subject.about["compared with"] == "2 photographs (9 in the folder itself)"
    # The photographs are the pictures of the cut, rounded to 8 bits: at most half a step off, so better than 20 log10(510) dB.
    assert Judge(subject).quality(SelectOptions()).psnr > 54


def test_options_out_of_range_are_a_wrong_command_line(splatree):
    for words in (
        ("table1", "--frames", "0"),
        ("fig7", "--thresholds", "2"),
        ("table3", "--lambda-g", "-1"),
        ("table3", "--frames", "-1"),
        ("clusters", "--frames", "0"),
        ("cullfuzz", "--frames", "0"),
        ("popping", "--frames", "1"),
        ("popping", "--step", "0"),
        ("popping", "--budget", "0"),
    ):
        code, _, err = splatree("bench", *words)
        assert code == 2
        assert words[1].removeprefix("--").replace("-", "_") in err


@pytest.mark.parametrize("name", ["fig5", "fig6", "fig7", "table3"])
def test_a_scene_of_which_nothing_is_seen_has_no_pairs(splatree, tmp_path, name):
    seen = random_gaussians(20, degree=0)
    hidden = replace(seen, logit_opacities=np.full(20, -np.inf, np.float32))
    write(Scene.flat(hidden), tmp_path / "hidden.ply")
    found = result_of(
        splatree(
            "bench", name, "--scene", tmp_path / "hidden.ply", "--views", "1", "--size", "32", "--frames", "1", "--json"
        )
    )
    rows = next(table["rows"] for table in found["tables"] if not table["name"].endswith("_paper"))
    assert {row["N_P"] for row in rows} == {0}
    assert {row.get("N_P / 3σ", 0) for row in rows} == {0}
