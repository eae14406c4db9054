"""splatree clean: what each filter would drop, and the file without it."""

import json

import pytest

from splatree import PathOptions, Scene, orbit, read, write, write_cameras

from ..scenes import random_gaussians


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


@pytest.mark.parametrize("words", [("--dry-run",), ()])
def test_a_scene_that_is_mostly_floaters_is_doubted(splatree, small_ply, tmp_path, words):
    g = random_gaussians(400)
    g.log_scales[:] = -4
    write(Scene.flat(g), tmp_path / "loose.ply")
    code, out, err = splatree(
        "clean", tmp_path / "loose.ply", tmp_path / "a.ply", "--floaters", "--cell", "0.02", *words
    )
    assert code == 0, err
    assert "note: most of the scene counts as floaters" in out and "cubes of 0.02 radii" in out
    assert "note" not in splatree("clean", small_ply, tmp_path / "b.ply", "--floaters", *words)[1]
