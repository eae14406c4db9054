"""How ``splatree build`` chooses the method of its levels, and what it says of it."""

import json
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import pytest

import splatree as st
from splatree.cli.main import main


@pytest.fixture(scope="module")
def city(tmp_path_factory) -> Path:
    """5,000 neighbours of the bundled city."""
    with as_file(files("splatree") / "data" / "semarang_5_9.sog") as path:
        gaussians = st.read(path).gaussians
    apart = np.linalg.norm(gaussians.means - np.median(gaussians.means, axis=0), axis=1)
    path = tmp_path_factory.mktemp("city") / "city.ply"
    st.write(st.Scene.flat(gaussians.take(np.argsort(apart)[:5000])), path)
    return path


def built(city: Path, folder: Path, capsys, *words: str) -> dict:
    output = folder / "out.splatree"
    assert main(["build", str(city), str(output), "--json", *words]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_default_says_which_method_and_both_figures(city, tmp_path, capsys):
    output = tmp_path / "out.splatree"
    assert main(["build", str(city), str(output)]) == 0
    trial = st.read(output).tree.record.trial
    assert f"levels by pairs: {trial.in_words()}" in capsys.readouterr().out


def test_fast_makes_levels_by_a_radius_and_measures_nothing(city, tmp_path, capsys):
    result = built(city, tmp_path, capsys, "--fast")
    assert result["rules"]["rule"] == "radius-thinning"
    assert result["trial"] is None
    record = st.read(tmp_path / "out.splatree").tree.record
    assert record.trial is None


@pytest.mark.parametrize("words", [["--method", "pairs"], ["--flat", "--clusters", "auto"], ["--levels", "file"]])
def test_fast_is_refused_beside_what_contradicts_it(city, tmp_path, capsys, words):
    assert main(["build", str(city), str(tmp_path / "out.splatree"), "--fast", *words]) == 2
    assert "found --fast with" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--fast"], ["--method", "radius"], ["--method", "radius", "--max-memory", "1G"]])
@pytest.mark.parametrize(("loss_db", "warns"), [(6.5, True), (5.5, False)])
def test_levels_by_a_radius_that_are_far_worse_are_not_written_without_a_word(
    city, tmp_path, capsys, monkeypatch, words, loss_db, warns
):
    trial = st.MethodTrial(radius_db=41.0, pairs_db=42.0, num_gaussians=5000, num_pictures=9, radius_loss_db=loss_db)
    monkeypatch.setattr("splatree.cli.radius_check.try_methods", lambda scene, most: trial)
    notes = built(city, tmp_path, capsys, *words)["notes"]
    assert any("show this scene badly" in note and "in one picture 6.5 dB less" in note for note in notes) == warns


def test_a_build_through_files_says_which_method_and_both_figures(city, tmp_path, capsys):
    output = tmp_path / "parts.splatree"
    assert main(["build", str(city), str(output), "--max-memory", "1G"]) == 0
    trial = st.read(output).tree.record.trial
    assert f"levels by pairs: {trial.in_words()}" in capsys.readouterr().out
    assert main(["build", str(city), str(tmp_path / "b.splatree"), "--max-memory", "1G", "--method", "radius"]) == 0
    assert "dB" not in capsys.readouterr().out
