"""What verbs are told of a file that does not say it, and what they say of a file that holds more."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.render.build import build_lod
from splatree.scene.scene import Source

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


@pytest.fixture(scope="module")
def levels(small_scene, tmp_path_factory):
    """Files and folders with levels made for `classic`, by how they are read."""
    folder = tmp_path_factory.mktemp("levels")
    tree = build_lod(small_scene, st.BuildOptions("radius"))
    for name in ("tree.splatree", "tree.rad"):
        write(tree, folder / name)
    write(st.build_clusters(tree, 4), folder / "clustered.splatree")
    write(small_scene, folder / "leaves.ply")
    st.build_folder(folder / "leaves.ply", folder / "parts.splatree")
    st.stream(tree, folder / "web")
    return folder


RELABELLED = [
    ("convert", "tree.splatree", "out.splatree"),
    ("convert", "tree.splatree", "out.rad"),
    ("convert", "tree.splatree", "out.ply", "--depth", "0"),
    ("convert", "clustered.splatree", "out.splatree"),
    ("convert", "tree.rad", "out.splatree"),
    ("convert", "parts.splatree", "out.splatree"),
    ("convert", "tree.splatree", "clustered.splatree", "-o", "out.splatree"),
    ("build", "tree.splatree", "out.splatree", "--flat", "--clusters", "4"),
    ("build", "tree.splatree", "out.splatree", "--flat", "--clusters", "4", "--max-memory", "1G"),
    ("build", "web", "out.splatree", "--levels", "file"),
    ("stream", "tree.splatree", "out"),
    ("stream", "parts.splatree", "out"),
    ("view", "tree.splatree", "--no-browser"),
    ("view", "parts.splatree", "--no-browser"),
]


@pytest.mark.parametrize("words", RELABELLED, ids=" ".join)
def test_levels_keep_the_mode_that_they_were_made_for(splatree, levels, tmp_path, words):
    verb, *rest = (levels / word if (levels / word).exists() else word for word in words)
    rest = [tmp_path / word if str(word).startswith("out") else word for word in rest]
    code, out, err = splatree(verb, *rest, "--mode", "antialiased")
    assert code in (1, 2) and out == "" and "found antialiased for " in err and "classic" in err
    assert "build the levels anew from their leaves: splatree build" in err
    assert not any(tmp_path.iterdir())


def test_the_mode_of_levels_may_be_repeated(splatree, levels, tmp_path):
    assert splatree("convert", levels / "tree.splatree", tmp_path / "a.splatree", "--mode", "classic")[0] == 0
    words = ("build", levels / "web", tmp_path / "b.splatree", "--levels", "file", "--mode", "classic")
    assert splatree(*words)[0] == 0


def test_leaves_and_new_levels_take_the_mode_that_is_named(splatree, levels, tmp_path):
    for verb, source, out in (
        ("convert", "tree.splatree", "leaves.ply"),
        ("build", "tree.splatree", "anew.splatree"),
        ("thin", "tree.splatree", "thin.ply"),
    ):
        assert splatree(verb, levels / source, tmp_path / out, "--mode", "antialiased")[0] == 0
        assert read(tmp_path / out).mode == "antialiased"
    assert read(tmp_path / "anew.splatree").tree.record.mode == "antialiased"


def test_levels_that_do_not_say_their_mode_take_the_one_that_is_named(splatree, levels, tmp_path):
    tree = read(levels / "tree.splatree")
    unsaid = replace(tree, tree=replace(tree.tree, record=None), source=Source())
    write(unsaid, tmp_path / "unsaid.splatree")
    assert splatree("convert", tmp_path / "unsaid.splatree", tmp_path / "out.rad", "--mode", "antialiased")[0] == 0
    assert read(tmp_path / "out.rad").mode == "antialiased"
    shutil.copytree(levels / "web", tmp_path / "web")
    manifest = tmp_path / "web" / "lod-meta.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text("utf-8")), "asset": {}}), "utf-8")
    words = ("build", tmp_path / "web", tmp_path / "out.splatree", "--levels", "file", "--mode", "antialiased")
    assert splatree(*words)[0] == 0 and read(tmp_path / "out.splatree").mode == "antialiased"
