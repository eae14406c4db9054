import json
from dataclasses import replace

import numpy as np
import pytest

import splatree as st
from splatree.io.reading import read, read_levels
from splatree.io.writing import write


def test_stream_writes_a_folder_that_reads_back(splatree, small_tree, tmp_path):
    code, out, err = splatree(
        "stream", small_tree, tmp_path / "out", "--levels", "3", "--chunk-leaves", "500", "--json"
    )
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["written"]["levels"][0]["num_nodes"] == len(read(tmp_path / "out")) == 3161
    assert found["written"]["num_chunks"] >= 7 and not found["built_levels"]
    again = splatree("stream", small_tree, tmp_path / "out")
    assert again[0] == 1 and "holds a stream already" in again[2]
    code, out, _ = splatree("stream", small_tree, tmp_path / "out", "--levels", "3", "--chunk-leaves", "500", "--force")
    assert code == 0 and "4 of them there already" in out and "extent" in out


def test_levels_are_built_where_there_are_none(splatree, small_ply, tmp_path):
    code, out, _ = splatree("stream", small_ply, "-o", tmp_path / "out")
    assert code == 0 and "levels of detail: built first" in out


def test_levels_are_built_for_the_mode_that_a_file_does_not_say(splatree, small_ply, small_tree, tmp_path):
    for mode in ("classic", "antialiased"):
        assert splatree("stream", small_ply, tmp_path / mode, "--mode", mode)[0] == 0
    classic, antialiased = (read(tmp_path / mode) for mode in ("classic", "antialiased"))
    assert (classic.mode, antialiased.mode) == ("classic", "antialiased")
    coarse = [read_levels(tmp_path / mode)[-1].gaussians for mode in ("classic", "antialiased")]
    assert len(coarse[0]) != len(coarse[1]) or not np.array_equal(coarse[0].log_scales, coarse[1].log_scales)
    for verb in ("stream", "view"):
        out = [tmp_path / "no"] if verb == "stream" else []
        code, _, err = splatree(verb, small_tree, *out, "--mode", "antialiased")
        assert code == 2 and "levels of detail that were made for classic" in err and not (tmp_path / "no").exists()


def test_stream_for_spark_is_a_rad(splatree, small_tree, tmp_path):
    code, out, _ = splatree("stream", small_tree, tmp_path / "out.rad", "--format", "rad", "--sh-degree", "1")
    assert code == 0 and "1 chunk in 1 part," in out
    back = read(tmp_path / "out.rad")
    assert back.gaussians.sh_degree == 1 and back.tree.num_levels > 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "found no path, wanted an input and an output"),
        (("{tree}",), "found one path, wanted an input and an output"),
        (("{tree}", "{tree}"), "is an input too"),
        (
            ("{tree}", "out.rad", "--format", "rad", "--ratio", "3"),
            "ratio: found 3.0 for the format rad, but only sog uses it",
        ),
    ],
)
def test_wrong_command_lines_are_refused(splatree, small_tree, words, message):
    code, _, err = splatree("stream", *(word.format(tree=small_tree) for word in words))
    assert code == 2 and message in err


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("out.rad", (), "choose the format rad"),
        ("out.rad", ("--format", "3dtiles"), "choose the format rad"),
        ("out.ssog", (), "choose the format sog with the option zip (--format sog --zip)"),
        ("out.sog", (), "found the name of a file, but a stream of the format sog is a folder of many files"),
        ("out.glb", ("--format", "3dtiles"), "a stream of the format 3dtiles is a folder of many files"),
        ("out.ZIP", (), "is a folder of many files"),
        ("lod-meta.json", (), "found the name of a manifest, wanted that of the folder around it"),
    ],
)
def test_the_name_of_a_file_makes_no_folder(splatree, small_tree, tmp_path, name, words, message):
    code, _, err = splatree("stream", small_tree, tmp_path / name, *words)
    assert code == 1 and message in err and not (tmp_path / name).exists()


def test_a_rad_has_its_suffix(splatree, small_tree, tmp_path):
    code, _, err = splatree("stream", small_tree, tmp_path / "out", "--format", "rad")
    assert code == 1 and "wanted one that ends in .rad" in err


