"""``thin`` and ``convert`` are told how a scene was trained, where its file does not say it."""

import numpy as np
import pytest

from splatree.io.registry import read

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
