"""``splatree bench`` from end to end on a small real scene."""

import json

import pytest

from splatree.cli.main import commands_of

SMALL = ("--views", "2", "--size", "64", "--frames", "2")


def result_of(run):
    code, out, err = run
    assert (code, err) == (0, "")
    return json.loads(out)


def test_help_lists_the_experiments(splatree):
    code, out, _ = splatree("bench", "--help")
    assert code == 0
    assert all(f"  {name} " in out for name in commands_of("bench"))


@pytest.mark.parametrize("words", [(), ("table9",)])
def test_an_unknown_experiment_is_a_wrong_command_line(splatree, words):
    code, out, err = splatree("bench", *words)
    assert (code, out) == (2, "")
    assert "table1" in err


def test_table1_compares_methods_and_shows_the_papers_figures_as_theirs(splatree, small_tree, tmp_path):
    words = ("bench", "table1", "--scene", small_tree, *SMALL, "--pixel-error", "20")
    found = result_of(splatree(*words, "-o", tmp_path / "out", "--json"))
    ours, theirs = found["tables"]
    assert ours["source"] == "measured in this run"
    assert "FilterGS (Wang 2026), Table 1; theirs" in theirs["source"]
    rows = {row["method"]: row for row in ours["rows"]}
    assert rows["all leaves (3DGS)"]["PSNR"] == 100
    assert 5 < rows["cut (ours)"]["PSNR"] < 60
    assert rows["cut (ours)"]["nodes"] < rows["all leaves (3DGS)"]["nodes"]
    assert "no photographs" in found["about"]["compared with"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "table1.csv",
        "table1.json",
        "table1_paper.csv",
    ]
