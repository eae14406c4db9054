"""The report of a stream: pictures against bytes, for what each viewer chooses."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest

import splatree as st
from splatree.stream.chunk_quality import quality_of_chunks
from splatree.stream.errors import chunk_views
from splatree.stream.rad import as_written
from splatree.stream.readers.playcanvas import select_playcanvas
from splatree.stream.readers.playcanvas_drawing import draw_playcanvas
from splatree.stream.readers.sog_stream import open_sog_stream
from splatree.stream.readers.spark import select_spark
from splatree.stream.report import report_stream
from splatree.stream.stream import stream

from .conftest import forest


@pytest.fixture(scope="module")
def scene():
    return forest(1500, seed=4)


@pytest.fixture(scope="module")
def cameras():
    return [st.Camera.look_at([0.5, 0.5, -z], [0.5, 0.5, 0.5], width=96, height=64) for z in (3.0, 12.0)]


STREAMS = {
    "sog": ("out", st.StreamOptions(chunk_leaves=100, unit_rows=200, levels=4, errors=True), "playcanvas"),
    "ssog": ("out.ssog", st.StreamOptions(chunk_leaves=60, levels=3, zip=True), "playcanvas"),
    "rad": ("out.rad", st.StreamOptions(), "spark"),
    "3dtiles": ("out", st.StreamOptions(tile_nodes=150), "cesium"),
}
"""Where each stream is written, its options, and the viewer that it is for."""


@pytest.fixture(scope="module", params=STREAMS)
def reported(request, scene, cameras, tmp_path_factory):
    """A stream, its report, and the name of its viewer."""
    name, options, viewer = STREAMS[request.param]
    format = "sog" if request.param == "ssog" else request.param
    written = stream(scene, tmp_path_factory.mktemp("stream") / name, format, options)
    return written, report_stream(scene, written, cameras, budgets=(200, 500)), viewer


def test_finer_settings_load_more_and_come_nearer(reported, cameras):
    written, report, viewer = reported
    for number in range(len(cameras)):
        views = [view for view in report.views if (view.view, view.viewer) == (f"view {number}", viewer)]
        assert len(views) > 1
        for coarse, fine in pairwise(views):
            assert coarse.num_nodes <= fine.num_nodes and coarse.bytes <= fine.bytes
            assert coarse.psnr_db <= fine.psnr_db + 1  # a level may be near by chance
        assert all(0 < view.bytes <= written.bytes for view in views)
        if viewer != "cesium":
            assert [view.num_nodes <= view.setting for view in views] == [True, True]
    assert bool(report.levels) == bool(report.chunks) == (viewer == "playcanvas")
    content = json.loads(report.to_json())
    assert len(content["views"]) == len(report.views)


@pytest.mark.parametrize("reported", ["sog", "rad"], indirect=True)
def test_viewers_are_drawn_as_they_come(reported, scene, cameras):
    """PlayCanvas with its own dilation, Spark as if the scene had been trained with antialiasing."""
    written, report, viewer = reported
    camera = cameras[1]
    if viewer == "spark":
        drawn = select_spark(as_written(scene, written.options), camera, 200).drawn
        faint = st.Scene.flat(st.read(written.output).gaussians.take(drawn), mode="antialiased")
        image = st.render(faint, camera).image
    else:
        opened = open_sog_stream(written.output)
        image = draw_playcanvas(opened.gaussians_of(select_playcanvas(opened.ranges, camera, 200)), camera).image
    truth = np.clip(st.render(scene, camera, select=st.SelectOptions(pixel_error=0)).image, 0, 1)
    (found,) = [v for v in report.views if (v.view, v.viewer, v.setting) == ("view 1", viewer, 200)]
    assert found.psnr_db == pytest.approx(st.psnr(np.clip(image, 0, 1), truth), abs=1e-3)


def test_levels_are_judged_from_the_finest_down(scene, cameras, tmp_path):
    options = st.StreamOptions(chunk_leaves=60, levels=4)
    written = stream(scene, tmp_path / "out", options=options)
    report = report_stream(scene, written, cameras, budgets=(300,))
    assert [level.num_nodes for level in report.levels] == [level.num_nodes for level in written.levels]
    assert [level.bytes for level in report.levels] == [level.bytes for level in written.levels]
    assert report.levels[0].psnr_db == max(level.psnr_db for level in report.levels)
    assert report.levels[0].psnr_db > 35 and math.isfinite(report.levels[0].ssim)
    counts = [chunk.num_nodes for chunk in report.chunks]
    assert np.sum(counts, axis=0).tolist() == [level.num_nodes for level in written.levels]


def test_a_chunk_is_judged_by_its_own_pictures(scene, tmp_path):
    """PSNR of the pictures of one chunk, drawn here by themselves; nearest of all is the level next to the finest."""
    written = stream(scene, tmp_path / "out", options=st.StreamOptions(ratio=2, chunk_leaves=60, levels=4))
    opened = open_sog_stream(written.output)
    found = quality_of_chunks(opened)
    assert [chunk.chunk for chunk in found] == list(range(written.num_chunks))
    assert all(chunk.psnr_db[0] is None for chunk in found)
    finest, coarser = opened.rows_of(7, 0), opened.rows_of(7, 2)
    views = chunk_views(finest, opened.ranges.boxes[7], most_px=256)
    images = [
        np.concatenate([np.clip(st.render(st.Scene.flat(part), view).image, 0, 1) for view in views])
        for part in (coarser, finest)
    ]
    np.testing.assert_allclose(found[7].psnr_db[2], st.psnr(*images), atol=1e-3)  # sums in another order
    by_level = np.median([[np.inf if db is None else db for db in chunk.psnr_db[1:]] for chunk in found], axis=0)
    assert by_level[0] > by_level[1] > by_level[2]


def test_the_page_shows_every_view_and_needs_no_other_file(reported, scene, cameras, tmp_path):
    written, report, viewer = reported
    st.write_stream_report(report, scene, written, tmp_path / "page.html", cameras)
    page = (tmp_path / "page.html").read_text()
    for view in report.views:
        assert f"<td>{view.psnr_db:.2f}</td>" in page and f"<td>{view.num_nodes:,}</td>" in page
    assert page.count("<polyline") == len({(view.view, view.viewer) for view in report.views})
    assert page.count("data:image/jpeg;base64,") == 3 and "http" not in page and "$" not in page
    worst = min(report.views, key=lambda view: view.psnr_db)
    assert f"PSNR {worst.psnr_db:.2f}, FLIP" in page  # of the picture that is shown
    assert ("<h2>Levels</h2>" in page) == (viewer == "playcanvas")
    with pytest.raises(st.OutputError, match="exists"):
        st.write_stream_report(report, scene, written, tmp_path / "page.html", cameras)
    with pytest.raises(st.InputError, match="wanted the report's own cameras"):
        st.write_stream_report(report, scene, written, tmp_path / "other.html")


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
    words = [*words[:4], str(tmp_path / "r.html"), "--force", "--cameras", str(tmp_path / "c.json")]
    assert main(words) == 0 and "<polyline" in (tmp_path / "r.html").read_text()
