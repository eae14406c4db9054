"""Table 1 from photographs: train, build or grow, choose by each published method, score on what was held out."""

import pytest

import splatree as st
from splatree.bench.subject import SubjectOptions
from splatree.bench.table1 import LABELS, OURS, Options, run


@pytest.mark.parametrize("levels", ["radius", "grow"])
def test_a_table_from_photographs(photographs, levels):
    subject = SubjectOptions(data=photographs, held_out=4, size=64, views=0)
    report = run(Options(subject, train=0.01, levels=levels, max_gaussians=300, frames=1))
    rows = {row["method"]: row for row in report.tables[0].rows}
    assert set(rows) == {*LABELS.values(), OURS}
    assert report.about["scene"].startswith("trained:") and f"levels: {levels}" in report.about["training"]
    assert report.about["training"].endswith("every 4th view from the first: 1 of 4")
    ours, paper = rows[OURS], rows[LABELS["filtergs"]]
    for column in ("PSNR", "SSIM", "FLIP", "nodes", "N_P"):
        assert ours[column] == pytest.approx(paper[column], rel=1e-9), column  # both choose the same cut
    assert 10 < rows[LABELS["3dgs"]]["PSNR"] < 40 and 0 < rows[LABELS["3dgs"]]["FLIP"] < 1


def test_training_without_photographs_or_beside_a_scene_is_refused(photographs, tmp_path):
    with pytest.raises(st.InputError, match=r"train: found no photographs to train on, wanted their folder: --data"):
        Options(train=1)
    with pytest.raises(st.InputError, match="wanted either a scene or training"):
        Options(SubjectOptions(scene=(tmp_path / "a.ply",), data=photographs), train=1)
    with pytest.raises(st.InputError, match="minutes: found 0, wanted more than 0"):
        Options(SubjectOptions(data=photographs), train=0)
