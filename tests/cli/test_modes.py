"""What verbs are told of a file that does not say it, and what they say of a file that holds more."""

import re

import numpy as np
import pytest

from splatree.io.reading import read

from .test_commands import result_of


def test_thin_follows_the_mode(splatree, small_ply, tmp_path):
    scenes = {}
    for mode in ("classic", "antialiased"):
        out = tmp_path / f"{mode}.ply"
        result_of(splatree("thin", small_ply, out, "--radius", "2", "--mode", mode, "--json"))
        scenes[mode] = read(out)
        assert scenes[mode].mode == mode
    logits = [scene.gaussians.logit_opacities for scene in scenes.values()]
    assert len(logits[0]) == len(logits[1]) and not np.array_equal(*logits)


@pytest.mark.parametrize("suffix", ["ply", "splatree", "spz"])
def test_convert_notes_the_mode(splatree, small_ply, tmp_path, suffix):
    result_of(splatree("convert", small_ply, tmp_path / f"a.{suffix}", "--mode", "antialiased", "--json"))
    assert read(tmp_path / f"a.{suffix}").mode == "antialiased"
    code, _, err = splatree("convert", small_ply, tmp_path / "b.ply", "--mode", "sharp")
    assert code == 2 and "sharp" in err


@pytest.fixture
def moving_ply(small_ply, tmp_path):
    """A scene of 4D Gaussians by its header."""
    head, _, data = small_ply.read_bytes().partition(b"end_header\n")
    count = int(re.search(rb"element vertex (\d+)", head)[1])
    rows = np.frombuffer(data, np.uint8).reshape(count, -1)
    path = tmp_path / "moving.ply"
    path.write_bytes(head + b"property float t\nend_header\n" + np.pad(rows, ((0, 0), (0, 4))).tobytes())
    return path


def test_info_describes_what_other_verbs_refuse(splatree, moving_ply, tmp_path):
    code, out, _ = splatree("info", moving_ply)
    assert code == 0 and "lost" in out and "motion in time (4D Gaussians), the properties t" in out
    for words in (("convert", moving_ply, tmp_path / "a.ply"), ("build", moving_ply, tmp_path / "a.splatree")):
        code, out, err = splatree(*words)
        assert (code, out) == (1, "") and "--ignore-properties" in err
    code, out, _ = splatree("convert", moving_ply, tmp_path / "a.ply", "--ignore-properties")
    assert code == 0 and "lost: motion in time" in out


def test_info_says_where_a_scene_lies_and_the_step_of_its_coordinates(splatree, small_ply, tmp_path):
    near = result_of(splatree("info", small_ply, "--json"))
    assert near["origin"] == [0, 0, 0] and near["coordinate_step"] < 1e-4
    far = tmp_path / "far.ply"
    result_of(splatree("convert", small_ply, far, "--translate", "500000", "4500000", "0", "--json"))
    found = result_of(splatree("info", far, "--json"))
    assert any(found["origin"]) and found["coordinate_step"] < 1e-4
    assert found["box_min"] == pytest.approx(np.add(near["box_min"], (500000, 4500000, 0)), abs=1e-3)
    _, out, _ = splatree("info", far)
    assert "relative to the origin (" in out and "float32 leaves steps of" in out
    _, out, _ = splatree("convert", far, tmp_path / "far.splat")
    assert "note: coordinates lie so far from zero" in out and "lost: the origin (" in out