@pytest.mark.parametrize("format", ["sog", "3dtiles"])
def test_a_folder_of_parts_is_streamed_as_its_tree_in_memory(splatree, small_ply, tmp_path, format):
    folder = st.build_folder(small_ply, tmp_path / "parts.splatree", running=st.FolderOptions(part_rows=500)).path
    code, _, err = splatree("stream", folder, tmp_path / "web", "--format", format)
    assert code == 0, err
    st.stream(st.read(folder), tmp_path / "wanted", format)
    found, wanted = (
        {
            path.relative_to(tmp_path / name): path.read_bytes()
            for path in (tmp_path / name).rglob("*")
            if path.is_file()
        }
        for name in ("web", "wanted")
    )
    assert found == wanted
    assert sorted(path.name for path in tmp_path.iterdir()) == ["parts.splatree", "wanted", "web"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("there",), "holds a stream already; choose another folder or replace it with force (--force)"),
        (("there.rad", "--format", "rad"), "exists already; choose another name or replace it with force (--force)"),
        (("no/out",), "there is no folder"),
        (("out", "--format", "rad"), "wanted one that ends in .rad"),
        (("out", "--zip"), "wanted one that ends in .ssog"),
        (("out", "--ratio", "1"), "ratio: found 1.0, wanted at least 1.2"),
        (("out", "--levels", "0"), "levels: found 0, wanted at least 1"),
        (("out", "--sh-degree", "7"), "sh_degree: found 7, wanted 0 to 3"),
        (("out", "--format", "3dtiles", "--origin", "100", "0", "0"), "wanted latitude −90 to 90"),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_is_read(splatree, tmp_path, words, message):
    (tmp_path / "there").mkdir()
    for name in ("there/lod-meta.json", "there.rad"):
        (tmp_path / name).touch()
    code, out, err = splatree("stream", tmp_path / "missing.ply", "-o", tmp_path / words[0], *words[1:])
    assert code in (1, 2) and out == "" and message in err and "missing.ply" not in err


def test_a_failure_names_the_output_and_leaves_no_empty_folder(splatree, small_scene, tmp_path):
    means = small_scene.gaussians.means.copy()
    means[5] = 1e12
    write(replace(small_scene, gaussians=replace(small_scene.gaussians, means=means)), tmp_path / "far.ply")
    words = ("stream", tmp_path / "far.ply", tmp_path / "web", "--format", "3dtiles")
    code, _, err = splatree(*words)
    assert code == 1 and f"{tmp_path / 'web'}: found a mean of magnitude 1e+12" in err
    assert not (tmp_path / "web").exists()
    (tmp_path / "web").mkdir()
    assert splatree(*words)[0] == 1 and (tmp_path / "web").is_dir()


def test_memory_is_limited_where_the_scene_is_not_read_whole(splatree, small_ply, small_tree, tmp_path):
    folder = st.build_folder(small_ply, tmp_path / "parts.splatree").path
    for number, source in enumerate((folder, small_tree)):
        code, _, err = splatree("stream", source, tmp_path / f"web{number}", "--max-memory", "250M", "--sh-degree", "0")
        assert code == 0, err
        assert read(tmp_path / f"web{number}").gaussians.sh_degree == 0
    write(st.build_lod(read(small_ply)), tmp_path / "compact.splatree", options=st.WriteOptions(compact=True))
    for source in (small_ply, tmp_path / "compact.splatree"):
        code, _, err = splatree("stream", source, tmp_path / "no", "--max-memory", "1G")
        assert code == 2 and f"splatree build {source} -o parts.splatree --max-memory 1G" in err
    code, _, err = splatree("stream", folder, tmp_path / "no", "--max-memory", "1M")
    assert code == 1 and "max_memory: found 1M, wanted at least 250M" in err and not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    "words",
    [("stream", "gone.splatree", "web"), ("calibrate", "gone.splatree"), ("render", "gone.splatree", "-o", "frames")],
)
def test_a_limit_of_memory_for_what_is_not_there_is_answered_with_that(splatree, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    code, _, err = splatree(*words, "--max-memory", "300M")
    assert code == 1 and "gone.splatree: not found; wanted a scene file or folder" in err
