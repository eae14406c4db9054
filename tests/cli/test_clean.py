"""splatree clean: what each filter would drop, and the file without it."""

import json

import pytest

from splatree import PathOptions, orbit, read, write_cameras


def test_a_dry_run_says_what_would_go_and_writes_nothing(splatree, small_ply, tmp_path):
    words = ("clean", small_ply, "--floaters", "--max-distance", "1.5", "--dry-run")
    code, out, err = splatree(*words)
    assert code == 0, err
    assert "floaters: would drop" in out and "would be left" in out
    found = json.loads(splatree(*words, "--json")[1])
    written = json.loads(splatree(*words[:-1], "-o", tmp_path / "a.ply", "--json")[1])
    assert found["dropped"] == written["dropped"] and found["output"] is None
    assert 0 < written["num_gaussians"] == len(read(tmp_path / "a.ply")) < 3161


def test_a_dry_run_passes_over_the_output_of_the_command_that_it_tries(splatree, small_ply, tmp_path):
    words = ("clean", small_ply, tmp_path / "new.ply", "--max-distance", "1.5")
    code, dry, err = splatree(*words, "--dry-run", "--json")
    assert code == 0, err
    assert not (tmp_path / "new.ply").exists()
    assert json.loads(splatree(*words, "--json")[1])["dropped"] == json.loads(dry)["dropped"]


def test_distances_to_cameras(splatree, small_ply, tmp_path):
    write_cameras(orbit(read(small_ply), PathOptions(views=4)), tmp_path / "cameras.json")
    words = ("clean", small_ply, "--max-distance", "0.9", "--cameras", tmp_path / "cameras.json", "--dry-run", "--json")
    code, out, err = splatree(*words)
    assert code == 0, err
    assert 0 < json.loads(out)["dropped"]["farther than max_distance"] < 3161


@pytest.mark.parametrize(
    ("options", "said"),
    [((), "found no filter"), (("--floaters", "--cameras", "c.json"), "found no --max-distance")],
)
def test_lines_that_do_nothing_are_refused(splatree, small_ply, tmp_path, options, said):
    code, _, err = splatree("clean", small_ply, tmp_path / "a.ply", *options)
    assert code == 2 and said in err
