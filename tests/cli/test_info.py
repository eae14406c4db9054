"""What ``splatree info`` says beyond counts: histograms, the vertical, outliers, other formats, the next step."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from splatree.cli.histogram import BINS, in_lines, linear, logarithmic
from splatree.cli.info import describe
from splatree.edit.clean import CleanOptions, clean
from splatree.io.estimate import estimated_bytes
from splatree.io.options import ReadOptions
from splatree.io.outline import outline_of, read_outline
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.render.build import build_lod
from splatree.scene.scene import Scene

from ..scenes import random_gaussians


def described(splatree, *words):
    code, out, err = splatree("info", *words, "--json")
    assert (code, err) == (0, "")
    return json.loads(out)


def test_a_file_in_chunks_is_described_as_the_scene_in_memory(small_ply):
    outline = read_outline([small_ply], ReadOptions())
    whole = describe(outline_of(read(small_ply)))
    assert outline.in_chunks and outline.scene.gaussians.sh_degree == 0
    assert replace(describe(outline), in_chunks=False) == whole


def test_several_files_in_chunks_are_one_scene_without_their_harmonics(small_scene, tmp_path):
    paths = [tmp_path / "a.ply", tmp_path / "b.ply"]
    write(small_scene, paths[0])
    write(Scene.flat(small_scene.gaussians.rows(0, 100).with_sh_degree(1)), paths[1])
    outline, whole = read_outline(paths, ReadOptions()), read(paths)
    assert outline.scene.source == whole.source
    assert outline.sample.gaussians.sh_degree == 3
    assert np.array_equal(outline.scene.gaussians.means, whole.gaussians.means)
    assert np.array_equal(outline.sample.gaussians.sh, whole.gaussians.sh)
    assert outline.nbytes == whole.gaussians.nbytes


def test_the_sample_is_spread_over_all_chunks(small_ply, monkeypatch):
    monkeypatch.setattr("splatree.io.outline.SAMPLE", 1000)
    outline, whole = read_outline([small_ply], ReadOptions()), read(small_ply)
    assert np.array_equal(outline.sample.gaussians.sh, whole.gaussians.sh[::4])


def test_repairs_of_a_file_in_chunks_are_counted(splatree, small_scene, tmp_path):
    quats = small_scene.gaussians.quats.copy()
    quats[7] = 0
    write(Scene.flat(replace(small_scene.gaussians, quats=quats)), tmp_path / "bad.ply")
    found = described(splatree, tmp_path / "bad.ply", "--repair")
    assert found["metadata"]["repairs"] == read(tmp_path / "bad.ply", repair=True).source.metadata["repairs"]


def test_every_leaf_is_in_each_histogram(splatree, small_tree):
    found = described(splatree, small_tree)
    for name in ("opacity", "size", "extent"):
        assert sum(found["histograms"][name]["counts"]) == found["num_gaussians"]
        assert len(found["histograms"][name]["counts"]) == BINS
    assert found["histograms"]["opacity"]["edges"] == [i / BINS for i in range(BINS + 1)]


def test_histograms_count_their_ends_and_degenerate_values():
    assert linear(np.array([0.0, 0.1, 1.0]), 0, 1).counts == (2, 0, 0, 0, 0, 0, 0, 1)
    values = np.append(np.full(2000, 1.0), np.full(2000, 256.0))
    assert logarithmic(np.append(values, [1e-9, 1e9])).counts == (2001, 0, 0, 0, 0, 0, 0, 2001)
    assert logarithmic(np.full(5, 2.0)).counts == (5,)
    assert in_lines("size", logarithmic(np.zeros(3))) == []


def test_the_words_end_with_the_next_command(splatree, small_ply, small_tree, monkeypatch):
    _, out, _ = splatree("info", small_ply)
    assert out.splitlines()[-1] == f"next: splatree build {small_ply} small.splatree"
    assert "estimated .sog" in out and "█" in out
    with small_ply.open() as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        _, out, _ = splatree("info", "-")
    assert out.splitlines()[-1] == "next: splatree build INPUT scene.splatree"  # standard input cannot be read again
    _, out, _ = splatree("info", small_tree)
    assert out.splitlines()[-1] == f"next: splatree render {small_tree} -o pictures"


def test_the_next_command_never_names_a_file_that_is_there(splatree, small_scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(small_scene, tmp_path / "flat.splatree")
    _, out, _ = splatree("info", "flat.splatree")
    assert out.splitlines()[-1] == "next: splatree build flat.splatree flat_levels.splatree"
    write(Scene.flat(small_scene.gaussians.take(np.arange(1))), tmp_path / "one.ply")
    _, out, _ = splatree("info", "one.ply")
    assert out.splitlines()[-1] == "next: splatree render one.ply -o pictures"


def test_the_vertical_that_a_file_states_is_told(small_scene):
    stated = replace(small_scene.source, metadata={"comments": json.dumps(["Vertical axis: +z"])})
    info = describe(outline_of(replace(small_scene, source=stated)))
    assert info.up is not None and info.up[2] > 0.97
    assert (info.up_reason, info.up_is_sure) == ("what the file says", True)


def test_outliers_are_counted_as_the_advised_command_drops_them(splatree, small_scene, tmp_path):
    g = small_scene.gaussians
    means, log_scales, logits = g.means.copy(), g.log_scales.copy(), g.logit_opacities.copy()
    means[:3] += 1e5
    log_scales[3:5] = 9
    logits[5] = -9
    scene = Scene.flat(replace(g, means=means, log_scales=log_scales, logit_opacities=logits))
    write(scene, tmp_path / "wild.ply")
    found = {o["advice"]: o["number"] for o in described(splatree, tmp_path / "wild.ply")["outliers"]}
    assert found["splatree clean INPUT --max-distance 10 --dry-run"] == 3
    large = next(advice for advice in found if "--max-size" in advice)
    limit = float(large.split()[4])
    assert found[large] == clean(scene, CleanOptions(max_size=limit)).num_dropped == 2
    faint = next(advice for advice in found if "--min-opacity" in advice)
    assert found[faint] >= 1
    floaters = found["splatree clean INPUT --floaters --dry-run"]
    assert floaters == clean(scene, CleanOptions(floaters=True)).num_dropped


def test_where_nothing_hangs_together_nothing_is_called_a_floater(splatree, tmp_path):
    g = random_gaussians(200)
    g.log_scales[:] = -4
    write(Scene.flat(g), tmp_path / "loose.ply")
    assert clean(read(tmp_path / "loose.ply"), CleanOptions(floaters=True)).num_dropped > 100
    assert not any("--floaters" in o["advice"] for o in described(splatree, tmp_path / "loose.ply")["outliers"])


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".glb", ".splatree"])
@pytest.mark.parametrize("degree", [0, 3])
def test_estimates_of_plain_formats_are_their_sizes(small_scene, tmp_path, suffix, degree):
    scene = Scene.flat(small_scene.gaussians.with_sh_degree(degree))
    write(scene, tmp_path / f"a{suffix}")
    # A header of up to 6 KB is not estimated.
    assert estimated_bytes(len(scene), degree)[suffix] == pytest.approx(
        (tmp_path / f"a{suffix}").stat().st_size, abs=6000
    )


def test_a_scene_with_levels_and_an_empty_one_are_described(splatree, small_scene, tmp_path):
    tree = build_lod(small_scene)
    info = describe(outline_of(tree))
    assert info.estimated_bytes == estimated_bytes(len(small_scene), 3)
    write(Scene.flat(small_scene.gaussians.rows(0, 0)), tmp_path / "empty.ply")
    found = described(splatree, tmp_path / "empty.ply")
    assert (found["up"], found["outliers"], found["num_gaussians"]) == (None, [], 0)
    assert splatree("info", tmp_path / "empty.ply")[0] == 0


def test_logits_far_below_those_of_any_opacity_are_described(splatree, tmp_path):
    write(Scene.flat(replace(random_gaussians(9), logit_opacities=np.full(9, -1e10, np.float32))), tmp_path / "a.ply")
    assert described(splatree, tmp_path / "a.ply")["opacity"]["max"] == 0


def test_values_that_another_meaning_fits_better_are_doubted(splatree, small_scene, tmp_path):
    """Opacities in the place of logits, and standard deviations in the place of their logarithms."""
    city = small_scene.gaussians
    g = replace(city, means=city.means / 100, log_scales=city.log_scales - np.float32(np.log(100)))
    plain = replace(g, logit_opacities=g.opacities().astype(np.float32), log_scales=np.exp(g.log_scales))
    write(Scene.flat(plain), tmp_path / "plain.ply")
    assert [
        ("opacities" in d, "standard deviations" in d) for d in described(splatree, tmp_path / "plain.ply")["doubts"]
    ] == [
        (True, False),
        (False, True),
    ]
    assert "doubtful" in splatree("info", tmp_path / "plain.ply")[1]
    huge = replace(g, log_scales=g.log_scales + 9, means=8000 * g.means)
    for scene in (small_scene, Scene.flat(g.rows(0, 5)), Scene.flat(huge)):
        assert describe(outline_of(scene)).doubts == ()


def test_comments_are_shown_in_their_letters_and_cannot_steer_the_terminal(splatree, small_scene, tmp_path):
    comments = json.dumps(["Größe", "\x1b[31mred"])
    write(
        replace(small_scene, source=replace(small_scene.source, metadata={"comments": comments})),
        tmp_path / "a.splatree",
    )
    words = splatree("info", tmp_path / "a.splatree")[1]
    assert "Größe, \\x1b[31mred" in words and "\x1b" not in words
