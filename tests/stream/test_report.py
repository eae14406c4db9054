"""The report of a stream: pictures against bytes, for what each viewer chooses."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest

import splatree as st
from splatree.stream.report import report_stream
from splatree.stream.stream import stream

from .conftest import forest


@pytest.fixture(scope="module")
def scene():
    return forest(1500, seed=4)


@pytest.fixture(scope="module")
def cameras():
    small = [st.Camera.look_at([0.5, 0.5, -z], [0.5, 0.5, 0.5], width=96, height=64) for z in (3.0, 12.0)]
    return small


@pytest.mark.parametrize(
    ("format", "name", "options", "viewer"),
    [
        ("sog", "out", st.StreamOptions(chunk_leaves=60, unit_rows=200, levels=4), "playcanvas"),
        ("rad", "out.rad", st.StreamOptions(), "spark"),
        ("3dtiles", "out", st.StreamOptions(tile_nodes=150), "cesium"),
    ],
)
def test_finer_settings_load_more_and_come_nearer(scene, cameras, tmp_path, format, name, options, viewer):
    written = stream(scene, tmp_path / name, format, options)
    report = report_stream(scene, written, cameras, budgets=(200, 500))
    for number in range(len(cameras)):
        views = [view for view in report.views if view.view == f"view {number}"]
        assert {view.viewer for view in views} == {viewer}
        for coarse, fine in pairwise(views):
            assert coarse.num_nodes <= fine.num_nodes and coarse.bytes <= fine.bytes
            assert coarse.psnr_db <= fine.psnr_db + 1  # a level may be near by chance
        assert all(0 < view.bytes <= written.bytes for view in views)
        if viewer != "cesium":
            assert [view.num_nodes <= view.setting for view in views] == [True, True]
    assert bool(report.levels) == bool(report.nodes_per_chunk) == (format == "sog")
    content = json.loads(report.to_json())
    assert len(content["views"]) == len(report.views)


def test_levels_are_judged_from_the_finest_down(scene, cameras, tmp_path):
    options = st.StreamOptions(chunk_leaves=60, levels=4)
    written = stream(scene, tmp_path / "out", options=options)
    report = report_stream(scene, written, cameras, budgets=(300,))
    assert [level.num_nodes for level in report.levels] == [level.num_nodes for level in written.levels]
    assert [level.bytes for level in report.levels] == [level.bytes for level in written.levels]
    assert report.levels[0].psnr_db == max(level.psnr_db for level in report.levels)
    assert report.levels[0].psnr_db > 35 and math.isfinite(report.levels[0].ssim)
    assert np.sum(report.nodes_per_chunk, axis=0).tolist() == [level.num_nodes for level in written.levels]


def test_the_command_line_writes_the_report(tmp_path, capsys):
    from splatree.cli.main import main

    scene = forest(400, seed=4)
    st.write(scene, tmp_path / "a.splatree")
    st.write_cameras(
        st.Cameras((st.Camera.look_at([0.5, 0.5, -3.0], [0.5, 0.5, 0.5], width=96, height=64),)), tmp_path / "c.json"
    )
    words = ["stream", str(tmp_path / "a.splatree"), str(tmp_path / "out"), "--report", str(tmp_path / "r.json")]
    assert main([*words, "--cameras", str(tmp_path / "c.json")]) == 0
    assert "exact cut, dB" in capsys.readouterr().out
    assert json.loads((tmp_path / "r.json").read_text())["views"][0]["viewer"] == "playcanvas"
    assert main([*words[:3], "--cameras", str(tmp_path / "c.json")]) == 2
