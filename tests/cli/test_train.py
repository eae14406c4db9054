"""``splatree train`` from photographs to a file, interruptions included."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.constants import NEAR

from .conftest import listen_to_interruptions
from .test_commands import result_of

QUICK = ("--iterations", "6", "--max-gaussians", "300")


@pytest.fixture
def data(small_scene, tmp_path):
    """Ten photographs of a piece of a city, and their cameras."""
    return photographed(small_scene, tmp_path / "photographs")


def photographed(scene, folder):
    """Photographs of a scene, with cameras that say nothing of the nearest depth."""
    folder.mkdir()
    cameras = st.flyout(scene, st.PathOptions(views=10, width=64, height=48))
    named = [replace(camera, name=f"{camera.name}.png") for camera in cameras]
    st.write_cameras([replace(camera, near=NEAR) for camera in named], folder / "cameras.json")
    for camera in named:
        st.write_image(st.render(scene, camera).image, folder / camera.name)
    return folder


def test_photographs_become_a_scene_that_is_read_drawn_and_judged(splatree, data, tmp_path):
    output = tmp_path / "scene.splatree"
    found = result_of(splatree("train", data, "-o", output, *QUICK, "--json"))
    assert found["num_gaussians"] == found["num_nodes"] == 300 and not found["stopped"]
    assert found["held_out"] == "every 8th view from the first: 2 of 10"
    assert found["history"][-1]["iterations"] == 6 and found["history"][-1]["score"]["psnr_fitted"] > 5
    judged = result_of(splatree("eval", output, "--data", data, "--frames", "0", "--pixel-error", "0", "--json"))
    # The same views, photographs and rule; scores differ by the clipping alone.
    assert judged["mean"]["psnr_vs_photo"] == pytest.approx(found["history"][-1]["score"]["psnr"], abs=0.01)
    assert sorted(path.name for path in (tmp_path / "scene.run").iterdir()) == [
        "checkpoint.npz",
        "exposure.json",
        "log.json",
    ]


def test_a_scene_smaller_than_the_usual_nearest_depth_is_judged_as_it_was_trained(splatree, small_scene, tmp_path):
    data = photographed(st.edit(small_scene, st.EditOptions(scale=1e-4)), tmp_path / "photographs")
    output = tmp_path / "scene.splatree"
    found = result_of(splatree("train", data, "-o", output, *QUICK, "--json"))
    score = found["history"][-1]["score"]["psnr"]
    judged = result_of(splatree("eval", output, "--data", data, "--frames", "0", "--pixel-error", "0", "--json"))
    assert judged["mean"]["psnr_vs_photo"] == pytest.approx(score, abs=0.01)
    black = [
        st.psnr(np.zeros((48, 64, 3), np.float32), st.read_image(path)) for path in sorted(data.glob("*.png"))[::8]
    ]
    assert abs(score - np.mean(black)) > 0.1  # or it would say nothing


@pytest.mark.parametrize("levels", ["radius", "pairs"])
def test_levels_are_built_at_once(splatree, data, tmp_path, levels):
    output = tmp_path / "scene.splatree"
    code, words, _ = splatree("train", data, "-o", output, *QUICK, "--levels", levels)
    scene = st.read(output)
    assert code == 0 and f"wrote {output}: 300 Gaussians, {len(scene):,} nodes" in words
    assert scene.tree.num_leaves == 300 < len(scene) and "training" in scene.source.metadata


def test_the_words_show_both_scores(splatree, data, tmp_path):
    code, words, _ = splatree("train", data, "-o", tmp_path / "a.ply", *QUICK)
    assert code == 0
    head = words.splitlines()[0].split()
    assert head[-3:] == ["PSNR", "fitted", "SSIM"] and "no points came with the cameras" in words


def test_wrong_lines_are_refused_before_any_work(splatree, data, tmp_path):
    assert splatree("train", data)[0] == 2
    code, _, err = splatree("train", data, "-o", tmp_path / "a.ply", "--levels", "pairs")
    assert code == 2 and "format ply has no levels of detail" in err
    code, _, err = splatree("train", data, "-o", tmp_path / "a.xyz")
    assert code == 2
    code, _, err = splatree("train", data, "-o", tmp_path / "a.ply", "--minutes", "1", "--iterations", "1")
    assert code == 2 and "wanted one of them" in err
    (tmp_path / "b.ply").write_bytes(b"mine")
    code, _, err = splatree("train", data, "-o", tmp_path / "b.ply", *QUICK)
    assert code == 1 and "exists already" in err and (tmp_path / "b.ply").read_bytes() == b"mine"


def test_a_run_is_never_overwritten_unasked(splatree, data, tmp_path):
    output = tmp_path / "a.splatree"
    result_of(splatree("train", data, "-o", output, *QUICK, "--json"))
    output.unlink()
    code, _, err = splatree("train", data, "-o", output, *QUICK)
    assert code == 1 and "holds a run already; go on with --resume" in err and not output.exists()
    result_of(splatree("train", data, "-o", output, *QUICK, "--resume", "--json"))
    result_of(splatree("train", data, "-o", output, *QUICK, "--force", "--json"))


@pytest.mark.skipif(os.name == "nt", reason="no signals between processes there")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_an_interruption_leaves_a_scene_and_a_run_that_goes_on(splatree, data, tmp_path, number):
    words = ["train", data, "--iterations", "400", "--max-gaussians", "300", "--json"]
    whole = result_of(splatree(*words, "-o", tmp_path / "whole.ply"))
    program = [sys.executable, "-m", "splatree", *map(str, words[:-1]), "-o", str(tmp_path / "a.ply"), "-v"]
    with subprocess.Popen(
        program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=listen_to_interruptions
    ) as child:
        for line in child.stderr:  # after the first score there is a run to interrupt
            if line.startswith("25%") or "%:" in line:
                child.send_signal(number)
                break
        out, err = child.communicate()
    assert child.returncode == 0, err
    assert "interrupted: the run goes on from" in out
    stopped = st.read(tmp_path / "a.ply")
    resumed = result_of(splatree(*words, "-o", tmp_path / "a.ply", "--resume"))
    assert not resumed["stopped"] and resumed["history"][-1]["iterations"] == 400
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert not np.array_equal(stopped.gaussians.means, st.read(tmp_path / "a.ply").gaussians.means)
    assert json.dumps(whole["history"][-1]["score"]) == json.dumps(resumed["history"][-1]["score"])
