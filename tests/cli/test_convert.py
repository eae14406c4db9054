import json

import numpy as np
import pytest

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
