"""splatree refine: a tree that learns from its leaves."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

import splatree as st
from splatree.train.checkpoint import Identity, save

from .conftest import listen_to_interruptions


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


def test_a_run_is_never_overwritten_unasked_and_removed_at_its_end(splatree, tree, tmp_path):
    output, folder = tmp_path / "a.splatree", tmp_path / "a.run"
    words = ("refine", tree, output, "--iterations", "80", "--made-views", "16")
    folder.mkdir()
    (folder / "checkpoint.npz").write_bytes(b"another")
    code, _, err = splatree(*words)
    assert code == 1 and "holds a run already; go on with --resume" in err and not output.exists()
    code, _, err = splatree(*words, "--resume")
    assert code == 1 and "not a whole checkpoint" in err and not output.exists()
    assert splatree(*words, "--force")[0] == 0 and output.exists() and not folder.exists()
    code, _, err = splatree(*words, "--resume")
    assert code == 1 and "checkpoint.npz: not found; wanted the folder of a run that was begun" in err


@pytest.mark.parametrize("more", [(), ("--force",), ("--resume",)])
@pytest.mark.parametrize("verb", ["refine", "build"])
def test_the_run_of_a_training_is_neither_replaced_nor_gone_on_with(
    splatree, tree, small_ply, tmp_path, monkeypatch, verb, more
):
    output, folder = tmp_path / "a.splatree", tmp_path / "a.run"
    save(folder, Identity("train", {}, {}), {"means": np.zeros(3)}, {})
    before = (folder / "checkpoint.npz").read_bytes()
    for module in ("build", "refine"):
        monkeypatch.setattr(f"splatree.cli.{module}.refine", lambda *given, **named: pytest.fail("it learned"))
    words = ("refine", tree, output) if verb == "refine" else ("build", small_ply, output, "--refine", "0.02")
    code, _, err = splatree(*words, *more)
    assert code == 1 and "a.run: holds a run of train, which refine neither replaces nor goes on with" in err
    assert "--run" in err and (folder / "checkpoint.npz").read_bytes() == before and not output.exists()


def test_runs_that_cannot_be_are_refused_before_levels_are_built(splatree, tree, small_ply, tmp_path, monkeypatch):
    monkeypatch.setattr("splatree.cli.refine.read_scene", lambda *given: pytest.fail("a scene was read"))
    monkeypatch.setattr("splatree.cli.build._with_levels", lambda *given: pytest.fail("levels were built"))
    (tmp_path / "file").write_text("")
    output = tmp_path / "a.splatree"
    for words in (("refine", tree, output), ("build", small_ply, output, "--refine", "0.02")):
        code, _, err = splatree(*words, "--resume")
        assert code == 1 and "checkpoint.npz: not found; wanted the folder of a run that was begun" in err
        for folder in (tmp_path / "none" / "a.run", tmp_path / "file", tmp_path / ("n" * 300)):
            code, _, err = splatree(*words, "--run", folder)
            assert code == 1 and f"{folder.name}: cannot be made a folder for the run" in err


def interrupted(words, number, share=0.05):
    """A command that is interrupted after a share of its steps: what it said."""
    program = [sys.executable, "-m", "splatree", *map(str, words), "--progress", "json"]
    with subprocess.Popen(
        program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=listen_to_interruptions
    ) as child:
        for line in child.stderr:
            if '"refine inner nodes"' in line and json.loads(line)["done"] > share:
                child.send_signal(number)
                break
        out, err = child.communicate()
    assert child.returncode == 0, err
    return out


@pytest.mark.skipif(os.name == "nt", reason="no signals between processes there")
def test_an_interruption_leaves_a_tree_and_a_run_that_goes_on(splatree, tree, tmp_path):
    words = ("refine", tree, "--iterations", "200", "--made-views", "16")
    output, whole = tmp_path / "a.splatree", tmp_path / "whole.splatree"
    assert splatree(*words, "-o", whole)[0] == 0
    out = interrupted((*words, "-o", output), signal.SIGTERM, 0.3)
    assert f"interrupted: the run goes on from {tmp_path / 'a.run'} with --resume" in out
    assert len(st.read(output)) == len(st.read(tree)) and output.read_bytes() != whole.read_bytes()
    code, _, err = splatree(*words, "-o", output, "--rate", "2", "--resume")
    assert code == 1 and "begun with rate 1.0, found 2.0" in err
    code, said, err = splatree(*words, "-o", output, "--resume", "--json")
    assert code == 0, err
    assert not json.loads(said)["stopped"] and json.loads(said)["iterations"] == 200
    assert output.read_bytes() == whole.read_bytes() and not (tmp_path / "a.run").exists()


@pytest.mark.skipif(os.name == "nt", reason="no signals between processes there")
def test_a_build_that_is_interrupted_while_it_refines_goes_on(splatree, small_ply, tmp_path):
    output, folder = tmp_path / "a.splatree", tmp_path / "mine"
    words = ("build", small_ply, output, "--method", "pairs", "--refine", "0.08", "--run", folder)
    out = interrupted(words, signal.SIGINT)
    assert f"interrupted: the run goes on from {folder} with --resume" in out
    stopped = json.loads(st.read(output).source.metadata["refined"])
    assert splatree(*words, "--force", "--resume", "--pixel-size", "0.5")[0] == 1  # other levels
    code, out, err = splatree(*words, "--resume")
    assert code == 0, err
    assert "interrupted" not in out and not folder.exists()
    ended = json.loads(st.read(output).source.metadata["refined"])
    assert stopped["stopped"] and not ended["stopped"] and ended["iterations"] > stopped["iterations"]
    code, _, err = splatree(*words[:5], "--resume")
    assert code == 2 and "found --run or --resume without --refine" in err


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
