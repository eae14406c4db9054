"""splatree refine: a tree that learns from its leaves."""

import json

import pytest

import splatree as st


@pytest.fixture(scope="module")
def tree(tmp_path_factory, small_ply):
    path = tmp_path_factory.mktemp("refine") / "tree.splatree"
    st.write(st.build_lod(st.read(small_ply), st.BuildOptions("pairs")), path)
    return path


def test_a_tree_gets_better_pictures(splatree, tree, tmp_path):
    out = tmp_path / "better.splatree"
    words = ("refine", tree, out, "--iterations", "80", "--made-views", "16")
    code, said, err = splatree(*words, "--json")
    assert code == 0, err
    found = json.loads(said)
    assert found["after_db"] > found["before_db"] and found["iterations"] == 80
    assert len(st.read(out)) == len(st.read(tree))
    code, said, _ = splatree(*words, "--force")
    assert code == 0 and "views kept to judge by" in said and "merged nodes learned" in said


def test_cameras_of_ones_own(splatree, tree, tmp_path):
    cameras = tmp_path / "cameras.json"
    st.write_cameras(st.orbit(st.read(tree), st.PathOptions(views=24, width=200, height=150)), cameras)
    code, _, err = splatree("refine", tree, tmp_path / "a.splatree", "--cameras", cameras, "--iterations", "30")
    assert code == 0, err


def test_a_scene_without_levels_is_refused_and_nothing_written(splatree, small_ply, tmp_path):
    code, _, err = splatree("refine", small_ply, tmp_path / "a.splatree")
    assert code == 1 and "build levels first" in err and not (tmp_path / "a.splatree").exists()


def test_build_refines_at_once(splatree, small_ply, tmp_path):
    words = (
        "build",
        small_ply,
        tmp_path / "a.splatree",
        "--method",
        "pairs",
        "--refine",
        "0.02",
    )
    code, out, err = splatree(*words)
    assert code == 0, err
    assert "merged nodes learned for" in out and "dB in views kept to judge by" in out
    for wrong in ("--flat", "--max-memory"):
        more = ("--clusters", "8") if wrong == "--flat" else ("1G",)
        code, _, err = splatree(*words[:5], "--refine", "1", "--force", wrong, *more)
        assert code == 2 and "--refine" in err
