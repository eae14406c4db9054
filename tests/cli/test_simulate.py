"""``splatree simulate`` from end to end."""

import json


def test_a_scene_is_simulated_and_reported(splatree, small_ply, tmp_path):
    report, traces = tmp_path / "report", tmp_path / "traces"
    words = ("simulate", small_ply, "--views", 2, "--clusters", 50, "-o", report, "--traces", traces)
    code, out, err = splatree(*words, "--set", "dram.bandwidth_gbps=51.2", "--sweep", "clock_mhz=250,500", "--json")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result["machine"]["dram"]["bandwidth_gbps"] == 51.2
    assert len(result["frames"]) == 2
    assert [row["clock_mhz"] for row in result["sweep"]] == [250, 500]
    assert result["sweep"][0]["frame ms"] > result["sweep"][1]["frame ms"]
    page = (report / "index.html").read_text()
    for heading in (
        "Time line of the first frame",
        "What each idea is worth",
        "Energy",
        "Roofline",
        "Sweep of clock_mhz",
    ):
        assert heading in page
    assert "http" not in page  # nothing is loaded from elsewhere
    code, out, _ = splatree("simulate", *sorted(traces.iterdir()), "--machine", report / "machine.toml", "--json")
    assert code == 0
    assert json.loads(out)["frames"] == result["frames"]
    assert splatree(*words)[0] == 1  # files are there already
    other = tmp_path / "other"
    assert splatree("simulate", small_ply, "--views", 1, "--clusters", 30, "--traces", other)[0] == 0
    code, _, err = splatree("simulate", traces / "frame_000.npz", other / "frame_000.npz")
    assert code == 1 and "found a frame of another scene than" in err


def test_results_are_shown_in_words(splatree, small_ply):
    code, out, _ = splatree("simulate", small_ply, "--views", 1, "--clusters", 20)
    assert code == 0
    for words in ("bound by", "What each idea is worth", "order adversarial", "mJ: dram"):
        assert words in out


def test_levels_of_detail_are_drawn_by_a_machine_that_selects_them(splatree, small_tree):
    words = ("simulate", small_tree, "--views", 1, "--clusters", 20, "--pixel-error", 60, "--json")
    code, _, err = splatree(*words)
    assert code != 0 and "selects_levels=true" in err
    code, out, _ = splatree(*words, "--set", "selects_levels=true")
    assert code == 0
    levels = json.loads(out)["frames"][0]
    code, out, _ = splatree(*words[:-3], "--json")
    assert 0 < levels["Gaussians read"] < json.loads(out)["frames"][0]["Gaussians read"]
    assert levels["rows walked"] >= levels["Gaussians read"]


def test_wrong_lines_are_refused(splatree, small_ply, tmp_path):
    for words, message in (
        ((), "wanted a scene, traces"),
        ((small_ply, "--trace-from", "table1"), "found both a scene and --trace-from"),
        ((small_ply, "--preset", "tpu"), "wanted one of jo2024"),
        ((small_ply, "--sweep", "clock_mhz"), "wanted NAME=VALUE"),
        ((small_ply, "--clusters", 9, "--sweep", "order=index"), "use --set for words"),
        ((small_ply, "--views", 0), "wanted at least 1"),
        ((small_ply, "--machine", tmp_path / "none.toml"), "cannot be read"),
    ):
        code, _, err = splatree("simulate", *words)
        assert code != 0
        assert message in err, (words, err)
