import json

import numpy as np
import pytest

from splatree.cli.console import size
from splatree.io.estimate import estimated_compact_bytes
from splatree.io.formats.spz.versions import readers_of
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.scene.scene import Scene

NUM_GAUSSIANS = 3161


def result_of(run):
    code, out, err = run
    assert (code, err) == (0, "")
    return json.loads(out)


def test_convert_edits_on_the_way_and_says_what_is_lost(splatree, small_ply, tmp_path):
    words = ("convert", small_ply, tmp_path / "out.splat", "--rotate", "90", "0", "0", "--scale", "2")
    converted = result_of(splatree(*words, "--crop-sphere", "400", "-800", "0", "100", "--json"))
    means = read(small_ply).gaussians.means.astype(np.float64)
    turned = 2 * np.stack([means[:, 0], -means[:, 2], means[:, 1]], axis=1)  # about x: y to z, z to −y
    inside = np.linalg.norm(turned - [400, -800, 0], axis=1) <= 100
    assert converted["num_gaussians"] == len(read(tmp_path / "out.splat")) == inside.sum() > 0
    assert converted["num_read"] == NUM_GAUSSIANS and converted["in_chunks"]
    code, words, _ = splatree("convert", small_ply, tmp_path / "out.splat", "--force")
    assert code == 0 and "lost: the harmonics of degrees 1 to 3" in words


def test_drop_invalid_drops_where_repair_mends(splatree, small_scene, tmp_path):
    g = small_scene.gaussians.take(np.arange(50))
    g.log_scales[3] = 77
    write(Scene.flat(g), tmp_path / "bad.ply")
    assert splatree("convert", tmp_path / "bad.ply", tmp_path / "out.ply")[0] == 1
    counts = [
        result_of(splatree("convert", tmp_path / "bad.ply", tmp_path / "out.ply", option, "--force", "--json"))
        for option in ("--repair", "--drop-invalid")
    ]
    assert [c["num_gaussians"] for c in counts] == [50, 49]
    assert [c["repairs"] for c in counts] == [{"clamped_scales": 1}, {"dropped_rows": 1}]


@pytest.mark.parametrize(
    "words",
    [("convert", "out.spz"), ("thin", "out.ply", "--keep", "0.5"), ("build", "out.splatree", "--method", "radius")],
)
def test_infinite_logits_are_read_and_told(splatree, small_scene, tmp_path, words):
    g = small_scene.gaussians.take(np.arange(50))
    g.logit_opacities[[3, 9]] = np.inf, -np.inf
    write(Scene.flat(g), tmp_path / "certain.ply")
    verb, output, *options = words
    code, said, _ = splatree(verb, tmp_path / "certain.ply", tmp_path / output, *options)
    assert code == 0 and "repaired: clamped_opacities 2" in said
    assert np.isfinite(read(tmp_path / output).gaussians.logit_opacities).all()


@pytest.mark.parametrize(("words", "version"), [((), 4), (("--spz-version", "3"), 3), (("--format-version", "2"), 2)])
def test_convert_says_which_version_of_spz_was_written_and_who_cannot_read_it(
    splatree, small_ply, tmp_path, words, version
):
    code, out, _ = splatree("convert", small_ply, tmp_path / "a.spz", *words)
    assert code == 0
    assert read(tmp_path / "a.spz").source.metadata["version"] == str(version)
    assert [line for line in out.splitlines() if line.startswith("spz version")] == [readers_of(version)]
    assert "spz version" not in splatree("convert", small_ply, tmp_path / "a.splat")[1]


def test_build_says_how_much_larger_the_tree_is_and_what_is_more_compact(splatree, small_ply, tmp_path):
    sog, tree = tmp_path / "a.sog", tmp_path / "a.splatree"
    assert splatree("convert", small_ply, sog)[0] == 0
    code, out, _ = splatree("build", sog, tree)
    assert code == 0
    before, after = sog.stat().st_size, tree.stat().st_size
    line = next(line for line in out.splitlines() if "of the input" in line)
    assert line.startswith(f"{after / before:.1f} times the {size(before)} of the input, {size(after - before)} more")
    assert line.endswith(f"splatree convert {tree} {tree.with_name('a_compact.splatree')} --compact")
    compact = tree.with_name("a_compact.splatree")
    assert splatree("convert", tree, compact, "--compact")[0] == 0
    estimate = estimated_compact_bytes(read(tree).tree.num_leaves, len(read(tree)), 3)
    # Palettes of a few thousand Gaussians weigh more than those the estimate was made for.
    assert 0.5 * estimate < compact.stat().st_size < 2 * estimate
    assert read(compact).tree.num_levels == read(tree).tree.num_levels
    rad = splatree("build", sog, tmp_path / "b.rad")[1]
    assert "of the input" in rad and "splatree convert" not in rad


def test_a_compact_tree_is_built_converted_and_described(splatree, small_ply, tmp_path):
    built, exact, again = (tmp_path / f"{name}.splatree" for name in ("built", "exact", "again"))
    code, out, _ = splatree("build", small_ply, built, "--compact")
    assert code == 0 and "lost: precision: a compact splatree rounds values" in out
    assert splatree("convert", built, exact)[0] == 0
    assert splatree("convert", exact, again, "--compact")[0] == 0
    assert again.stat().st_size < exact.stat().st_size / 5
    for path, is_compact in ((built, True), (exact, False), (again, True)):
        code, out, _ = splatree("info", path, "--json")
        assert json.loads(out)["compact"] is is_compact
    assert "splatree, compact: values are rounded" in splatree("info", built)[1]


def test_compact_is_refused_where_it_means_nothing(splatree, small_ply, tmp_path):
    code, _, err = splatree("convert", small_ply, tmp_path / "a.spz", "--compact")
    assert code == 2 and "found the option compact = True, but this format takes only" in err
    code, _, err = splatree("build", small_ply, tmp_path / "a.splatree", "--compact", "--max-memory", "1G")
    assert code == 2 and "--compact" in err


@pytest.mark.parametrize("compact", [(), ("--compact",)], ids=["in runs", "in memory"])
def test_a_cut_counts_the_nodes_that_are_written(splatree, small_tree, tmp_path, compact):
    """Of an exact tree a cut is written in runs; of a compact one in memory."""
    splatree("convert", small_tree, tmp_path / "a.splatree", *compact)
    code, words, _ = splatree("convert", tmp_path / "a.splatree", tmp_path / "top.ply", "--depth", "1")
    num_nodes = len(read(tmp_path / "top.ply"))
    assert code == 0 and num_nodes < NUM_GAUSSIANS
    assert words.startswith(
        f"wrote {tmp_path / 'top.ply'}: {num_nodes:,} nodes at depth 1 for {NUM_GAUSSIANS:,} Gaussians, "
    )


@pytest.mark.parametrize("suffix", [".ply", ".hier"])
def test_a_crop_that_leaves_nothing_is_told(splatree, small_ply, tmp_path, suffix):
    """In chunks and in memory."""
    crop = ("--crop-sphere", "9000", "9000", "9000", "1")
    code, words, _ = splatree("convert", small_ply, tmp_path / f"a{suffix}", *crop)
    assert code == 0 and "note: nothing is left of the scene" in words
    assert "nothing is left" not in splatree("convert", small_ply, tmp_path / f"b{suffix}")[1]
