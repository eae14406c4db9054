"""The demo from end to end, with few small views."""

import contextlib
import io
import json
import re

import pytest

from splatree.cli.demo import CREDIT
from splatree.cli.main import main


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """What `splatree demo --json` prints, and its folder."""
    folder = tmp_path_factory.mktemp("demo") / "report"
    words = ["demo", "-o", str(folder), "--views", "3", "--width", "160", "--height", "90", "--json"]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(words) == 0
    return json.loads(out.getvalue()), folder


def test_demo_builds_a_tree_and_says_what_each_view_took(demo):
    result, _ = demo
    assert result["num_gaussians"] == 252_828
    assert result["num_nodes"] > result["num_gaussians"]
    assert result["levels"] == len(result["nodes_per_depth"]) > 5
    assert len(result["views"]) == 3
    for view in result["views"]:
        assert 0 < view["selected"] <= view["leaves_selected"]
        assert 0 < view["pairs"] <= view["leaves_pairs"]
        assert all(ms >= 0 for ms in view["ms"].values())
        assert len(view["curve"]) > 3


def test_demo_draws_fewer_nodes_from_afar_and_stays_close_to_the_leaves(demo):
    near, _, far = demo[0]["views"]
    assert far["distance"] > 10 * near["distance"]
    assert far["selected"] < 0.2 * far["leaves_selected"]
    assert all(view["psnr_vs_leaves"] > 25 for view in (near, far))  # a picture of the wrong place has less than 15 dB
    for view in (near, far):  # coarser cuts have fewer nodes
        nodes = [point[1] for point in view["curve"]]
        assert nodes == sorted(nodes, reverse=True)


def test_report_needs_nothing_else_and_gives_credit(demo):
    result, folder = demo
    page = (folder / "report.html").read_text()
    assert "$" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)  # no placeholder is left
    assert set(re.findall(r'src="([a-z]+:[a-z]+)', page)) == {"data:image"}
    assert "Samuel Hiero" in page and "creativecommons.org/licenses/by/4.0" in page
    assert result["credit"] == CREDIT
    pictures = {f"{i}_{name}.png" for i in range(3) for name in ("cut", "leaves", "levels", "error")}
    assert {path.name for path in folder.iterdir()} == pictures | {"report.html", "strip.png"}


def test_demo_refuses_a_file_as_its_folder(splatree, tmp_path):
    (tmp_path / "taken").write_bytes(b"")
    code, out, err = splatree("demo", "-o", tmp_path / "taken")
    assert (code, out) == (1, "")
    assert "taken" in err
